//! Simulation of many steps at once.

use multiversion::multiversion;

use super::Simulator;
use super::kernel::Work;
use super::rows::{BLOCK, Rows};
use crate::model::Engine;

/// Changes the states of a step, given its row in the block and the outputs measured at it.
type Correction<'c> = &'c mut dyn FnMut(usize, &[f64], &mut [f64]);

/// What acts on a block of steps beside its inputs.
enum Beside<'f> {
    Nothing,
    /// A force on one state, one value per step.
    Force(usize, &'f [f64]),
    Correction(Correction<'f>),
}

impl Simulator {
    /// Runs a whole record: for each row of `inputs` (steps x inputs, row after row) the outputs measured at that
    /// step go into the same row of `outputs` (steps x outputs).
    ///
    /// # Panics
    /// When the two have not the same number of whole rows.
    pub fn run(&mut self, inputs: &[f64], outputs: &mut [f64]) {
        let p = self.sensors.fresh().len();
        assert_eq!(inputs.len() * p, outputs.len() * self.m, "a row of outputs for each row of inputs");
        let mut rows = self.rows();
        let blocks = inputs.chunks(BLOCK * self.m).zip(outputs.chunks_mut(BLOCK * p));
        for (inputs, outputs) in blocks {
            self.run_block(inputs, &mut rows);
            for (row, outputs) in outputs.chunks_exact_mut(p).enumerate() {
                outputs.iter_mut().enumerate().for_each(|(i, y)| *y = rows.outputs[i * BLOCK + row]);
            }
        }
    }

    /// Buffers for blocks of this simulator.
    pub fn rows(&self) -> Rows {
        Rows::new(self.z.len(), self.m, self.sensors.fresh().len())
    }

    /// Runs at most [`Rows::MOST`] steps, one for each row of `inputs` (steps x inputs, row after row):
    /// equivalent to [`apply`](Self::apply), [`measure`](Self::measure) and [`advance`](Self::advance) for
    /// each of them, and faster.
    ///
    /// # Panics
    /// When `inputs` has more rows, and when `rows` was made for another simulator.
    pub fn run_block(&mut self, inputs: &[f64], rows: &mut Rows) {
        self.run_beside(inputs, Beside::Nothing, rows);
    }

    /// Runs steps as [`run_block`](Self::run_block) with an additional force on one state, one value per
    /// step, in the unit of the state's derivative: equivalent to [`disturb`](Self::disturb) before each
    /// step.
    ///
    /// # Panics
    /// As [`run_block`](Self::run_block), and when the force has not a value for each step.
    pub fn run_forced_block(&mut self, inputs: &[f64], force: Option<(usize, &[f64])>, rows: &mut Rows) {
        let beside = force.map_or(Beside::Nothing, |(state, force)| Beside::Force(state, force));
        self.run_beside(inputs, beside, rows);
    }

    /// Runs steps as [`run_block`](Self::run_block), each of which an observer corrects: equivalent to
    /// [`correct`](Self::correct) between the measurement and the advance of each step. `correction` is given the step's
    /// row in the block, the outputs measured there, and the vehicle's states, which it changes. In `rows` are the
    /// states before their correction.
    ///
    /// # Panics
    /// As [`run_block`](Self::run_block).
    pub fn run_corrected_block(&mut self, inputs: &[f64], correction: Correction<'_>, rows: &mut Rows) {
        self.run_beside(inputs, Beside::Correction(correction), rows);
    }

    fn run_beside(&mut self, inputs: &[f64], beside: Beside<'_>, rows: &mut Rows) {
        rows.length = inputs.len() / self.m.max(1);
        assert!(rows.length <= BLOCK, "at most {BLOCK} steps");
        let plain = self.sensors.are_expected() && self.engine == Engine::Off && !self.has_windows();
        match (self.z.len(), plain) {
            (4, true) => run_4(self, inputs, beside, rows),
            (8, true) => run_8(self, inputs, beside, rows),
            (12, true) => run_12(self, inputs, beside, rows),
            (16, true) => run_16(self, inputs, beside, rows),
            _ => self.step_by_step(inputs, beside, rows),
        }
    }

    #[inline(always)]
    pub(super) fn force(&mut self, state: usize, value: f64) {
        self.disturbances.force(state, value);
        self.drive[self.m + state] = value;
        self.driven = self.m + self.n;
    }

    fn step_by_step(&mut self, inputs: &[f64], mut beside: Beside<'_>, rows: &mut Rows) {
        for (row, u) in inputs.chunks_exact(self.m).enumerate() {
            if let Beside::Force(state, force) = &beside {
                self.force(*state, force[row]);
            }
            self.apply(u);
            let y = self.sensors.measure(self.step, self.engine, &self.z, &self.drive);
            for (at, y) in y.iter().enumerate() {
                rows.outputs[at * BLOCK + row] = *y;
            }
            for (at, z) in self.z.iter().enumerate() {
                rows.states[at * BLOCK + row] = *z;
            }
            if let Beside::Correction(correct) = &mut beside {
                correct(row, y, &mut self.z[..self.n]);
            }
            self.advance();
        }
    }

    #[inline(always)]
    fn run_fixed<const N: usize>(&mut self, inputs: &[f64], mut beside: Beside<'_>, rows: &mut Rows) {
        let steady = match beside {
            Beside::Nothing => self.run_steady::<N>(inputs, None, rows),
            Beside::Force(state, force) => self.run_steady::<N>(inputs, Some((state, force)), rows),
            Beside::Correction(_) => false,
        };
        if steady {
            return;
        }
        let Some(mut z) = self.z.first_chunk::<N>().copied() else { return };
        let mut work = Work::like(&z);
        let first = self.step;
        for (row, u) in inputs.chunks_exact(self.m).enumerate() {
            if let Beside::Force(state, force) = &beside {
                self.force(*state, force[row]);
            }
            self.apply(u);
            rows.put_state(row, &z);
            for (entry, v) in rows.inputs.chunks_exact_mut(BLOCK).zip(&self.drive) {
                entry[row] = *v;
            }
            if let Beside::Correction(correct) = &mut beside {
                let y = self.sensors.measure(self.step, self.engine, &z, &self.drive);
                for (output, y) in rows.outputs.chunks_exact_mut(BLOCK).zip(y) {
                    output[row] = *y;
                }
                correct(row, y, &mut z[..self.n]);
            } else {
                self.sensors.recall(rows, row);
            }
            self.advance_state(&mut z, &mut work);
        }
        self.z.copy_from_slice(&z);
        // Expected disturbances depend on time only.
        self.disturbances.advance(self.step);
        if !matches!(beside, Beside::Correction(_)) {
            self.sensors.measure_block(first, rows);
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn run_4(simulator: &mut Simulator, inputs: &[f64], beside: Beside<'_>, rows: &mut Rows) {
    simulator.run_fixed::<4>(inputs, beside, rows);
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn run_8(simulator: &mut Simulator, inputs: &[f64], beside: Beside<'_>, rows: &mut Rows) {
    simulator.run_fixed::<8>(inputs, beside, rows);
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn run_12(simulator: &mut Simulator, inputs: &[f64], beside: Beside<'_>, rows: &mut Rows) {
    simulator.run_fixed::<12>(inputs, beside, rows);
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn run_16(simulator: &mut Simulator, inputs: &[f64], beside: Beside<'_>, rows: &mut Rows) {
    simulator.run_fixed::<16>(inputs, beside, rows);
}
