//! The plant of a law or a filter.

use nalgebra::DMatrix;
use serde::Serialize;
use thiserror::Error;
use whirlstand_vehicle::{LinearModel, discretise, kinematic_row};

use crate::input_limits::InputLimits;
use crate::sampled_model::SampledModel;
use crate::scales::default_scales;

/// A linear plant with input limits, controlled once per period.
///
/// `x' = a x + b u`, with a zero-order hold on u. Units are SI; states and inputs are in the vehicle's order.
/// Where the inputs have lags or modes, x has their states after the vehicle's own; where they are delayed,
/// past commands are states of the sampled plant as well ([`Self::transition`]). Both follow from the
/// commands alone, so that they need no estimate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SampledPlant {
    #[serde(serialize_with = "crate::rows::serialize")]
    a: DMatrix<f64>,
    #[serde(serialize_with = "crate::rows::serialize")]
    b: DMatrix<f64>,
    #[serde(skip)]
    phi: DMatrix<f64>,
    #[serde(skip)]
    gamma: DMatrix<f64>,
    period_s: f64,
    inputs: Vec<InputLimits>,
    state_names: Vec<String>,
    input_names: Vec<String>,
    scales: Vec<f64>,
    /// Number of the vehicle's own states, which come first.
    own: usize,
    delays_s: Vec<f64>,
    trim: Vec<f64>,
    /// Names of the past commands that are states.
    memory_names: Vec<String>,
    #[serde(skip)]
    delayed: Option<SampledModel>,
}

/// Largest number of past commands, over all inputs.
const MOST_PAST_COMMANDS: usize = 256;

/// Errors of a plant.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SampledPlantError {
    /// Matrices or lists have incompatible shapes.
    #[error("{what} has {got} {unit}, but {wanted} are needed")]
    Size {
        /// Name of the matrix or list.
        what: &'static str,
        /// Size found.
        got: usize,
        /// Size needed.
        wanted: usize,
        /// Unit of the sizes: rows, columns or entries.
        unit: &'static str,
    },
    /// NaN or infinity, or no state or no input.
    #[error("{0}")]
    Value(String),
}

impl SampledPlant {
    /// A plant without input limits. `a` is n x n, `b` n x m, `period_s` the control period in s.
    ///
    /// # Errors
    /// [`SampledPlantError`] when shapes do not fit, an entry is not finite or the period is not positive.
    pub fn new(a: DMatrix<f64>, b: DMatrix<f64>, period_s: f64) -> Result<Self, SampledPlantError> {
        let (n, m) = (a.nrows(), b.ncols());
        if n == 0 || m == 0 {
            return Err(SampledPlantError::Value("the plant needs at least one state and one input".into()));
        }
        if n > 64 || m > 64 {
            return Err(SampledPlantError::Value(format!(
                "the plant has {n} states and {m} inputs; at most 64 of each can be controlled"
            )));
        }
        if a.ncols() != n {
            return Err(SampledPlantError::Size { what: "A", got: a.ncols(), wanted: n, unit: "columns" });
        }
        if b.nrows() != n {
            return Err(SampledPlantError::Size { what: "B", got: b.nrows(), wanted: n, unit: "rows" });
        }
        for (what, matrix) in [("A", &a), ("B", &b)] {
            if let Some(at) = matrix.iter().position(|v| !v.is_finite()) {
                let (row, column) = (at % n + 1, at / n + 1);
                return Err(SampledPlantError::Value(format!("{what}[{row},{column}] is not finite")));
            }
        }
        if !(period_s.is_finite() && period_s > 0.0) {
            return Err(SampledPlantError::Value(format!(
                "the period is {period_s} s; it has to be positive"
            )));
        }
        let (phi, gamma) = discretise(&a, &b, period_s).map_err(|_| {
            SampledPlantError::Value(format!(
                "the plant discretised at {period_s} s overflows; its fastest unstable mode is too fast for this period"
            ))
        })?;
        Ok(Self {
            inputs: vec![InputLimits::NONE; m],
            state_names: (1..=n).map(|i| format!("x{i}")).collect(),
            input_names: (1..=m).map(|i| format!("u{i}")).collect(),
            scales: default_scales(&a, &phi, &gamma, &vec![InputLimits::NONE; m], period_s),
            a,
            b,
            phi,
            gamma,
            period_s,
            own: n,
            delays_s: vec![0.0; m],
            trim: vec![0.0; m],
            memory_names: Vec::new(),
            delayed: None,
        })
    }

