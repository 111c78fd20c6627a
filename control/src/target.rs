//! Steady state and input for a tracked reference.

use crate::sampled_plant::SampledPlant;

/// Finds, for a set of tracked states and their reference r, the state `x_s` and input `u_s` to regulate about.
///
/// The conditions, each satisfied as far as it does not contradict the earlier ones, are:
/// 1. the derivative of every state that others depend on is zero, `A x_s + B u_s = 0`;
/// 2. tracked states have their reference;
/// 3. the derivative of every other state (one on which no other depends, such as a position) is zero;
/// 4. such a state has its reference even when it is not tracked;
/// 5. the remaining freedom is used to minimise the norm, in units of the plant's scales.
///
/// A state of kind 3 that cannot rest (a position while a speed is tracked) is freed: it is not fed back.
/// Tracked states always have their reference itself, so that a moving reference can include its derivative.
///
/// All memory is allocated on construction; a change of the tracked set costs one small orthogonalisation.
#[derive(Debug, Clone)]
pub struct Target {
    n: usize,
    m: usize,
    /// Scaled rows `[A, B]`, n x (n + m), row after row.
    dynamics: Vec<f64>,
    scale: Vec<f64>,
    ignorable: Vec<bool>,
    tracked: u64,
    freed: Vec<bool>,
    /// Orthonormal rows found so far, and each one's right-hand side as a linear function of r.
    basis: Vec<f64>,
    sides: Vec<f64>,
    row: Vec<f64>,
    side: Vec<f64>,
    /// (n + m) x n, row after row: `[x_s; u_s] = map r`.
    map: Vec<f64>,
}

impl Target {
    /// Prepares the computation for a plant, with no tracked state.
    pub fn new(plant: &SampledPlant) -> Self {
        let (n, m) = (plant.state_count(), plant.input_count());
        let size = n + m;
        let mut scale = plant.scales().to_vec();
        scale.extend(plant.inputs().iter().map(|i| i.authority()));
        let mut dynamics = vec![0.0; n * size];
        for i in 0..n {
            for j in 0..size {
                let entry = if j < n { plant.a()[(i, j)] } else { plant.b()[(i, j - n)] };
                dynamics[i * size + j] = entry * scale[j] / scale[i];
            }
        }
        let ignorable = (0..n).map(|j| plant.a().column(j).iter().all(|v| *v == 0.0)).collect();
        let mut target = Self {
            n,
            m,
            dynamics,
            scale,
            ignorable,
            tracked: 0,
            freed: vec![false; n],
            basis: vec![0.0; size * size],
            sides: vec![0.0; size * n],
            row: vec![0.0; size],
            side: vec![0.0; n],
            map: vec![0.0; size * n],
        };
        target.solve(0);
        target
    }

    /// Bit mask of the tracked states, bit i for state i.
    pub fn tracked(&self) -> u64 {
        self.tracked
    }

    /// True for states that are not fed back.
    pub fn freed(&self) -> &[bool] {
        &self.freed
    }

    /// Changes the set of tracked states.
    pub fn track(&mut self, tracked: u64) {
        if tracked != self.tracked {
            self.solve(tracked);
        }
    }

    /// Writes the steady state (n) and input (m) for the reference (n).
    pub fn evaluate(&self, reference: &[f64], x: &mut [f64], u: &mut [f64]) {
        let n = self.n;
        for (i, value) in x.iter_mut().chain(u.iter_mut()).take(n + self.m).enumerate() {
            if i < n && self.tracked >> i & 1 == 1 {
                *value = reference[i];
            } else {
                *value = self.map[i * n..(i + 1) * n].iter().zip(reference).map(|(a, b)| a * b).sum();
            }
        }
    }

    fn solve(&mut self, tracked: u64) {
        let (n, size) = (self.n, self.n + self.m);
        self.tracked = tracked;
        let mut rank = 0;
        for i in 0..n {
            if !self.ignorable[i] {
                rank = self.add_dynamics(i, rank).0;
            }
        }
        for i in 0..n {
            if tracked >> i & 1 == 1 {
                rank = self.add_reference(i, rank);
            }
        }
        for i in 0..n {
            self.freed[i] = false;
            if self.ignorable[i] {
                let (new_rank, consistent) = self.add_dynamics(i, rank);
                rank = new_rank;
                self.freed[i] = !consistent && tracked >> i & 1 == 0;
            }
        }
        for i in 0..n {
            if self.ignorable[i] && !self.freed[i] && tracked >> i & 1 == 0 {
                rank = self.add_reference(i, rank);
            }
        }
        // Minimum-norm solution: the sum of the orthonormal rows times their right-hand sides.
        for i in 0..size {
            for j in 0..n {
                let sum: f64 = (0..rank).map(|k| self.basis[k * size + i] * self.sides[k * n + j]).sum();
                self.map[i * n + j] = self.scale[i] * sum / self.scale[j];
            }
        }
    }

    fn add_dynamics(&mut self, i: usize, rank: usize) -> (usize, bool) {
        let size = self.n + self.m;
        self.row.copy_from_slice(&self.dynamics[i * size..(i + 1) * size]);
        self.side.fill(0.0);
        self.add(rank)
    }

    fn add_reference(&mut self, i: usize, rank: usize) -> usize {
        self.row.fill(0.0);
        self.side.fill(0.0);
        self.row[i] = 1.0;
        self.side[i] = 1.0;
        self.add(rank).0
    }

    /// Adds the prepared row unless it depends on the earlier ones; returns whether it is consistent with
    /// them.
    fn add(&mut self, rank: usize) -> (usize, bool) {
        let (n, size) = (self.n, self.n + self.m);
        let before = norm(&self.row);
        if before == 0.0 {
            return (rank, norm(&self.side) == 0.0);
        }
        self.row.iter_mut().for_each(|v| *v /= before);
        self.side.iter_mut().for_each(|v| *v /= before);
        // Orthogonalising twice is enough (Kahan and Parlett).
        for _ in 0..2 {
            for k in 0..rank {
                let basis = &self.basis[k * size..(k + 1) * size];
                let dot: f64 = basis.iter().zip(&self.row).map(|(a, b)| a * b).sum();
                self.row.iter_mut().zip(basis).for_each(|(r, b)| *r -= dot * b);
                let sides = &self.sides[k * n..(k + 1) * n];
                self.side.iter_mut().zip(sides).for_each(|(s, b)| *s -= dot * b);
            }
        }
        let left = norm(&self.row);
        if left < 1e-9 || rank == size {
            return (rank, norm(&self.side) < 1e-9);
        }
        for j in 0..size {
            self.basis[rank * size + j] = self.row[j] / left;
        }
        for j in 0..n {
            self.sides[rank * n + j] = self.side[j] / left;
        }
        (rank + 1, true)
    }
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
