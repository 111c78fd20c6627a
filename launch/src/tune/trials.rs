//! Flights of laws on draws of the vehicle, flown as in a campaign.

use whirlstand_control::SampledPlant;
use whirlstand_evaluate::{Expectation, Flight};
use whirlstand_nodes::error::NodeError;
use whirlstand_nodes::flight;
use whirlstand_nodes::setup::Setup;
use whirlstand_vehicle::Vehicle;

use super::draws::Draws;
use super::judge::Judged;
use super::pilot::Pilot;
use crate::campaign::{side_by_side, without_log};
use crate::error::Failure;

/// Most points in time of a motion that are kept.
const POINTS: usize = 400;

/// States of a flight at some of its steps.
#[derive(Debug, Clone, Default)]
pub(super) struct Motion {
    /// The states, points x states, until a state left the model.
    pub states: Vec<f64>,
    /// Time between two points, s.
    pub spacing_s: f64,
}

/// Result of a flight.
pub(super) struct Trial {
    /// Judgement of the flight.
    pub judged: Judged,
    /// Motion that is shown.
    pub motion: Motion,
}

/// Data that all flights of a tuning share.
pub(super) struct Trials<'a> {
    pub draws: &'a Draws<'a>,
    /// Signals of the vehicle that flies.
    pub vehicle: &'a Vehicle,
    /// Vehicle whose signal sizes define the cost, whichever vehicle a law was designed for.
    pub plant: &'a SampledPlant,
    /// Limits that a flight in one thread can meet or miss.
    pub limits: &'a [Expectation],
}

/// Flights of each law, draw by draw.
pub(super) type Flown = Vec<Vec<Trial>>;

impl Trials<'_> {
    /// Flies every law on every draw of `numbers`, on all processors. `progress` receives the share that is done.
    /// `None` when a signal ended it.
    ///
    /// # Errors
    /// When a flight fails for another reason than the loss of the vehicle.
    pub fn fly(
        &self,
        laws: &[&Pilot],
        numbers: std::ops::Range<u64>,
        progress: &dyn Fn(f64),
    ) -> Result<Option<Flown>, Failure> {
        // Law and filter depend on the model only, whichever vehicle is drawn.
        let design = |law: &&Pilot| flight::Pilot::new(&self.draws.bench(numbers.start, law));
        let designed = laws.iter().map(design).collect::<Result<Vec<_>, _>>().map_err(Failure::run)?;
        let count = laws.len() as u64;
        let todo: Vec<u64> = (numbers.start * count..numbers.end * count).collect();
        let jobs = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let mut flown: Vec<(u64, Trial)> = Vec::with_capacity(todo.len());
        let one = |number: u64| {
            let at = (number % count) as usize;
            self.one(laws[at], &designed[at], number / count).map(|trial| (number, trial))
        };
        let interrupted = side_by_side(&todo, jobs, one, |trial| {
            flown.push(trial?);
            progress(flown.len() as f64 / todo.len() as f64);
            Ok(false)
        })?;
        if interrupted {
            return Ok(None);
        }
        flown.sort_by_key(|(number, _)| *number);
        let mut by_law: Flown = laws.iter().map(|_| Vec::new()).collect();
        for (number, trial) in flown {
            by_law[(number % count) as usize].push(trial);
        }
        Ok(Some(by_law))
    }

    fn one(&self, law: &Pilot, designed: &flight::Pilot, draw: u64) -> Result<Trial, Failure> {
        let config = self.draws.bench(draw, law);
        let failed = |error: NodeError| Failure::Run(format!("draw {draw}: {error}"));
        let pilot = designed.before(&config).map_err(failed)?;
        let mut flight = Flight::default();
        let judged = match without_log(&config, &pilot, "", |step| flight.take(step.x, step.u, step.setpoint))
        {
            Ok(figures) => Judged::flown(figures, &flight, self.plant, self.limits),
            Err(NodeError::Diverged { .. }) => Judged::lost(),
            Err(error) => return Err(failed(error)),
        };
        Ok(Trial { judged, motion: self.motion(&flight, Setup::period_s(&config)) })
    }

    fn motion(&self, flight: &Flight, period_s: f64) -> Motion {
        let states = self.vehicle.states.len();
        // The spacing is the same for all flights, also where the vehicle is lost.
        let stride = (self.draws.steps() / POINTS).max(1);
        let rows = flight.states.chunks(states).step_by(stride);
        Motion { states: rows.flatten().copied().collect(), spacing_s: stride as f64 * period_s }
    }
}
