//! The state estimator with a choice of two models.

use nalgebra::DMatrix;
use whirlstand_vehicle::{LinearModel, discretise, finite_horizon_gramian};

use super::error::EstimatorError;
use super::extended::{Extended, Ingredients, Known, kinematic};
use super::filter::KalmanFilter;
use super::filter_model::FilterModel;
use super::observability::{check_observable, shown_at_rest};
use super::offsets::{Offsets, trimmed};
use super::options::{EstimatorKind, EstimatorOptions};
use super::sensors::Sensors;
use crate::options::{Selector, Weights};
use crate::sampled_plant::SampledPlant;

/// A Kalman filter for the states of a plant and the biases of its sensors.
///
/// A step allocates nothing and cannot panic.
#[derive(Debug, Clone)]
pub struct Estimator {
    filter: KalmanFilter,
    states: usize,
    used: u64,
    /// Index of the bias state of every output; `None` without one.
    bias_state: Vec<Option<usize>>,
    bias: Vec<f64>,
    /// Index of the offset state of every input; `None` without one.
    input_bias_state: Vec<Option<usize>>,
    input_bias: Vec<f64>,
    steps: u64,
    /// States that follow from the commands alone; absent for a vehicle without effects that a filter must
    /// model.
    known: Option<Known>,
}

impl Estimator {
    /// Designs the filter.
    ///
    /// # Errors
    /// Returns an [`EstimatorError`], which names the output, option or state that prevents the design.
    pub fn new(
        plant: &SampledPlant,
        sensors: &Sensors,
        options: &EstimatorOptions,
    ) -> Result<Self, EstimatorError> {
        Self::of(plant, sensors, None, options)
    }

    /// Designs the filter for a vehicle with linear effects, given by `linear`: delayed inputs and sensors,
    /// lags, tones, and known sensor errors.
    ///
    /// # Errors
    /// Returns an [`EstimatorError`], which names the output, option or state that prevents the design.
    pub fn of(
        plant: &SampledPlant,
        sensors: &Sensors,
        linear: Option<&LinearModel>,
        options: &EstimatorOptions,
    ) -> Result<Self, EstimatorError> {
        let (n, p) = (plant.own_count(), sensors.c.nrows());
        check(plant, sensors)?;
        let kinematics = plant.kinematic_rows();
        let gyros = gyros(plant, sensors, &kinematics);
        let used = match &options.outputs {
            Some(list) => select("outputs", list, &sensors.names)?,
            None if options.kind == EstimatorKind::Kinematic => (0..p).filter(|&i| !gyros[i]).collect(),
            None => (0..p).collect(),
        };
        let biased = match &options.bias {
            Some(list) => select("bias", list, &sensors.names)?,
            None => used.iter().copied().filter(|&i| gyros[i]).collect(),
        };
        let trimmed = trimmed(plant, options)?;
        let offsets = Offsets { biased: &biased, trimmed: &trimmed };
        let mut seen = sensors.clone();
        if let Some(linear) = linear.filter(|l| !l.is_plain()) {
            seen.c = shown_at_rest(linear);
        }
        let (mut model, mut initial) = filter_model(plant, &seen, options, &kinematics, &offsets)?;
        let used_mask = used.iter().fold(0, |mask, i| mask | 1 << i);
        // Delays and lags do not affect the observability of states and biases.
        check_observable(plant, sensors, &model.f, &model.h, &used, &offsets)?;
        let (mut first_bias, mut known) = (n, None);
        if let Some(linear) = linear.filter(|l| !l.is_plain()) {
            let noise = process_noise(plant, options, &kinematics)?;
            let biases: Vec<_> = biased.iter().map(|&i| bias_noise(sensors, options, i)).collect();
            let scales = &plant.scales()[..n];
            let given = Ingredients {
                noise: &noise,
                std: &sensors.std,
                scales,
                biases: &biases,
                input_biases: &trimmed,
            };
            let extended = match options.kind {
                EstimatorKind::Model => Extended::new(linear, plant.period_s(), &given)?,
                EstimatorKind::Kinematic => {
                    Extended::new(&kinematic(linear, &kinematics), plant.period_s(), &given)?
                }
            };
            (model, initial) = (extended.model, extended.initial);
            (first_bias, known) = (extended.first_bias, Some(extended.known));
        }
        let mut bias_state = vec![None; p];
        biased.iter().enumerate().for_each(|(k, &i)| bias_state[i] = Some(first_bias + k));
        let mut input_bias_state = vec![None; plant.input_count()];
        let first_trim = first_bias + biased.len();
        trimmed.iter().enumerate().for_each(|(k, &(i, ..))| input_bias_state[i] = Some(first_trim + k));
        Ok(Self {
            filter: KalmanFilter::new(model, &initial),
            known,
            states: n,
            used: used_mask,
            bias_state,
            bias: vec![0.0; p],
            input_bias: vec![0.0; plant.input_count()],
            input_bias_state,
            steps: 0,
        })
    }

    /// Updates the estimate. `y` holds all p outputs, and bit i of `valid` means that output i is fresh;
    /// `u_before` acted since the previous step, `u_now` acts at the time of measurement (relevant only where
    /// d is not zero).
    pub fn step(&mut self, y: &[f64], valid: u64, u_before: &[f64], u_now: &[f64]) {
        match &mut self.known {
            None => self.filter.step(y, valid & self.used, u_before, u_now),
            Some(known) => {
                known.step(y, u_before, u_now);
                self.filter.step(&known.y, valid & self.used, &known.before, &known.now);
            }
        }
        let biases = self.bias.iter_mut().zip(&self.bias_state);
        for (value, state) in biases.chain(self.input_bias.iter_mut().zip(&self.input_bias_state)) {
            if let Some(k) = state {
                *value = self.filter.x()[*k];
            }
        }
        self.steps = self.steps.saturating_add(1);
    }

