//! The whole bench in one thread: plant, estimator, controller and recorder take turns.

use std::time::{Duration, Instant};

use whirlstand_bus::Bus;
use whirlstand_msgs::Health;

use crate::clock::{Clock, Turn};
use crate::config::{Mode, NodeConfig, Role};
use crate::controller::Controller;
use crate::error::NodeError;
use crate::estimator::Estimator;
use crate::follower::Follower;
use crate::mirror::Mirror;
use crate::notices::{self, Writing};
use crate::os::{StopFlag, sleep_until};
use crate::plant::Plant;
use crate::recorder::Recorder;
use crate::setup::Setup;

/// Number of rounds between two rounds of work outside the loop. Well below the recorder's window, so that
/// the plant never has to wait for it.
const ROUNDS_PER_POLL: u32 = 128;

/// Result of a bench in one thread.
#[derive(Debug, Clone)]
pub struct Ended {
    /// Number of steps done.
    pub steps: u64,
    /// Wall-clock time of the loop, without opening and closing.
    pub wall: Duration,
    /// Last report of each node, by role.
    pub reports: Vec<(Role, Health)>,
}

/// A bench in one thread; [`Bench::round`] lets each node take a turn.
pub struct Bench {
    plant: Plant,
    estimator: Estimator,
    controller: Controller,
    recorder: Option<Recorder>,
    mirror: Option<Mirror>,
    clock: Clock,
    realtime: bool,
    rounds: u32,
    /// Dropped last, so that the final notices of the nodes are written too.
    _writing: Writing,
}

impl Bench {
    /// Opens all nodes.
    ///
    /// # Errors
    /// The [`NodeError`] of the first node that fails.
    pub fn open(config: &NodeConfig) -> Result<Self, NodeError> {
        let setup = Setup::new(config)?;
        let writing = notices::begin()?;
        let bus = Bus::open(&Setup::bus_config(config, Role::Plant))?;
        let realtime = config.mode == Mode::Realtime;
        Ok(Self {
            estimator: Estimator::open(&bus, config, &setup)?,
            controller: Controller::open(&bus, config, &setup)?,
            recorder: config.recorder.is_some().then(|| Recorder::open(&bus, config, &setup)).transpose()?,
            mirror: config.mirror.is_some().then(|| Mirror::open(&bus, config, &setup)).transpose()?,
            plant: Plant::open(&bus, config, &setup)?,
            clock: if realtime { Clock::exact() } else { Clock::sampled(1024) },
            realtime,
            rounds: 0,
            _writing: writing,
        })
    }

    /// One turn of each node in the order of a step. In realtime it waits for the next deadline when all is
    /// done.
    ///
    /// # Errors
    /// The [`NodeError`] of the first node that fails.
    #[inline]
    pub fn round(&mut self) -> Result<Turn, NodeError> {
        let plant = self.plant.turn(&mut self.clock)?;
        if plant == Turn::Ended {
            return Ok(Turn::Ended);
        }
        let estimator = self.estimator.turn(&mut self.clock)?;
        let controller = self.controller.turn(&mut self.clock)?;
        self.rounds += 1;
        let idle = [plant, estimator, controller].iter().all(|t| *t == Turn::Idle);
        if idle || self.rounds >= ROUNDS_PER_POLL {
            self.rounds = 0;
            self.poll_others()?;
            if let Some(deadline) = self.plant.deadline().filter(|_| idle && self.realtime) {
                sleep_until(deadline, || true);
                self.plant.tick(&mut self.clock)?;
            }
        }
        Ok(if idle { Turn::Idle } else { Turn::Worked })
    }

    /// Runs to the end, or until `stop` is set.
    ///
    /// # Errors
    /// The [`NodeError`] of the first node that fails.
    pub fn run(mut self, stop: &StopFlag) -> Result<Ended, NodeError> {
        let mut start = Instant::now();
        loop {
            if stop.is_set() {
                self.plant.stop();
            }
            match self.round()? {
                Turn::Ended => break,
                Turn::Worked => {}
                Turn::Idle if self.plant.steps_done() == 0 => start = Instant::now(),
                Turn::Idle => {}
            }
        }
        let wall = start.elapsed();
        let mut reports = vec![
            (Role::Plant, *self.plant.health()),
            (Role::Estimator, self.estimator.stop()?),
            (Role::Controller, self.controller.stop()?),
        ];
        // Before the recorder, so that its last findings are in the log.
        let mut mirrored = None;
        if let Some(mirror) = &mut self.mirror {
            mirror.stop();
            mirror.turn(Instant::now())?;
            mirrored = Some((Role::Mirror, *mirror.health()));
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.stop(Instant::now());
            while recorder.turn(Instant::now())? != Turn::Ended {}
            reports.push((Role::Recorder, *recorder.health()));
        }
        reports.extend(mirrored);
        match self.plant.take_divergence() {
            Some(error) => Err(error),
            None => Ok(Ended { steps: self.plant.steps_done(), wall, reports }),
        }
    }

    fn poll_others(&mut self) -> Result<(), NodeError> {
        let now = Instant::now();
        self.estimator.housekeeping(now)?;
        self.controller.housekeeping(now)?;
        if let Some(mirror) = &mut self.mirror {
            mirror.turn(now)?;
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.turn(now)?;
        }
        Ok(())
    }
}

/// Runs a bench in this thread.
///
/// # Errors
/// The [`NodeError`] of the first node that fails.
pub fn run_inproc(config: &NodeConfig, stop: &StopFlag) -> Result<Ended, NodeError> {
    Bench::open(config)?.run(stop)
}
