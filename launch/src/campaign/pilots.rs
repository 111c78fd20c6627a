//! Laws and filters that are designed once and fly many flights.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use whirlstand_nodes::NodeError;
use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::flight::Pilot;

/// Designs that are kept; a campaign that varies weights has a new one in every flight.
const MOST: usize = 16;

/// The last designs, the one that was used last at the end.
#[derive(Default)]
pub(super) struct Pilots(Mutex<VecDeque<Arc<Pilot>>>);

impl Pilots {
    /// Law and filter of this bench.
    ///
    /// # Errors
    /// As [`Pilot::new`].
    pub fn of(&self, config: &NodeConfig) -> Result<Arc<Pilot>, NodeError> {
        if let Some(known) = self.known(config) {
            return Ok(known);
        }
        // Others need not wait; two that design the same at once are no harm.
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
