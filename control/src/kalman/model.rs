//! The two models and their defaults.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use whirlstand_vehicle::{DiscretiseError, discretise, finite_horizon_gramian};

use super::filter::KalmanFilter;
use super::filter_model::FilterModel;
use crate::options::{Selector, Weights};
use crate::sampled_plant::SampledPlant;

/// What is measured: `y = c x + d u + noise`.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensors {
    /// p x n.
    pub c: DMatrix<f64>,
    /// p x m.
    pub d: DMatrix<f64>,
    /// Standard deviation of the noise of each output, SI units, positive.
    pub std: Vec<f64>,
    /// Names of the outputs.
    pub names: Vec<String>,
}

/// Which model the filter predicts with.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EstimatorKind {
    /// Angles from rates and positions from speeds only; angular rates from angles, no inputs.
    Kinematic,
    /// The discretised vehicle with its inputs.
    #[default]
    Model,
}

/// Options of the filter; in a launch file, the table `[estimator]`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorOptions {
    /// Which model.
    pub kind: EstimatorKind,
    /// Density of the white noise on the derivative of each state, SI units times sqrt(s), by state. Default:
    /// zero for kinematic rows; else the state's scale per sqrt(s), thrice that for the kinematic filter.
    pub process_noise: Option<Weights>,
    /// Outputs whose bias is estimated. Default: gyros, that is rates whose angle is measured as well.
    pub bias: Option<Vec<Selector>>,
    /// Standard deviation of these biases at the start, SI units. Default: ten times the output's noise.
    pub bias_std: Option<f64>,
    /// Random walk of these biases, SI units per sqrt(s). Default: a hundredth of the output's noise.
    pub bias_walk: Option<f64>,
    /// Outputs used. Default: all for the model; all but gyros for the kinematic filter, as in the paper.
    pub outputs: Option<Vec<Selector>>,
}

/// Why an estimator cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EstimatorError {
    /// Sensors that do not fit the plant.
    #[error("the sensors do not fit the plant: {0}")]
    Sensors(String),
    /// An option that names nothing, or has a wrong value.
    #[error("`{option}`: {why}")]
    Option {
        /// The option.
        option: &'static str,
        /// What is wrong.
        why: String,
    },
    /// A state or bias that the outputs do not show.
    #[error("{what} cannot be told from the outputs {outputs}; measure more, or estimate fewer biases")]
    Unobservable {
        /// What.
        what: String,
        /// The outputs used.
        outputs: String,
    },
    /// An unstable mode is too fast for the period.
    #[error("the filter cannot be sampled: {0}; an unstable mode of the plant is too fast for this period")]
    Discretise(#[from] DiscretiseError),
}

/// A Kalman filter for the states of a plant and the biases of its sensors.
///
/// A step allocates nothing and cannot panic.
#[derive(Debug, Clone)]
pub struct Estimator {
    filter: KalmanFilter,
    states: usize,
    used: u64,
    /// Per output, the bias state, or none.
    bias_state: Vec<Option<usize>>,
    bias: Vec<f64>,
    steps: u64,
}

impl Estimator {
    /// Prepares the filter.
    ///
    /// # Errors
    /// [`EstimatorError`] names the output, option or state that stands in the way.
    pub fn new(
        plant: &SampledPlant,
        sensors: &Sensors,
        options: &EstimatorOptions,
    ) -> Result<Self, EstimatorError> {
        let (n, p) = (plant.state_count(), sensors.c.nrows());
        check(plant, sensors)?;
        let kinematics = plant.kinematic_rows();
        let shows: Vec<Option<usize>> = (0..p).map(|i| shown_state(sensors, i)).collect();
        // A gyro: it shows a rate that the inputs drive and whose angle is measured too. Speeds are driven by angles.
        let gyro = |i: usize| {
            shows[i].is_some_and(|j| {
                let driven = plant.b().row(j).iter().any(|v| *v != 0.0);
                let integral =
                    |k: usize| kinematics[k].is_some_and(|(d, _)| d == j) && shows.contains(&Some(k));
                driven && (0..n).any(integral)
            })
        };
        let used = match &options.outputs {
            Some(list) => select("outputs", list, &sensors.names)?,
            None if options.kind == EstimatorKind::Kinematic => (0..p).filter(|&i| !gyro(i)).collect(),
            None => (0..p).collect(),
        };
        let biased = match &options.bias {
            Some(list) => select("bias", list, &sensors.names)?,
            None => used.iter().copied().filter(|&i| gyro(i)).collect(),
        };
        let (model, initial) = filter_model(plant, sensors, options, &kinematics, &biased)?;
        let used_mask = used.iter().fold(0, |mask, i| mask | 1 << i);
        check_observable(plant, sensors, &model.f, &model.h, &used, &biased)?;
        let mut bias_state = vec![None; p];
        biased.iter().enumerate().for_each(|(k, &i)| bias_state[i] = Some(n + k));
        Ok(Self {
            filter: KalmanFilter::new(model, &initial),
            states: n,
            used: used_mask,
            bias_state,
            bias: vec![0.0; p],
            steps: 0,
        })
    }

