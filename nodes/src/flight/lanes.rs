//! Several flights side by side in vector registers, bit-identical to single flights.
//!
//! Only regular flights are simulated this way: a flight in which a number is not finite or a state leaves
//! its bounds is abandoned, and flown again alone, where rules for that exist.

#![expect(clippy::needless_range_loop, reason = "a loop over lanes indexes several rows alike")]

use multiversion::multiversion;
use whirlstand_control::{ControllerLanes, EstimatorLanes};
use whirlstand_msgs::{Head, MAX_INPUTS, Setpoint, flags};
use whirlstand_vehicle::SimulatorLanes;

use super::{Counts, Pilot};
use crate::config::NodeConfig;
use crate::controller::{Law, Profile};
use crate::plant::simulation::simulated;

/// Number of simultaneous flights that is fast on every machine: two vector registers of the widest, eight of
/// the narrowest.
pub const LANES: usize = 16;

/// One step of K flights, each row with the values of all of them; SI. Like [`super::Step`].
pub struct StepLanes<'a, const K: usize> {
    /// Bench time, ns.
    pub stamp_ns: u64,
    /// The true states.
    pub x: &'a [[f64; K]],
    /// Inputs in force.
    pub u: &'a [[f64; K]],
    /// Flags of the inputs in force.
    pub flags: &'a [u32; K],
    /// Disturbance of the derivative of each state.
    pub disturbance: &'a [[f64; K]],
    /// Reference of the law.
    pub setpoint: &'a Setpoint,
    /// The filter after the measurement of this step.
    pub filter: &'a EstimatorLanes<K>,
    /// True for abandoned flights; their numbers are meaningless.
    pub lost: &'a [bool; K],
}

/// K flights.
struct Flights<const K: usize> {
    steps: u64,
    period_ns: u64,
    simulator: SimulatorLanes<K>,
    estimator: EstimatorLanes<K>,
    law: LawLanes<K>,
    profile: Profile,
    gate: GateLanes<K>,
    /// Bound of every state's magnitude.
    bounds: Vec<[f64; K]>,
    /// True when a measurement contains the input of the same time, and whether the filter models it.
    shows: bool,
    believed: bool,
    lost: [bool; K],
}

enum LawLanes<const K: usize> {
    Designed { controller: Box<ControllerLanes<K>>, add_stick: bool },
    Manual,
}

/// [`crate::gate::Gate`] for K flights with commands in time.
struct GateLanes<const K: usize> {
    limits: Vec<[f64; 2]>,
    /// Inputs in force: over the previous step, and over the next one.
    u: Vec<[f64; K]>,
    before: Vec<[f64; K]>,
    accepted: Vec<[f64; K]>,
    /// Command of the law.
    command: Vec<[f64; K]>,
    flags: [u32; K],
    accepted_flags: [u32; K],
    rejected: [u64; K],
}

