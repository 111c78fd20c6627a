//! Responses of a designed loop over frequency and over time, for plots.

use nalgebra::DVector;
use whirlstand_linalg::{C64, DecompositionError};

use crate::design::Design;
use crate::target::Target;

/// Number of points of a frequency response.
const FREQUENCIES: usize = 400;
/// Lowest frequency, in decades below the Nyquist frequency.
const DECADES: f64 = 4.0;
/// Length of a step response in time constants of the slowest pole, and its largest number of steps.
const TIME_CONSTANTS: f64 = 6.0;
const MOST_STEPS: usize = 20_000;
/// Largest change of a steady state, in scales per second.
const REST: f64 = 1e-9;

/// Frequency and step responses of a loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Responses {
    /// Frequencies, rad/s.
    pub frequency_rad_s: Vec<f64>,
    /// Return ratio of each loop, the others closed, at each frequency.
    pub loops: Vec<Vec<C64>>,
    /// Greatest singular value of the sensitivity `(I + L)^-1` at each frequency.
    pub sensitivity: Vec<f64>,
    /// Responses to steps of the setpoints that have a steady state.
    pub steps: Vec<Step>,
}

/// The response of the loop to a step of one setpoint, without the limits of its inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// Index of the state whose setpoint steps.
    pub state: usize,
    /// Size of the step, SI.
    pub size: f64,
    /// Time, s.
    pub time_s: Vec<f64>,
    /// Value of the state, SI.
    pub value: Vec<f64>,
    /// Commands in force, one vector per input.
    pub inputs: Vec<Vec<f64>>,
}

impl Responses {
    /// Responses of a designed loop; for sliding mode, within its boundary layer.
    ///
    /// # Errors
    /// [`DecompositionError`] when singular values do not converge.
    pub fn of(design: &Design) -> Result<Self, DecompositionError> {
        let ratio = design.return_ratio();
        let top = std::f64::consts::PI / ratio.period_s;
        let frequency_rad_s: Vec<f64> = (0..=FREQUENCIES)
            .map(|k| top * 10f64.powf(DECADES * (k as f64 / FREQUENCIES as f64 - 1.0)))
            .collect();
        let loops = (0..ratio.inputs())
            .map(|i| frequency_rad_s.iter().map(|w| ratio.loop_at(i, *w)).collect())
            .collect();
        let sensitivity = frequency_rad_s
            .iter()
            .map(|w| Ok(1.0 / ratio.smallest_difference(*w)?))
            .collect::<Result<_, _>>()?;
        let states = 0..design.plant.own_count();
        Ok(Self {
            frequency_rad_s,
            loops,
            sensitivity,
            steps: states.filter_map(|i| step(design, i)).collect(),
        })
    }
}

/// Response to a setpoint step of state `i` by its scale; `None` when the plant has no such steady state.
fn step(design: &Design, i: usize) -> Option<Step> {
    let plant = &design.plant;
    let (n, m, all) = (plant.state_count(), plant.input_count(), plant.size());
    let mut target = Target::new(plant);
    target.track(1 << i);
    if target.freed().iter().any(|freed| *freed) {
        return None;
    }
    let size = plant.scales()[i];
    let mut reference = vec![0.0; n];
    reference[i] = size;
    let (mut x, mut u) = (vec![0.0; n], vec![0.0; m]);
    target.evaluate(&reference, &mut x, &mut u);
    let (x, u) = (DVector::from_vec(x), DVector::from_vec(u));
    let moving = plant.a() * &x + plant.b() * &u;
    if moving.iter().zip(plant.scales()).any(|(v, scale)| v.abs() > REST * scale) {
        return None;
    }
    // The loop in deviations from its steady state; the law's memory starts at zero.
    let closed = design.linear.closed_loop(plant);
    let mut deviation = DVector::zeros(closed.nrows());
    deviation.rows_mut(0, n).copy_from(&-&x);
    // States that follow from the commands, lags and past ones, approach the steady state of these; lags are
    // in x already.
    let known = plant.memory_at_rest(u.as_slice());
    known.iter().skip(n - plant.own_count()).enumerate().for_each(|(k, v)| deviation[n + k] = -v);
    deviation.rows_mut(all, m).copy_from(&-&u);
    let steps = length(design);
    let mut answer =
        Step { state: i, size, time_s: Vec::new(), value: Vec::new(), inputs: vec![Vec::new(); m] };
    for k in 0..steps {
        answer.time_s.push(k as f64 * plant.period_s());
        answer.value.push(x[i] + deviation[i]);
        (0..m).for_each(|j| answer.inputs[j].push(u[j] + deviation[all + j]));
        deviation = &closed * deviation;
    }
    Some(answer)
}

/// Number of steps until the slowest pole has decayed.
fn length(design: &Design) -> usize {
    let slowest = design
        .closed_loop_poles
        .iter()
        .filter_map(|p| p.continuous.map(|[re, _]| -re))
        .filter(|decay| *decay > 0.0)
        .fold(f64::INFINITY, f64::min);
    let steps = TIME_CONSTANTS / slowest / design.plant.period_s();
    if steps.is_finite() { (steps.ceil() as usize).clamp(20, MOST_STEPS) } else { MOST_STEPS }
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::*;
    use crate::options::{LawOptions, LqrOptions};
    use crate::sampled_plant::SampledPlant;

    /// A double integrator: an angle and its rate.
    fn design() -> Design {
        let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 0.0, 0.0]);
        let b = DMatrix::from_row_slice(2, 1, &[0.0, 1.0]);
        let plant = SampledPlant::new(a, b, 0.01).unwrap().with_scales(vec![0.1, 1.0]).unwrap();
        Design::new(&plant, &LawOptions::Lqr(LqrOptions::default())).unwrap()
    }

    #[test]
    fn a_step_arrives_and_a_state_that_cannot_rest_has_none() {
        let answer = Responses::of(&design()).unwrap();
        let [step] = answer.steps.as_slice() else { panic!("{:?}", answer.steps) };
        assert_eq!((step.state, step.size, step.value[0]), (0, 0.1, 0.0));
        assert!((step.value.last().unwrap() / 0.1 - 1.0).abs() < 0.01, "{:?}", step.value.last());
        assert_eq!(step.time_s.len(), step.inputs[0].len());
    }

    #[test]
    fn the_peak_of_the_sensitivity_is_that_of_the_margins() {
        let design = design();
        let answer = Responses::of(&design).unwrap();
        let peak = answer.sensitivity.iter().copied().fold(0.0, f64::max);
        assert!((peak / design.multivariable_margins.max_sensitivity - 1.0).abs() < 1e-3, "{peak}");
        // For a single loop, the sensitivity is that of its return ratio.
        for (l, s) in answer.loops[0].iter().zip(&answer.sensitivity) {
            assert!(((l + 1.0).norm() * s - 1.0).abs() < 1e-6);
        }
    }
}
