//! Advances a simulator from one step to the next.

use super::divergence::hold;
use super::kernel::{State, Work};
use super::{Dynamics, Simulator};

impl Simulator {
    /// Advances to the next step under the input in force. Not inlined: its kernels are compiled here alone.
    pub fn advance(&mut self) {
        self.advance_motion();
        self.disturbances.advance(self.step);
    }

    pub(super) fn advance_motion(&mut self) {
        match self.z.len() {
            4 => self.advance_fixed::<4>(),
            8 => self.advance_fixed::<8>(),
            12 => self.advance_fixed::<12>(),
            16 => self.advance_fixed::<16>(),
            _ => {
                let mut z = std::mem::take(&mut self.z);
                let mut work = std::mem::take(&mut self.work);
                self.advance_state(&mut z, &mut work);
                (self.z, self.work) = (z, work);
            }
        }
    }

    fn advance_fixed<const N: usize>(&mut self) {
        let Some(mut z) = self.z.first_chunk::<N>().copied() else { return };
        let mut work = Work::like(&z);
        self.advance_state(&mut z, &mut work);
        self.z.copy_from_slice(&z);
    }

    /// Advances z, the simulator's state or a copy of it, over one step; the disturbances are not advanced.
    #[inline(always)]
    pub(super) fn advance_state<V: State>(&mut self, z: &mut V, work: &mut Work<V>) {
        match &mut self.dynamics {
            Dynamics::Plain(kernel) => {
                z.flow(kernel, &self.drive[..self.driven], &mut work.scratch);
                self.step += 1;
            }
            Dynamics::Extended(extended) => {
                let around = (&self.disturbances, &mut self.sensors);
                extended.advance(self.step, z, &mut self.drive, around, work);
                hold(z.as_mut(), &mut self.lost);
                self.step += 1;
            }
        }
    }
}
