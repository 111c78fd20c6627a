//! A flight: from one time at which anything jumps to the next, and what is seen at the samples.

use super::BlindError;
use super::integrator::{Integrator, Line};
use super::plant::Plant;
use super::signal::Signal;

/// Times closer than this are the same, s.
const SAME: f64 = 1e-10;
/// A state beyond this has lost all meaning.
const LARGEST: f64 = 1e9;

/// A record of the motion at the sample times.
#[derive(Debug, Clone)]
pub(crate) struct Motion {
    pub samples: usize,
    /// Samples x states.
    pub states: Vec<f64>,
    /// Samples x outputs: what sensors see, behind their lags and delays.
    pub seen: Vec<f64>,
}

/// Goes along a signal with the time.
struct Cursor<'a> {
    signal: &'a Signal,
    next: usize,
}

impl<'a> Cursor<'a> {
    fn new(signal: &'a Signal) -> Self {
        Self { signal, next: 0 }
    }

    /// The line that holds from `t` on.
    fn line(&mut self, t: f64) -> Line {
        let pieces = self.signal.pieces();
        while pieces.get(self.next).is_some_and(|p| p.from <= t + SAME) {
            self.next += 1;
        }
        match self.next.checked_sub(1).map(|i| pieces[i]) {
            Some(p) => Line { value: p.value + p.slope * (t - p.from), slope: p.slope },
            None => Line { value: self.signal.rest(), slope: 0.0 },
        }
    }
}

/// Integrates the plant from `x0` and looks at it `samples` times, a period apart.
pub(crate) fn fly(plant: &Plant, x0: &[f64], period_s: f64, samples: usize) -> Result<Motion, BlindError> {
    let mut run = Integrator::new(plant, x0);
    let (cuts, outputs) = (cuts(plant, period_s, samples), plant.sensor_delays.len());
    let mut cursors: Vec<Cursor<'_>> = plant.inputs.iter().map(Cursor::new).collect();
    let mut push_cursors: Vec<Cursor<'_>> = plant.pushes.iter().map(|(_, s)| Cursor::new(s)).collect();
    let mut motion =
        Motion { samples, states: vec![0.0; samples * plant.n], seen: vec![0.0; samples * outputs] };
    let mut next_sample = 0;
    // For each delayed output the next sample that looks at it. What lies before the record is its first value.
    let mut looks: Vec<usize> = Vec::with_capacity(outputs);
    for (index, cut) in cuts.iter().copied().enumerate() {
        for (line, cursor) in run.inputs.iter_mut().zip(&mut cursors) {
            *line = cursor.line(cut);
        }
        for ((_, line), cursor) in run.pushes.iter_mut().zip(&mut push_cursors) {
            *line = cursor.line(cut);
        }
        run.start = cut;
        while plant.stages.get(run.stage + 1).is_some_and(|s| s.0 <= cut + SAME) {
            run.stage += 1;
        }
        if index == 0 {
            run.settle();
            for (i, delay) in plant.sensor_delays.iter().enumerate() {
                let before = ((delay / period_s - 1e-9).ceil().max(0.0) as usize).min(samples);
                let rest = run.output(i);
                (0..before).for_each(|k| motion.seen[k * outputs + i] = rest);
                looks.push(before);
            }
        }
        if next_sample < samples && (cut - next_sample as f64 * period_s).abs() < SAME {
            motion.states[next_sample * plant.n..(next_sample + 1) * plant.n]
                .copy_from_slice(&run.z[..plant.n]);
            if run.z.iter().any(|z| z.is_nan() || z.abs() > LARGEST) {
                return Err(BlindError::Diverged { at_s: cut });
            }
            next_sample += 1;
        }
        for (i, look) in looks.iter_mut().enumerate() {
            let due = *look as f64 * period_s - plant.sensor_delays[i];
            if *look < samples && (cut - due).abs() < 2.0 * SAME {
                motion.seen[*look * outputs + i] = run.output(i);
                *look += 1;
            }
        }
        if let Some(end) = cuts.get(index + 1) {
            run.advance(*end);
        }
    }
    Ok(motion)
}

/// All times between which nothing jumps, from 0 to the last sample.
fn cuts(plant: &Plant, period_s: f64, samples: usize) -> Vec<f64> {
    let end = samples.saturating_sub(1) as f64 * period_s;
    let mut cuts: Vec<f64> = (0..samples).map(|k| k as f64 * period_s).collect();
    let signals = plant.inputs.iter().chain(plant.pushes.iter().map(|(_, s)| s));
    cuts.extend(signals.flat_map(|s| s.pieces().iter().map(|p| p.from)));
    for delay in plant.sensor_delays.iter().filter(|d| **d > 0.0) {
        cuts.extend((0..samples).map(|k| k as f64 * period_s - delay));
    }
    cuts.extend(plant.stages.iter().map(|s| s.0));
    cuts.retain(|t| *t >= 0.0 && *t <= end + SAME);
    cuts.sort_unstable_by(f64::total_cmp);
    cuts.dedup_by(|b, a| *b - *a < SAME);
    cuts
}