impl Pilot {
    /// Flies benches as [`Self::fly_lanes`], with a number that is fast on every machine. Compiled in this
    /// optimised crate, not in the caller's.
    pub fn fly_together(
        &self,
        configs: &[&NodeConfig; LANES],
        each: &mut dyn FnMut(&StepLanes<'_, LANES>),
    ) -> [Option<Counts>; LANES] {
        self.fly_lanes(configs, each)
    }

    /// Flies K benches of this pilot that differ only in effects, initial states and seeds; `each` is called
    /// for every step. `None` for a flight that has to be flown alone; for all of them, where filter or
    /// benches are unsuitable.
    pub fn fly_lanes<const K: usize>(
        &self,
        configs: &[&NodeConfig; K],
        each: &mut dyn FnMut(&StepLanes<'_, K>),
    ) -> [Option<Counts>; K] {
        let Some(mut flights) = self.flights(configs) else { return [None; K] };
        fly(&mut flights, each);
        std::array::from_fn(|l| {
            let counts =
                Counts { steps: flights.steps, rejected: flights.gate.rejected[l], ..Counts::default() };
            (!flights.lost[l]).then_some(counts)
        })
    }

    fn flights<const K: usize>(&self, configs: &[&NodeConfig; K]) -> Option<Flights<K>> {
        let (setup, first) = (&self.setup, *configs.first()?);
        let like = |config: &&NodeConfig| {
            (config.steps, config.period_ns) == (first.steps, first.period_ns)
                && config.setpoint == first.setpoint
                && config.stick == first.stick
                && self.is_of(config)
        };
        if !configs.iter().all(like) {
            return None;
        }
        let simulated: Vec<_> = configs.iter().map(|c| simulated(c, setup).ok()).collect::<Option<_>>()?;
        let bounds = (0..setup.vehicle.states.len()).map(|i| std::array::from_fn(|l| simulated[l].1[i]));
        let law = match &self.law {
            Law::Manual => LawLanes::Manual,
            Law::Designed { controller, add_stick, .. } => LawLanes::Designed {
                controller: Box::new(ControllerLanes::new(controller)?),
                add_stick: *add_stick,
            },
        };
        let m = setup.limits.count;
        let neutral: Vec<[f64; K]> = setup.limits.neutral()[..m].iter().map(|u| [*u; K]).collect();
        Some(Flights {
            steps: first.steps,
            period_ns: first.period_ns,
            bounds: bounds.collect(),
            simulator: SimulatorLanes::new(simulated.into_iter().map(|(simulator, _)| simulator).collect())?,
            estimator: EstimatorLanes::new(&self.estimator)?,
            law,
            profile: Profile::new(first, &setup.vehicle).ok()?,
            gate: GateLanes {
                limits: (0..m).map(|i| [setup.limits.lower[i], setup.limits.upper[i]]).collect(),
                u: neutral.clone(),
                before: neutral.clone(),
                accepted: neutral,
                command: vec![[0.0; K]; m],
                flags: [0; K],
                accepted_flags: [0; K],
                rejected: [0; K],
            },
            shows: setup.vehicle.d.iter().any(|v| *v != 0.0),
            believed: setup.model.d.iter().any(|v| *v != 0.0),
            lost: [false; K],
        })
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn fly<const K: usize>(flights: &mut Flights<K>, each: &mut dyn FnMut(&StepLanes<'_, K>)) {
    for step in 0..flights.steps {
        flights.step(step, each);
        if flights.lost.iter().all(|lost| *lost) {
            return;
        }
    }
}

impl<const K: usize> Flights<K> {
    /// One iteration of the loop in [`Pilot::fly`].
    #[inline(always)]
    fn step(&mut self, step: u64, each: &mut dyn FnMut(&StepLanes<'_, K>)) {
        let Self { simulator, estimator, gate, .. } = self;
        if step > 0 {
            gate.close();
        }
        simulator.apply(&gate.u);
        let y = simulator.measure();
        for row in y {
            mark(&mut self.lost, row, f64::MAX);
        }
        let now = if self.believed { &gate.u } else { &gate.before };
        let valid = (0..y.len()).fold(0, |bits, i| bits | 1 << i);
        let fresh = simulator.fresh() & valid;
        estimator.step(simulator.measure(), fresh, &gate.before, now);
        let head = Head { seq: 0, step, stamp_ns: step * self.period_ns };
        let setpoint = self.profile.at(head);
        match &mut self.law {
            LawLanes::Manual => gate.command.iter_mut().zip(&setpoint.stick).for_each(|(c, u)| *c = [*u; K]),
            LawLanes::Designed { controller, add_stick } => {
                if *add_stick {
                    controller.set_test_input(&setpoint.stick[..gate.command.len().min(MAX_INPUTS)]);
                }
                let x = estimator.x();
                let outcome = controller.step(x, &setpoint.x[..x.len()], setpoint.tracked, &mut gate.command);
                for l in 0..K {
                    self.lost[l] |= outcome.lost[l];
                }
            }
        }
        each(&StepLanes {
            stamp_ns: head.stamp_ns,
            x: simulator.state(),
            u: simulator.applied(),
            flags: &gate.flags,
            disturbance: simulator.disturbance(),
            setpoint,
            filter: estimator,
            lost: &self.lost,
        });
        gate.offer();
        simulator.advance();
        if !self.shows {
            simulator.measure();
        }
        let beyond = simulator.lost();
        for l in 0..K {
            self.lost[l] |= beyond[l];
        }
        // Step 0 is over before a bench begins to check.
        if step > 0 {
            for (x, bound) in simulator.state().iter().zip(&self.bounds) {
                for l in 0..K {
                    self.lost[l] |= x[l].abs() > bound[l];
                }
            }
        }
    }
}

impl<const K: usize> GateLanes<K> {
    /// Accepts the command of this step, within the limits.
    #[inline(always)]
    fn offer(&mut self) {
        let (mut moved, mut stands) = ([false; K], [false; K]);
        for ((u, command), [lower, upper]) in self.accepted.iter_mut().zip(&self.command).zip(&self.limits) {
            for l in 0..K {
                u[l] = command[l].max(*lower).min(*upper);
                moved[l] |= u[l] != command[l];
                stands[l] |= u[l] <= *lower || u[l] >= *upper;
            }
        }
        for l in 0..K {
            self.rejected[l] += u64::from(moved[l]);
            self.accepted_flags[l] = if stands[l] { flags::SATURATED } else { 0 };
        }
    }

    /// Brings the accepted command into force.
    #[inline(always)]
    fn close(&mut self) {
        std::mem::swap(&mut self.before, &mut self.u);
        self.u.copy_from_slice(&self.accepted);
        self.flags = self.accepted_flags;
    }
}

/// Marks flights with a value that is NaN, infinite, or larger than its bound.
#[inline(always)]
fn mark<const K: usize>(lost: &mut [bool; K], row: &[f64; K], largest: f64) {
    for l in 0..K {
        lost[l] |= row[l].is_nan() || row[l].abs() > largest;
    }
}