    /// A vehicle with the linear effects on its motion, without limits.
    ///
    /// # Errors
    /// [`SampledPlantError`] as [`Self::new`], and when delays are too long for the period.
    pub fn of(model: &LinearModel, period_s: f64) -> Result<Self, SampledPlantError> {
        let own = model.own;
        let mut plant = Self::new(
            model.a.view((0, 0), (own, own)).into_owned(),
            equivalent_input(model, own)?,
            period_s,
        )?;
        plant.trim.clone_from(&model.trim);
        if model.is_prompt() {
            return Ok(plant);
        }
        let (motion, inputs) = (own + model.actuators, model.b.ncols());
        let fast = |_| SampledPlantError::Value(format!("the plant discretised at {period_s} s overflows"));
        plant.a = model.a.view((0, 0), (motion, motion)).into_owned();
        plant.b = model.b.rows(0, motion).into_owned();
        (plant.phi, plant.gamma) = discretise(&plant.a, &plant.b, period_s).map_err(fast)?;
        plant.state_names.extend(model.names.iter().take(model.actuators).cloned());
        plant.delays_s.clone_from(&model.input_delays_s);
        if plant.delays_s.iter().any(|d| *d > 0.0) {
            let periods: f64 = plant.delays_s.iter().map(|d| (d / period_s).ceil()).sum();
            if periods > MOST_PAST_COMMANDS as f64 {
                return Err(SampledPlantError::Value(format!(
                    "the input delays are {periods} periods of {period_s} s together; a law can look back over \
                     {MOST_PAST_COMMANDS} at most. Choose a lower rate"
                )));
            }
            plant.delayed = Some(SampledModel::motion(model, period_s).map_err(fast)?);
        }
        plant.set_scales(&vec![InputLimits::NONE; inputs]);
        plant.name_memory();
        Ok(plant)
    }

    /// Sets the names of the past commands from those of the inputs.
    fn name_memory(&mut self) {
        let Some(model) = &self.delayed else { return };
        let counts = self.input_names.iter().zip(&model.layout.commands);
        self.memory_names = counts
            .flat_map(|(name, count)| (1..=*count).map(move |back| format!("{name} -{back}")))
            .collect();
    }

    /// Sets the default scales: those of the plant without lags and delays, and for lags and modes their
    /// response to full input.
    fn set_scales(&mut self, limits: &[InputLimits]) {
        if self.own == self.state_count() {
            self.scales = default_scales(&self.a, &self.phi, &self.gamma, limits, self.period_s);
            return;
        }
        let (a, b) = (self.own_a(), self.own_b());
        let sampled = discretise(&a, &b, self.period_s);
        self.scales = match sampled {
            Ok((phi, gamma)) => default_scales(&a, &phi, &gamma, limits, self.period_s),
            Err(_) => vec![1.0; self.own],
        };
        let rest = self.actuator_rest();
        let reach = |row: usize| -> f64 {
            limits.iter().enumerate().map(|(j, l)| rest[(row, j)].abs() * l.authority()).sum()
        };
        let reaches: Vec<f64> = (0..rest.nrows()).map(reach).collect();
        let largest = reaches.iter().copied().fold(0.0, f64::max);
        let sized = |r: f64| match r {
            r if r > 1e-9 * largest => r,
            _ if largest > 0.0 => largest,
            _ => 1.0,
        };
        self.scales.extend(reaches.into_iter().map(sized));
    }

