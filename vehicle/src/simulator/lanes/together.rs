//! Vehicles simulated by one matrix product per step.

use super::disturbances::DisturbanceLanes;
use super::sensors::SensorLanes;
use super::spread::spread;
use crate::simulator::divergence::LARGEST;
use crate::simulator::{Dynamics, Simulator};

/// K vehicles simulated by one matrix product per step.
#[derive(Debug, Clone)]
pub struct Together<const K: usize> {
    pub n: usize,
    pub m: usize,
    pub step: u64,
    pub z: Vec<[f64; K]>,
    next: Vec<[f64; K]>,
    /// Commands in force, then disturbances of the derivatives.
    pub drive: Vec<[f64; K]>,
    /// Phi and Gamma, row after row.
    rows: Vec<[f64; K]>,
    limits: Vec<[[f64; K]; 2]>,
    /// Steps in which a disturbance begins or ends, with the index of the vehicle: descending.
    special: Vec<(u64, usize)>,
    pub disturbances: DisturbanceLanes<K>,
    pub sensors: SensorLanes<K>,
    /// Single simulators for the special steps.
    singles: Vec<Simulator>,
}

impl<const K: usize> Together<K> {
    /// `None` where one needs more than a matrix product, or the sensors differ in kind.
    pub fn new(singles: &[Simulator]) -> Option<Self> {
        let first = &singles[0];
        if singles.iter().any(|s| s.lost.is_some() || s.limits.iter().any(|limit| limit.rate.is_some())) {
            return None;
        }
        let mut kernels = Vec::new();
        let mut special = Vec::new();
        for (l, single) in singles.iter().enumerate() {
            match &single.dynamics {
                Dynamics::Plain(kernel) if single.driven == single.m => kernels.push(kernel),
                Dynamics::Plain(_) => return None,
                Dynamics::Extended(extended) => {
                    let (kernel, steps) = extended.one_kernel()?;
                    kernels.push(kernel);
                    special.extend(steps.map(|step| (step, l)));
                }
            }
        }
        special.sort_unstable_by(|a, b| b.cmp(a));
        let (size, width) = (kernels[0].states, kernels[0].width());
        if kernels.iter().any(|k| (k.states, k.width()) != (size, width)) || width != size + first.m + first.n
        {
            return None;
        }
        let entries = (0..size).flat_map(|row| (0..width).map(move |column| (row, column)));
        let rows = entries.map(|(row, column)| std::array::from_fn(|l| kernels[l].entry(row, column)));
        let limits = (0..first.m).map(|i| {
            let limit = |l: usize| &singles[l].limits[i];
            [std::array::from_fn(|l| limit(l).lower), std::array::from_fn(|l| limit(l).upper)]
        });
        let mut lanes = Self {
            n: first.n,
            m: first.m,
            step: first.step,
            z: vec![[0.0; K]; size],
            next: vec![[0.0; K]; size],
            drive: vec![[0.0; K]; first.m + first.n],
            rows: rows.collect(),
            limits: limits.collect(),
            special,
            disturbances: DisturbanceLanes::new(singles)?,
            sensors: SensorLanes::new(singles)?,
            singles: singles.to_vec(),
        };
        for (l, single) in singles.iter().enumerate() {
            spread(&mut lanes.z, l, &single.z);
            spread(&mut lanes.drive, l, &single.applied);
        }
        Some(lanes)
    }

    #[inline(always)]
    pub fn apply(&mut self, u: &[[f64; K]]) {
        for ((applied, [lower, upper]), u) in self.drive.iter_mut().zip(&self.limits).zip(u) {
            for l in 0..K {
                applied[l] = if u[l].is_nan() { applied[l] } else { u[l].max(lower[l]).min(upper[l]) };
            }
        }
    }

    #[inline(always)]
    pub fn advance(&mut self) {
        let (size, width) = (self.z.len(), self.drive.len() + self.z.len());
        let driven = if self.disturbances.any { self.drive.len() } else { self.m };
        self.drive[self.m..].copy_from_slice(&self.disturbances.acting);
        for (next, row) in self.next.iter_mut().zip(self.rows.chunks_exact(width)) {
            let mut sum = [0.0; K];
            let (phi, gamma) = row.split_at(size);
            for (c, x) in phi.iter().zip(&self.z).chain(gamma.iter().zip(&self.drive[..driven])) {
                for l in 0..K {
                    sum[l] += c[l] * x[l];
                }
            }
            *next = sum;
        }
        while self.special.last().is_some_and(|(step, _)| *step <= self.step) {
            if let Some((step, lane)) = self.special.pop()
                && step == self.step
            {
                self.advance_alone(lane);
            }
        }
        std::mem::swap(&mut self.z, &mut self.next);
        self.step += 1;
        self.disturbances.advance(&self.singles, self.step);
    }

    /// Advances one vehicle over a step in which a disturbance begins or ends.
    #[inline(never)]
    fn advance_alone(&mut self, lane: usize) {
        let single = &mut self.singles[lane];
        single.step = self.step;
        single.z.iter_mut().zip(&self.z).for_each(|(z, row)| *z = row[lane]);
        self.disturbances.tell(single, lane);
        let u: Vec<f64> = self.drive[..self.m].iter().map(|row| row[lane]).collect();
        single.apply(&u);
        single.advance_motion();
        spread(&mut self.next, lane, &single.z);
        if single.lost.is_some() {
            self.next[0][lane] = f64::NAN;
        }
    }

    #[inline(always)]
    pub fn lost(&self) -> [bool; K] {
        let mut lost = [false; K];
        for row in &self.z {
            for l in 0..K {
                lost[l] |= row[l].is_nan() || row[l].abs() >= LARGEST;
            }
        }
        lost
    }
}
