//! Disturbances of several vehicles simulated side by side.

#![expect(clippy::needless_range_loop, reason = "a loop over lanes indexes several rows alike")]

use super::normals::NormalLanes;
use super::spread::spread;
use crate::simulator::Simulator;
use crate::simulator::disturbances::Disturbances;

/// The disturbances of K vehicles.
#[derive(Debug, Clone)]
pub struct DisturbanceLanes<const K: usize> {
    /// Steps at which the held values change, ascending, and the index of the next one.
    events: Vec<u64>,
    next: usize,
    held: Vec<[f64; K]>,
    turbulence: Vec<TurbulenceLanes<K>>,
    /// Disturbances at the beginning of the current step.
    pub acting: Vec<[f64; K]>,
    /// True when a disturbance acts on any vehicle.
    pub any: bool,
}

#[derive(Debug, Clone)]
struct TurbulenceLanes<const K: usize> {
    state: usize,
    decay: [f64; K],
    kick: [f64; K],
    value: [f64; K],
    normals: NormalLanes<K>,
}

impl<const K: usize> DisturbanceLanes<K> {
    /// Disturbances of K vehicles; `None` where turbulence acts on different states, for periodic ones and
    /// for those with a time window.
    pub fn new(singles: &[Simulator]) -> Option<Self> {
        let all = || singles.iter().map(|single| &single.disturbances);
        let of = |d: &Disturbances| d.turbulence.iter().map(|(state, ..)| *state).collect::<Vec<_>>();
        let states = of(all().next()?);
        if all().any(|d| of(d) != states || !d.oscillators.is_empty() || d.have_windows()) {
            return None;
        }
        let turbulence = states.iter().enumerate().map(|(i, state)| {
            let one = |l: usize| &singles[l].disturbances.turbulence[i].1;
            TurbulenceLanes {
                state: *state,
                decay: std::array::from_fn(|l| one(l).decay),
                kick: std::array::from_fn(|l| one(l).kick),
                value: std::array::from_fn(|l| one(l).value),
                normals: NormalLanes::new((0..K).map(|l| one(l).normals.clone()).collect()),
            }
        });
        // A disturbance that begins inside a step is constant from the next one on.
        let mut events: Vec<u64> =
            all().flat_map(Disturbances::events).flat_map(|(step, _)| [step, step + 1]).collect();
        events.sort_unstable();
        events.dedup();
        let n = singles[0].n;
        let mut lanes = Self {
            events,
            next: 0,
            held: vec![[0.0; K]; n],
            turbulence: turbulence.collect(),
            acting: vec![[0.0; K]; n],
            any: false,
        };
        lanes.hold(singles, singles[0].step);
        lanes.act();
        Some(lanes)
    }

    fn hold(&mut self, singles: &[Simulator], step: u64) {
        let mut held = vec![0.0; self.held.len()];
        for (l, single) in singles.iter().enumerate() {
            single.disturbances.held_without_turbulence(step, 0.0, &mut held);
            spread(&mut self.held, l, &held);
        }
        self.any = !self.turbulence.is_empty() || self.held.iter().flatten().any(|h| *h != 0.0);
    }

    #[inline(always)]
    fn act(&mut self) {
        self.acting.copy_from_slice(&self.held);
        for t in &self.turbulence {
            let acting = &mut self.acting[t.state];
            for l in 0..K {
                acting[l] += t.value[l];
            }
        }
    }

    /// Advances to step `step`.
    #[inline(always)]
    pub fn advance(&mut self, singles: &[Simulator], step: u64) {
        let mut changed = !self.turbulence.is_empty();
        for t in &mut self.turbulence {
            let normal = t.normals.next();
            for l in 0..K {
                t.value[l] = t.decay[l] * t.value[l] + t.kick[l] * normal[l];
            }
        }
        if self.events.get(self.next).is_some_and(|event| *event <= step) {
            while self.events.get(self.next).is_some_and(|event| *event <= step) {
                self.next += 1;
            }
            self.hold(singles, step);
            changed = true;
        }
        if changed {
            self.act();
        }
    }

    /// Copies the current turbulence to a single vehicle's disturbances.
    pub fn tell(&self, single: &mut Simulator, lane: usize) {
        for ((_, own, _), t) in single.disturbances.turbulence.iter_mut().zip(&self.turbulence) {
            own.value = t.value[lane];
        }
    }
}
