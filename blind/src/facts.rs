//! Properties of a nominal flight, which set the scales of the drawn effects.

use whirlstand_vehicle::Vehicle;

use super::commands::Commands;
use super::error::BlindError;
use super::hidden::Hidden;
use super::motion::fly;
use super::truth_model::TruthModel;
use super::turbulence::Spectrum;

/// Signal sizes of a flight without hidden effects.
pub(crate) struct Facts {
    pub length_s: f64,
    pub period_s: f64,
    /// Range of each input; `y` and `x` hold those of the outputs and the states.
    pub u: Vec<Range>,
    pub y: Vec<Range>,
    pub x: Vec<Range>,
    /// Root mean square of the terms of each state's derivative, summed in quadrature.
    pub force: Vec<f64>,
    /// States whose derivative is not just another state.
    pub dynamic: Vec<usize>,
}

/// Least and greatest value of a signal, and its rms.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Range {
    pub low: f64,
    pub high: f64,
    pub rms: f64,
}

impl Range {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let (mut low, mut high, mut square, mut count) = (0.0f64, 0.0f64, 0.0, 0u32);
        for v in values {
            (low, high) = (low.min(v), high.max(v));
            square += v * v;
            count += 1;
        }
        Self { low, high, rms: (square / f64::from(count.max(1))).sqrt() }
    }

    /// Largest magnitude of the signal.
    pub fn peak(&self) -> f64 {
        self.high.max(-self.low)
    }

    /// Whether the smaller side exceeds 0.3 of the peak.
    pub fn two_sided(&self) -> bool {
        self.high.min(-self.low) > 0.3 * self.peak()
    }
}

impl Facts {
    /// Simulates the vehicle without hidden effects and measures its signals.
    pub fn new(vehicle: &Vehicle, commands: &Commands, x0: &[f64]) -> Result<Self, BlindError> {
        let hidden =
            Hidden { effects: &[], outside: None, expected: true, spectrum: Spectrum::FirstOrder, trial: 0 };
        let model = TruthModel::new(vehicle, commands, hidden)?;
        let motion = fly(&model, x0, commands.period_s, commands.samples())?;
        let (n, p) = (vehicle.states.len(), vehicle.outputs.len());
        let column =
            |all: &[f64], i: usize, width: usize| Range::of(all.iter().skip(i).step_by(width).copied());
        let x: Vec<Range> = (0..n).map(|i| column(&motion.states, i, n)).collect();
        let y = (0..p).map(|i| column(&motion.sensed, i, p)).collect();
        let u: Vec<Range> = commands.inputs.iter().map(|u| Range::of(u.iter().copied())).collect();
        let force = (0..n)
            .map(|i| {
                let own = (0..n).map(|j| (vehicle.a[(i, j)] * x[j].rms).powi(2));
                let driven = (0..u.len()).map(|j| (vehicle.b[(i, j)] * u[j].rms).powi(2));
                own.chain(driven).sum::<f64>().sqrt()
            })
            .collect();
        Ok(Self {
            length_s: commands.duration_s(),
            period_s: commands.period_s,
            u,
            y,
            x,
            force,
            dynamic: dynamic(vehicle),
        })
    }
}

/// States with more than one term in their rows of A and B: forces act on these, not on integrals of a rate.
pub(crate) fn dynamic(vehicle: &Vehicle) -> Vec<usize> {
    let terms =
        |i: usize| vehicle.a.row(i).iter().chain(vehicle.b.row(i).iter()).filter(|v| **v != 0.0).count();
    (0..vehicle.states.len()).filter(|i| terms(*i) > 1).collect()
}
