//! Initial states as the first samples of a record show them.

use nalgebra::{DMatrix, DVector};
use whirlstand_ident::identify::normal::pseudo_inverse;
use whirlstand_vehicle::{Simulator, Vehicle};

use crate::model::free_run::FreeRun;
use crate::thresholds::MAX_AR_ORDER;

impl FreeRun<'_> {
    /// Initial states from which a fit starts: at rest in the first record, and in the others as their first samples show.
    /// A part after a gap begins anywhere. From rest, the first noise model would be that of an offset, which explains any
    /// offset, so that the fit would stay there.
    pub fn start(&self) -> Vec<f64> {
        self.begun(&self.vehicle, &vec![0.0; self.initials()], 1)
    }

    /// Initial states of all records; of each that begins at step `from` or later, the smallest with which its first samples
    /// agree. A filter that follows a record from elsewhere, as from a heading of zero, is wrong for many times its memory,
    /// and no fit finds the initial states of a record that it does not count.
    pub fn begun(&self, vehicle: &Vehicle, initial: &[f64], from: usize) -> Vec<f64> {
        let n = self.states();
        let mut begun = initial.to_vec();
        let Some(at_rest) = self.data.simulator(vehicle) else { return begun };
        for (start, x) in self.data.starts.iter().zip(begun.chunks_exact_mut(n.max(1))) {
            if *start >= from {
                x.fill(0.0);
                let shown = self.shown((vehicle, &at_rest), *start);
                x.iter_mut().zip(shown.iter().flat_map(DVector::iter)).for_each(|(x, shown)| *x = *shown);
            }
        }
        begun
    }

    /// The smallest state with which the first samples from a step on agree.
    fn shown(&self, (vehicle, at_rest): (&Vehicle, &Simulator), start: usize) -> Option<DVector<f64>> {
        let data = self.data;
        let mut simulator = data.begin(at_rest, start);
        simulator.set_state(&vec![0.0; self.states()]);
        simulator.apply(data.commands(start));
        let y = simulator.measure();
        let end = data.starts.iter().copied().find(|other| *other > start).unwrap_or(data.steps);
        let (rows, errors): (Vec<_>, Vec<_>) = data
            .channels
            .iter()
            .filter_map(|channel| {
                // After a gap, the first samples do not count.
                let mut looked_at = start..end.min(start + (MAX_AR_ORDER + 2) * channel.stride);
                let measured = looked_at.find_map(|step| channel.measured_at(step))?;
                Some((vehicle.c.row(channel.output), measured - y[channel.output]))
            })
            .unzip();
        if rows.is_empty() {
            return None;
        }
        let seen = DMatrix::from_rows(&rows);
        Some(seen.transpose() * (pseudo_inverse(&(&seen * seen.transpose()))? * DVector::from_vec(errors)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::flown::flown;

    /// An unwrapped heading of some turns at the beginning of a part: predictions of its rate were wrong by hundreds of
    /// radians per second.
    #[test]
    fn a_filter_begins_where_the_first_samples_are() {
        let text = "A = [[0.0, 1.0], [0.0, -2.0]]\nB = [[0.0], [5.0]]\nC = [[1.0, 0.0], [0.0, 1.0]]\n\
                    states = [{ name = \"yaw\" }, { name = \"yaw_rate\" }]\ninputs = [{ name = \"u\" }]\n\
                    outputs = [{ name = \"yaw\" }, { name = \"yaw_rate\" }]\n";
        let vehicle = Vehicle::parse(text, "yaw.toml").unwrap();
        let mut data = flown(&vehicle, (0..400).map(|k| if k % 70 < 35 { 0.3 } else { -0.3 }).collect(), 5);
        data.starts = vec![0, 200];
        data.clocks = vec![0, 200];
        data.channels[0].values.iter_mut().skip(200).for_each(|yaw| *yaw -= 12.0);
        data.channels[0].good[200..220].fill(false);
        let run = FreeRun::new(&vehicle, &data);
        let begun = run.begun(&vehicle, &[0.5, 0.0, 0.0, 0.0], 1);
        assert_eq!(begun[..2], [0.5, 0.0], "begins before");
        let first = |channel: usize, step: usize| data.channels[channel].values[step];
        assert!(
            (begun[2] - first(0, 220)).abs() < 1e-9 && (begun[3] - first(1, 200)).abs() < 1e-9,
            "{begun:?}"
        );
        assert!(begun[2] < -10.0);
    }
}