    /// Sets the limits of all m inputs, and the default scales of the states that follow from them.
    ///
    /// # Errors
    /// [`SampledPlantError`] when their number is not m, or a lower limit is not below the upper one.
    pub fn with_limits(mut self, inputs: Vec<InputLimits>) -> Result<Self, SampledPlantError> {
        check_count("the input limits", inputs.len(), self.input_count())?;
        for (i, limits) in inputs.iter().enumerate() {
            let ordered = limits.lower < limits.upper && limits.rate > 0.0;
            if !ordered {
                return Err(SampledPlantError::Value(format!(
                    "input {} has the limits {} to {} at a rate of {}; the lower one has to be below the upper one and \
                     the rate positive",
                    self.input_names[i], limits.lower, limits.upper, limits.rate
                )));
            }
        }
        self.set_scales(&inputs);
        self.inputs = inputs;
        Ok(self)
    }

    /// Sets the names used in options and messages.
    ///
    /// # Errors
    /// [`SampledPlantError`] when their numbers are not n and m.
    pub fn with_names(mut self, states: Vec<String>, inputs: Vec<String>) -> Result<Self, SampledPlantError> {
        check_count("the state names", states.len(), self.own)?;
        check_count("the input names", inputs.len(), self.input_count())?;
        self.state_names.splice(..self.own, states);
        self.input_names = inputs;
        self.name_memory();
        Ok(self)
    }

    /// Sets the scale of each state: the excursion that matters as much as full input (Bryson's rule). The
    /// default is a tenth of the response to full input in two seconds; for positions, a thirtieth of that in
    /// ten.
    ///
    /// # Errors
    /// [`SampledPlantError`] when their number is not n or one is not positive.
    pub fn with_scales(mut self, scales: Vec<f64>) -> Result<Self, SampledPlantError> {
        check_count("the state scales", scales.len(), self.state_count())?;
        if let Some(i) = scales.iter().position(|s| !(s.is_finite() && *s > 0.0)) {
            return Err(SampledPlantError::Value(format!(
                "the scale of state {} is {}; it has to be positive",
                self.state_names[i], scales[i]
            )));
        }
        self.scales = scales;
        Ok(self)
    }