    /// Sets the step number of the next update, where it does not follow the last one, as for a filter that
    /// starts late.
    pub fn set_step(&mut self, step: u64) {
        if let Some(known) = &mut self.known {
            known.set_step(step);
        }
    }

    /// Estimated states in the plant's order.
    pub fn x(&self) -> &[f64] {
        &self.filter.x()[..self.states]
    }

    /// Standard deviations of the states.
    pub fn std(&self) -> &[f64] {
        &self.filter.std()[..self.states]
    }

    /// Estimated bias of each output; zero for outputs without one.
    pub fn bias(&self) -> &[f64] {
        &self.bias
    }

    /// Estimated offset of each input, as an equivalent steady command; zero for inputs without one.
    pub fn input_bias(&self) -> &[f64] {
        &self.input_bias
    }

    /// Normalised innovation squared of the last step, chi-square distributed with [`Self::dof`] degrees of
    /// freedom.
    pub fn nis(&self) -> f64 {
        self.filter.nis()
    }

    /// Number of measurements used in the last step.
    pub fn dof(&self) -> u32 {
        self.filter.dof()
    }

    /// Whether the gains have converged.
    pub fn converged(&self) -> bool {
        self.filter.settled()
    }

    /// Bit mask of the used outputs, bit i for output i.
    pub fn used(&self) -> u64 {
        self.used
    }

    /// Whether the filter uses commands and measurements unchanged.
    pub(super) fn knows_plain_inputs(&self) -> bool {
        self.known.is_none()
    }

    /// The underlying filter, with its biases and covariance.
    pub fn filter(&self) -> &KalmanFilter {
        &self.filter
    }
}

fn check(plant: &SampledPlant, sensors: &Sensors) -> Result<(), EstimatorError> {
    let (n, m, p) = (plant.own_count(), plant.input_count(), sensors.c.nrows());
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

/// The single state that output `i` measures with gain one, if any.
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
    let mut noise: Vec<f64> = (0..plant.own_count())
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
                let Some(i) = plant.own_names().iter().position(|n| n == name) else {
                    let why =
                        format!("{name:?} is not a state; the states are {}", plant.own_names().join(", "));
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

/// Discrete-time model of the states, followed by the biases of outputs and the offsets of inputs, and their
/// initial standard deviations.
fn filter_model(
    plant: &SampledPlant,
    sensors: &Sensors,
    options: &EstimatorOptions,
    kinematics: &[Option<(usize, f64)>],
    offsets: &Offsets<'_>,
) -> Result<(FilterModel, Vec<f64>), EstimatorError> {
    let (n, m, p) = (plant.own_count(), plant.input_count(), sensors.c.nrows());
    let (biased, nb) = (offsets.biased, offsets.biased.len() + offsets.trimmed.len());
    let dt = plant.period_s();
    let (a, b, d) = match options.kind {
        EstimatorKind::Model => (plant.own_a(), plant.own_b(), sensors.d.clone()),
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
    // State covariance over one period from white noise of these densities on the derivatives.
    let noise = process_noise(plant, options, kinematics)?;
    let density = DMatrix::from_fn(n, n, |i, j| if i == j { noise[i] * noise[i] } else { 0.0 });
    let mut q = DMatrix::zeros(n + nb, n + nb);
    q.view_mut((0, 0), (n, n)).copy_from(&finite_horizon_gramian(&a, &density, dt)?);
    let mut initial: Vec<f64> = plant.scales()[..n].iter().map(|s| 10.0 * s).collect();
    for (k, &i) in biased.iter().enumerate() {
        h[(i, n + k)] = 1.0;
        let (_, start, walk) = bias_noise(sensors, options, i);
        initial.push(start);
        q[(n + k, n + k)] = walk * walk * dt;
    }
    for (k, &(input, start, walk)) in offsets.trimmed.iter().enumerate() {
        let at = n + biased.len() + k;
        f.view_mut((0, at), (n, 1)).copy_from(&gamma.column(input));
        h.set_column(at, &d.column(input));
        initial.push(start);
        q[(at, at)] = walk * walk * dt;
    }
    let variance = sensors.std.iter().map(|s| s * s).collect();
    Ok((FilterModel { f, g, h, d, q, variance }, initial))
}

/// Bias parameters of an output: its index, the initial standard deviation, and the random walk per sqrt(s).
fn bias_noise(sensors: &Sensors, options: &EstimatorOptions, output: usize) -> (usize, f64, f64) {
    let std = sensors.std[output];
    (output, options.bias_std.unwrap_or(10.0 * std), options.bias_walk.unwrap_or(0.01 * std))
}

/// Whether each output is a gyro: it measures a rate that the inputs drive and whose angle is measured too.
/// (Speeds are driven by angles.)
fn gyros(plant: &SampledPlant, sensors: &Sensors, kinematics: &[Option<(usize, f64)>]) -> Vec<bool> {
    let own_b = plant.own_b();
    let shows: Vec<Option<usize>> = (0..sensors.c.nrows()).map(|i| shown_state(sensors, i)).collect();
    let is_gyro = |shown: &Option<usize>| {
        shown.is_some_and(|j| {
            let driven = own_b.row(j).iter().any(|v| *v != 0.0);
            let integral = |k: usize| kinematics[k].is_some_and(|(d, _)| d == j) && shows.contains(&Some(k));
            driven && (0..plant.own_count()).any(integral)
        })
    };
    shows.iter().map(is_gyro).collect()
}