    /// One step. `y` holds all p outputs, bit i of `valid` says that output i is fresh; `u_before` acted since
    /// the step before, `u_now` acts at the moment of measurement (it matters only where d is not zero).
    pub fn step(&mut self, y: &[f64], valid: u64, u_before: &[f64], u_now: &[f64]) {
        self.filter.step(y, valid & self.used, u_before, u_now);
        for (value, state) in self.bias.iter_mut().zip(&self.bias_state) {
            if let Some(k) = state {
                *value = self.filter.x()[*k];
            }
        }
        self.steps = self.steps.saturating_add(1);
    }

    /// Estimated states in the plant's order.
    pub fn x(&self) -> &[f64] {
        &self.filter.x()[..self.states]
    }

    /// Standard deviation of the states.
    pub fn std(&self) -> &[f64] {
        &self.filter.std()[..self.states]
    }

    /// Estimated bias of each output; zero where none is estimated.
    pub fn bias(&self) -> &[f64] {
        &self.bias
    }

    /// Normalised innovation squared of the last step, chi-square with [`Self::dof`] degrees of freedom.
    pub fn nis(&self) -> f64 {
        self.filter.nis()
    }

    /// Number of measurements used in the last step.
    pub fn dof(&self) -> u32 {
        self.filter.dof()
    }

    /// Whether the gains have settled.
    pub fn converged(&self) -> bool {
        self.filter.settled()
    }

    /// The filter itself, with its biases and covariance.
    pub fn filter(&self) -> &KalmanFilter {
        &self.filter
    }
}

fn check(plant: &SampledPlant, sensors: &Sensors) -> Result<(), EstimatorError> {
    let (n, m, p) = (plant.state_count(), plant.input_count(), sensors.c.nrows());
    let bad = |why: String| Err(EstimatorError::Sensors(why));
    if p == 0 || p > 64 {
        return bad(format!("there are {p} outputs; 1 to 64 are needed"));
    }
    if sensors.c.ncols() != n
        || sensors.d.shape() != (p, m)
        || sensors.std.len() != p
        || sensors.names.len() != p
    {
        return bad(format!(
            "c is {:?}, d {:?}, with {} standard deviations and {} names; {p} x {n}, {p} x {m}, {p} and {p} are needed",
            sensors.c.shape(),
            sensors.d.shape(),
            sensors.std.len(),
            sensors.names.len()
        ));
    }
    if sensors.c.iter().chain(sensors.d.iter()).any(|v| !v.is_finite()) {
        return bad("c or d has an entry that is not finite".into());
    }
    match sensors.std.iter().position(|s| !(s.is_finite() && *s > 0.0)) {
        Some(i) => bad(format!(
            "the noise of {} is {}; it has to be positive (quantisation alone gives its step over sqrt(12))",
            sensors.names[i], sensors.std[i]
        )),
        None => Ok(()),
    }
}

/// The one state that output `i` shows as it is, if so.
fn shown_state(sensors: &Sensors, i: usize) -> Option<usize> {
    let entries: Vec<usize> = (0..sensors.c.ncols()).filter(|&j| sensors.c[(i, j)] != 0.0).collect();
    match entries[..] {
        [j] if sensors.c[(i, j)] == 1.0 => Some(j),
        _ => None,
    }
}

fn select(option: &'static str, list: &[Selector], names: &[String]) -> Result<Vec<usize>, EstimatorError> {
    list.iter()
        .map(|s| match s {
            Selector::Index(i) if *i < names.len() => Ok(*i),
            Selector::Index(i) => Err(EstimatorError::Option {
                option,
                why: format!("there is no output {i}; there are {}, counted from 0", names.len()),
            }),
            Selector::Name(name) => {
                names.iter().position(|n| n == name).ok_or_else(|| EstimatorError::Option {
                    option,
                    why: format!("{name:?} is not an output; the outputs are {}", names.join(", ")),
                })
            }
        })
        .collect()
}