    /// System matrix, n x n, 1/s.
    pub fn a(&self) -> &DMatrix<f64> {
        &self.a
    }
    /// Input matrix, n x m.
    pub fn b(&self) -> &DMatrix<f64> {
        &self.b
    }
    /// Discrete system matrix, n x n.
    pub fn phi(&self) -> &DMatrix<f64> {
        &self.phi
    }
    /// Discrete input matrix, n x m.
    pub fn gamma(&self) -> &DMatrix<f64> {
        &self.gamma
    }
    /// Control period, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }
    /// Limits of the inputs.
    pub fn inputs(&self) -> &[InputLimits] {
        &self.inputs
    }
    /// Names of the states.
    pub fn state_names(&self) -> &[String] {
        &self.state_names
    }
    /// Names of the vehicle's own states, without those of lags and modes.
    pub fn own_names(&self) -> &[String] {
        &self.state_names[..self.own]
    }
    /// Names of the inputs.
    pub fn input_names(&self) -> &[String] {
        &self.input_names
    }
    /// Scales of the states, see [`Self::with_scales`].
    pub fn scales(&self) -> &[f64] {
        &self.scales
    }
    /// Number of states, n.
    pub fn state_count(&self) -> usize {
        self.a.nrows()
    }
    /// Number of the vehicle's own states: those that are estimated and have a reference.
    pub fn own_count(&self) -> usize {
        self.own
    }
    /// Number of states of the sampled plant, past commands included.
    pub fn size(&self) -> usize {
        self.state_count() + self.memory_names.len()
    }
    /// Transition matrix of the sampled plant, N x N.
    pub fn transition(&self) -> &DMatrix<f64> {
        self.delayed.as_ref().map_or(&self.phi, |m| &m.f)
    }
    /// Input matrix of the sampled plant, N x m.
    pub fn drive(&self) -> &DMatrix<f64> {
        self.delayed.as_ref().map_or(&self.gamma, |m| &m.g)
    }
    /// The plant with its delays; absent when no input is delayed.
    pub fn delayed(&self) -> Option<&SampledModel> {
        self.delayed.as_ref()
    }
    /// Delay of each input, s.
    pub fn delays_s(&self) -> &[f64] {
        &self.delays_s
    }
    /// Command of each input at which it has no effect.
    pub fn trim(&self) -> &[f64] {
        &self.trim
    }
    /// Names of the past commands that are states.
    pub fn memory_names(&self) -> &[String] {
        &self.memory_names
    }
    /// System matrix of the vehicle's own states.
    pub fn own_a(&self) -> DMatrix<f64> {
        self.a.view((0, 0), (self.own, self.own)).into_owned()
    }
    /// Input matrix to the vehicle's own states with lags and modes in their steady state.
    pub fn own_b(&self) -> DMatrix<f64> {
        let own = self.b.rows(0, self.own).into_owned();
        match self.state_count() - self.own {
            0 => own,
            count => own + self.a.view((0, self.own), (self.own, count)) * self.actuator_rest(),
        }
    }
    /// Steady state of lags and modes, as a function of the inputs.
    pub fn actuator_rest(&self) -> DMatrix<f64> {
        let (own, count) = (self.own, self.state_count() - self.own);
        let a = self.a.view((own, own), (count, count)).into_owned();
        rest_of(a, &self.b.rows(own, count).into_owned())
    }
    /// States that follow from the commands, in their steady state under the constant commands `u`.
    pub fn memory_at_rest(&self, u: &[f64]) -> Vec<f64> {
        let rest = self.actuator_rest() * nalgebra::DVector::from_column_slice(u);
        let past = self.delayed.iter().flat_map(|m| m.layout.commands.iter().zip(u));
        rest.iter().copied().chain(past.flat_map(|(count, u)| vec![*u; *count])).collect()
    }
    /// Scales of all states of the sampled plant: those of the plant, and the authority of past commands.
    pub fn all_scales(&self) -> Vec<f64> {
        let past = self.delayed.iter().flat_map(|m| m.layout.commands.iter().zip(&self.inputs));
        self.scales.iter().copied().chain(past.flat_map(|(n, l)| vec![l.authority(); *n])).collect()
    }
    /// Number of inputs, m.
    pub fn input_count(&self) -> usize {
        self.b.ncols()
    }

    /// For each of the vehicle's own states, the state of which it is the integral by definition, with the
    /// coefficient; see [`whirlstand_vehicle::kinematic_row`].
    pub fn kinematic_rows(&self) -> Vec<Option<(usize, f64)>> {
        let (a, b) = (self.own_a(), self.own_b());
        (0..self.own).map(|i| kinematic_row(&a, &b, i)).collect()
    }
}

/// Input matrix to the own states with lags and modes in their steady state.
fn equivalent_input(model: &LinearModel, own: usize) -> Result<DMatrix<f64>, SampledPlantError> {
    let count = model.actuators;
    if count == 0 {
        return Ok(model.b.rows(0, own).into_owned());
    }
    let a = model.a.view((own, own), (count, count)).into_owned();
    let b = model.b.rows(0, own)
        + model.a.view((0, own), (own, count)) * rest_of(a, &model.b.rows(own, count).into_owned());
    if b.iter().any(|v| !v.is_finite()) {
        return Err(SampledPlantError::Value(
            "a mode on an input without damping never comes to rest".into(),
        ));
    }
    Ok(b)
}

/// `-a^-1 b`; `a` is invertible for lags and modes.
fn rest_of(a: DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    if a.is_empty() {
        return b.clone();
    }
    a.lu().solve(b).map_or_else(|| DMatrix::from_element(b.nrows(), b.ncols(), f64::NAN), |x| -x)
}

fn check_count(what: &'static str, got: usize, wanted: usize) -> Result<(), SampledPlantError> {
    if got == wanted { Ok(()) } else { Err(SampledPlantError::Size { what, got, wanted, unit: "entries" }) }
}
