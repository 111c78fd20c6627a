//! Laws and filters, each designed once and used in many flights.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use whirlstand_nodes::NodeError;
use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::flight::Pilot;

/// Most designs that are kept. A campaign that varies weights has a new design in every flight.
const MOST: usize = 16;

/// The designs used last, the most recent one at the end.
#[derive(Default)]
pub(super) struct Pilots(Mutex<VecDeque<Arc<Pilot>>>);

impl Pilots {
    /// Law and filter of this bench, designed unless they are kept.
    ///
    /// # Errors
    /// As [`Pilot::new`].
    pub fn of(&self, config: &NodeConfig) -> Result<Arc<Pilot>, NodeError> {
        if let Some(known) = self.known(config) {
            return Ok(known);
        }
        // The lock is not held during the design, so that other threads need not wait. Two threads that make
        // the same design do no harm.
        let new = Arc::new(Pilot::new(config)?);
        let mut pilots = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        pilots.push_back(Arc::clone(&new));
        if pilots.len() > MOST {
            pilots.pop_front();
        }
        Ok(new)
    }

    fn known(&self, config: &NodeConfig) -> Option<Arc<Pilot>> {
        let mut pilots = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let at = pilots.iter().rposition(|pilot| pilot.is_of(config))?;
        let pilot = pilots.remove(at)?;
        pilots.push_back(Arc::clone(&pilot));
        Some(pilot)
    }
}
