//! Several vehicles simulated side by side, bit-identical to single simulations.
//!
//! Where they differ only in numbers, a step is one product over vector registers; where one has an effect
//! that this does not support (a delay, a nonlinear effect, a mode transition, a rate limit), all are
//! simulated one after the other.

mod disturbances;
mod normals;
mod sensors;
mod spread;
mod together;

use super::Simulator;
use spread::spread;
use together::Together;

/// K vehicles with the same signals simulated side by side, each equivalent to its own [`Simulator`].
#[derive(Debug, Clone)]
pub struct SimulatorLanes<const K: usize>(Kind<K>);

#[derive(Debug, Clone)]
enum Kind<const K: usize> {
    Together(Box<Together<K>>),
    Apart(Box<Apart<K>>),
}

/// Vehicles simulated one after the other.
#[derive(Debug, Clone)]
struct Apart<const K: usize> {
    singles: Vec<Simulator>,
    u: Vec<f64>,
    state: Vec<[f64; K]>,
    applied: Vec<[f64; K]>,
    outputs: Vec<[f64; K]>,
    fresh: u64,
    disturbance: Vec<[f64; K]>,
}

impl<const K: usize> SimulatorLanes<K> {
    /// Vehicles in the states of `singles`, which must be at the same step, with the same engine and period.
    /// `None` unless there are K of them with the same number of signals measured at the same steps.
    pub fn new(singles: Vec<Simulator>) -> Option<Self> {
        let first = singles.first()?;
        let every = |s: &Simulator| s.sensors.sensors.iter().map(|s| s.every).collect::<Vec<_>>();
        let like = |s: &Simulator| {
            (s.n, s.m, s.step, s.engine) == (first.n, first.m, first.step, first.engine)
                && s.period_s == first.period_s
                && every(s) == every(first)
        };
        if singles.len() != K || !singles.iter().all(like) {
            return None;
        }
        Some(Self(match Together::new(&singles) {
            Some(together) => Kind::Together(Box::new(together)),
            None => Kind::Apart(Box::new(Apart::new(singles))),
        }))
    }

    /// Applies commands as [`Simulator::apply`].
    #[inline(always)]
    pub fn apply(&mut self, u: &[[f64; K]]) {
        match &mut self.0 {
            Kind::Together(lanes) => lanes.apply(u),
            Kind::Apart(lanes) => lanes.apply(u),
        }
    }

    /// Measured outputs, as [`Simulator::measure`].
    #[inline(always)]
    pub fn measure(&mut self) -> &[[f64; K]] {
        match &mut self.0 {
            Kind::Together(lanes) => lanes.sensors.measure(&lanes.z, &lanes.drive, lanes.step),
            Kind::Apart(lanes) => lanes.measure(),
        }
    }

    /// Bit i: output i was new in the last [`Self::measure`].
    #[inline(always)]
    pub fn fresh(&self) -> u64 {
        match &self.0 {
            Kind::Together(lanes) => lanes.sensors.fresh,
            Kind::Apart(lanes) => lanes.fresh,
        }
    }

    /// Advances as [`Simulator::advance`].
    #[inline(always)]
    pub fn advance(&mut self) {
        match &mut self.0 {
            Kind::Together(lanes) => lanes.advance(),
            Kind::Apart(lanes) => lanes.advance(),
        }
    }

    /// The vehicles' states.
    #[inline(always)]
    pub fn state(&self) -> &[[f64; K]] {
        match &self.0 {
            Kind::Together(lanes) => &lanes.z[..lanes.n],
            Kind::Apart(lanes) => &lanes.state,
        }
    }

    /// The commands in force.
    #[inline(always)]
    pub fn applied(&self) -> &[[f64; K]] {
        match &self.0 {
            Kind::Together(lanes) => &lanes.drive[..lanes.m],
            Kind::Apart(lanes) => &lanes.applied,
        }
    }

    /// Disturbances as [`Simulator::disturbance`].
    #[inline(always)]
    pub fn disturbance(&self) -> &[[f64; K]] {
        match &self.0 {
            Kind::Together(lanes) => &lanes.disturbances.acting,
            Kind::Apart(lanes) => &lanes.disturbance,
        }
    }

    /// True for each vehicle with a state, or a filter state, that is NaN or has diverged.
    #[inline(always)]
    pub fn lost(&self) -> [bool; K] {
        match &self.0 {
            Kind::Together(lanes) => lanes.lost(),
            Kind::Apart(lanes) => std::array::from_fn(|l| lanes.singles[l].diverged()),
        }
    }
}

impl<const K: usize> Apart<K> {
    fn new(singles: Vec<Simulator>) -> Self {
        let first = &singles[0];
        let rows = |count: usize| vec![[0.0; K]; count];
        let mut lanes = Self {
            u: vec![0.0; first.m],
            state: rows(first.n),
            applied: rows(first.m),
            outputs: rows(first.sensors.sensors.len()),
            fresh: 0,
            disturbance: rows(first.n),
            singles,
        };
        lanes.gather();
        lanes
    }

    fn gather(&mut self) {
        for (l, single) in self.singles.iter().enumerate() {
            spread(&mut self.state, l, single.state());
            spread(&mut self.disturbance, l, single.disturbance());
        }
    }

    fn apply(&mut self, u: &[[f64; K]]) {
        for (l, single) in self.singles.iter_mut().enumerate() {
            self.u.iter_mut().zip(u).for_each(|(to, u)| *to = u[l]);
            single.apply(&self.u);
            spread(&mut self.applied, l, single.applied());
        }
    }

    fn measure(&mut self) -> &[[f64; K]] {
        for (l, single) in self.singles.iter_mut().enumerate() {
            spread(&mut self.outputs, l, single.measure());
        }
        let fresh = self.singles[0].fresh().iter().enumerate();
        self.fresh = fresh.fold(0, |bits, (i, f)| bits | u64::from(*f) << i);
        &self.outputs
    }

    fn advance(&mut self) {
        self.singles.iter_mut().for_each(Simulator::advance);
        self.gather();
    }
}
