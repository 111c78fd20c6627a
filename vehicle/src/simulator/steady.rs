//! Many steps over which the states flow in the same way, whatever the inputs: the commands of all of them, then the motion,
//! then the measurements. Each part is a short loop; equivalent to the steps one by one, bit for bit.

use super::divergence::hold;
use super::kernel::Work;
use super::rows::Rows;
use super::schedule::Flows;
use super::{Dynamics, Simulator};

/// Forces on the states: the columns of a kernel that they act through, and their sizes.
struct Pushes<const N: usize> {
    all: [(usize, f64); N],
    count: usize,
}

impl<const N: usize> Pushes<N> {
    /// Of the derivatives of the states, whose columns come after those of `inputs`.
    #[inline(always)]
    fn of(derivatives: &[f64], inputs: usize) -> Self {
        let mut pushes = Self { all: [(0, 0.0); N], count: 0 };
        for (state, value) in derivatives.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            pushes.all[pushes.count] = (inputs + state, *value);
            pushes.count += 1;
        }
        pushes
    }

    #[inline(always)]
    fn as_slice(&self) -> &[(usize, f64)] {
        &self.all[..self.count]
    }
}

impl Simulator {
    /// Runs a block of steps that all are the same flow; false, and nothing has happened, where they are not.
    #[inline(always)]
    pub(super) fn run_steady<const N: usize>(
        &mut self,
        inputs: &[f64],
        force: Option<(usize, &[f64])>,
        rows: &mut Rows,
    ) -> bool {
        let Some(mut z) = self.z.first_chunk::<N>().copied().filter(|_| rows.length > 0) else {
            return false;
        };
        let first = self.step;
        if let Dynamics::Extended(extended) = &mut self.dynamics
            && !extended.is_steady(&(first..first + rows.length as u64), &self.disturbances, force.is_some())
        {
            return false;
        }
        self.command_rows(inputs, rows);
        self.move_rows(&mut z, force, rows);
        self.z.copy_from_slice(&z);
        self.step += rows.length as u64;
        self.disturbances.advance(self.step);
        self.sensors.measure_block(first, rows);
        true
    }

    /// Applies the commands of all steps, input by input.
    #[inline(always)]
    fn command_rows(&mut self, inputs: &[f64], rows: &mut Rows) {
        let (first, m) = (self.step, self.m);
        rows.width = match &self.dynamics {
            Dynamics::Plain(_) => m,
            Dynamics::Extended(extended) => extended.period_inputs(),
        };
        let commands = self.applied.iter_mut().zip(&mut self.limits).enumerate();
        for (i, (applied, limit)) in commands {
            let next = |row: usize| {
                *applied = limit.next(inputs[row * m + i], *applied);
                *applied
            };
            match &mut self.dynamics {
                Dynamics::Plain(_) => rows.put_inputs(i, next),
                Dynamics::Extended(extended) => extended.put_inputs(i, first, next, rows),
            }
        }
    }

    /// Moves the states over all steps.
    #[inline(always)]
    fn move_rows<const N: usize>(
        &mut self,
        z: &mut [f64; N],
        force: Option<(usize, &[f64])>,
        rows: &mut Rows,
    ) {
        if let Some((state, force)) = force {
            self.force(state, force[0]);
        }
        match self.dynamics {
            Dynamics::Plain(_) => self.move_plain(z, force, rows),
            Dynamics::Extended(_) => self.move_extended(z, force, rows),
        }
        let last = rows.length - 1;
        self.drive[..self.m].copy_from_slice(&rows.periods[last * rows.width..][..self.m]);
        if let Some((state, force)) = force {
            self.disturbances.force(state, force[last]);
        }
    }

    #[inline(always)]
    fn move_plain<const N: usize>(
        &mut self,
        z: &mut [f64; N],
        force: Option<(usize, &[f64])>,
        rows: &mut Rows,
    ) {
        let Self { dynamics: Dynamics::Plain(kernel), drive, m, driven, .. } = self else { return };
        let mut pushes = Pushes::<N>::of(&drive[*m..*driven], *m);
        for row in 0..rows.length {
            rows.put_state(row, z);
            if let Some((state, force)) = force {
                drive[*m + state] = force[row];
                pushes = Pushes::of(&drive[*m..], *m);
            }
            *z = kernel.fixed_with(z, rows.period(row), pushes.as_slice());
        }
    }

    #[inline(always)]
    fn move_extended<const N: usize>(
        &mut self,
        z: &mut [f64; N],
        force: Option<(usize, &[f64])>,
        rows: &mut Rows,
    ) {
        let (first, m) = (self.step, self.m);
        let Self { dynamics: Dynamics::Extended(extended), disturbances, sensors, drive, lost, .. } = self
        else {
            return;
        };
        let acting = if disturbances.are_none() { m } else { drive.len() };
        if acting > m {
            disturbances.held(first, 0.0, &mut drive[m..]);
        }
        let mut pushes = Pushes::<N>::of(&drive[m..acting], m);
        let (delayed, sines) = (sensors.has_delay(), disturbances.have_oscillators());
        let (flows, mut nonlinear) = extended.flows(first);
        let mut work = Work::like(z);
        for row in 0..rows.length {
            rows.put_state(row, z);
            if let Some((state, force)) = force {
                disturbances.force(state, force[row]);
                disturbances.held(first + row as u64, 0.0, &mut drive[m..]);
                pushes = Pushes::of(&drive[m..], m);
            }
            if delayed {
                sensors.recall(rows, row);
            }
            if sines {
                disturbances.set_oscillators(first + row as u64, z);
            }
            match flows {
                Flows::Whole(kernel) => {
                    if delayed {
                        rows.begin(row, &mut drive[..m]);
                        sensors.remember(0.0, z, &drive[..m]);
                    }
                    *z = kernel.fixed_with(z, rows.period(row), &[]);
                }
                Flows::Parts(substeps) => {
                    for substep in substeps {
                        if delayed {
                            sensors.remember(substep.start_s, z, rows.period(row));
                        }
                        if let Some(nonlinear) = &mut nonlinear {
                            rows.begin(row, &mut drive[..m]);
                            nonlinear.advance(substep, z, &drive[..acting], &mut work);
                        } else {
                            *z = substep.levels[0].fixed_with(z, rows.period(row), pushes.as_slice());
                        }
                    }
                }
            }
            hold(z, lost);
        }
    }
}