fn process_noise(
    plant: &SampledPlant,
    options: &EstimatorOptions,
    kinematics: &[Option<(usize, f64)>],
) -> Result<Vec<f64>, EstimatorError> {
    let factor = if options.kind == EstimatorKind::Kinematic { 3.0 } else { 1.0 };
    let mut noise: Vec<f64> = (0..plant.state_count())
        .map(|i| if kinematics[i].is_some() { 0.0 } else { factor * plant.scales()[i] })
        .collect();
    let option = "process_noise";
    match &options.process_noise {
        None => {}
        Some(Weights::Uniform(v)) => noise.fill(*v),
        Some(Weights::List(list)) if list.len() == noise.len() => noise.clone_from(list),
        Some(Weights::List(list)) => {
            let why = format!("it has {} entries, but there are {} states", list.len(), noise.len());
            return Err(EstimatorError::Option { option, why });
        }
        Some(Weights::ByName(map)) => {
            for (name, value) in map {
                let Some(i) = plant.state_names().iter().position(|n| n == name) else {
                    let why =
                        format!("{name:?} is not a state; the states are {}", plant.state_names().join(", "));
                    return Err(EstimatorError::Option { option, why });
                };
                noise[i] = *value;
            }
        }
    }
    match noise.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
        Some(v) => Err(EstimatorError::Option { option, why: format!("{v} is not zero or positive") }),
        None => Ok(noise),
    }
}

/// The sampled model of the states with the biases of the outputs `biased` behind them, and the standard deviations from
/// which they start.
fn filter_model(
    plant: &SampledPlant,
    sensors: &Sensors,
    options: &EstimatorOptions,
    kinematics: &[Option<(usize, f64)>],
    biased: &[usize],
) -> Result<(FilterModel, Vec<f64>), EstimatorError> {
    let (n, m, p, nb) = (plant.state_count(), plant.input_count(), sensors.c.nrows(), biased.len());
    let dt = plant.period_s();
    let (a, b, d) = match options.kind {
        EstimatorKind::Model => (plant.a().clone(), plant.b().clone(), sensors.d.clone()),
        EstimatorKind::Kinematic => {
            let entry = |i: usize, j: usize| kinematics[i].filter(|(d, _)| *d == j).map_or(0.0, |(_, c)| c);
            (DMatrix::from_fn(n, n, entry), DMatrix::zeros(n, m), DMatrix::zeros(p, m))
        }
    };
    let (phi, gamma) = discretise(&a, &b, dt)?;
    let mut f = DMatrix::identity(n + nb, n + nb);
    f.view_mut((0, 0), (n, n)).copy_from(&phi);
    let mut g = DMatrix::zeros(n + nb, m);
    g.view_mut((0, 0), (n, m)).copy_from(&gamma);
    let mut h = DMatrix::zeros(p, n + nb);
    h.view_mut((0, 0), (p, n)).copy_from(&sensors.c);
    // Covariance that the states gather in a period from white noise of these densities on their derivatives.
    let noise = process_noise(plant, options, kinematics)?;
    let density = DMatrix::from_fn(n, n, |i, j| if i == j { noise[i] * noise[i] } else { 0.0 });
    let mut q = DMatrix::zeros(n + nb, n + nb);
    q.view_mut((0, 0), (n, n)).copy_from(&finite_horizon_gramian(&a, &density, dt)?);
    let mut initial: Vec<f64> = plant.scales().iter().map(|s| 10.0 * s).collect();
    for (k, &i) in biased.iter().enumerate() {
        h[(i, n + k)] = 1.0;
        initial.push(options.bias_std.unwrap_or(10.0 * sensors.std[i]));
        let walk = options.bias_walk.unwrap_or(0.01 * sensors.std[i]);
        q[(n + k, n + k)] = walk * walk * dt;
    }
    let variance = sensors.std.iter().map(|s| s * s).collect();
    Ok((FilterModel { f, g, h, d, q, variance }, initial))
}

/// The observability test of Popov, Belevitch and Hautus at every eigenvalue on or outside the unit circle.
fn check_observable(
    plant: &SampledPlant,
    sensors: &Sensors,
    f: &DMatrix<f64>,
    h: &DMatrix<f64>,
    used: &[usize],
    biased: &[usize],
) -> Result<(), EstimatorError> {
    let n = plant.state_count();
    let scale = |j: usize| if j < n { plant.scales()[j] } else { sensors.std[biased[j - n]] };
    let size = f.nrows();
    let scaled_f = DMatrix::from_fn(size, size, |i, j| f[(i, j)] * scale(j) / scale(i));
    let scaled_h =
        DMatrix::from_fn(used.len(), size, |i, j| h[(used[i], j)] * scale(j) / sensors.std[used[i]]);
    let modes = crate::place::uncontrollability(&scaled_f.transpose(), &scaled_h.transpose())
        .map_err(|e| EstimatorError::Sensors(e.to_string()))?;
    let hidden = modes.iter().find(|(mode, distance)| mode.norm() > 1.0 - 1e-9 && *distance < 1e-12);
    if hidden.is_none() {
        return Ok(());
    }
    let outputs = used.iter().map(|&i| sensors.names[i].as_str()).collect::<Vec<_>>().join(", ");
    let what = if biased.is_empty() {
        "the full state".to_owned()
    } else {
        let names: Vec<_> = biased.iter().map(|&i| sensors.names[i].as_str()).collect();
        format!("the state together with the bias of {}", names.join(", "))
    };
    Err(EstimatorError::Unobservable { what, outputs })
}
