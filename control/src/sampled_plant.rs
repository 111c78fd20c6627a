//! The vehicle as a law or a filter sees it.

use nalgebra::DMatrix;
use serde::Serialize;
use thiserror::Error;
use whirlstand_vehicle::{discretise, kinematic_row};

/// A linear plant with input limits, to be controlled once a period.
///
/// `x' = a x + b u`, a zero-order hold on u. Units are SI; the order of states and inputs is the vehicle's.
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
}

/// What one actuator can do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct InputLimits {
    /// Smallest value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Largest rate of change, 1/s; infinite when there is none.
    pub rate: f64,
}

impl InputLimits {
    /// No limit at all.
    pub const NONE: Self = Self { lower: f64::NEG_INFINITY, upper: f64::INFINITY, rate: f64::INFINITY };

    /// The smaller distance from neutral (zero) to a limit; one when the input is not limited.
    pub fn authority(&self) -> f64 {
        let reach = self.upper.min(-self.lower);
        if reach.is_finite() && reach > 0.0 { reach } else { 1.0 }
    }
}

/// What is wrong with a plant.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SampledPlantError {
    /// Matrices that do not fit.
    #[error("{what} has {got} {unit}, but {wanted} are needed")]
    Size {
        /// The matrix or list.
        what: &'static str,
        /// Found.
        got: usize,
        /// Needed.
        wanted: usize,
        /// Rows, columns or entries.
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
        })
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
        self.scales = default_scales(&self.a, &self.phi, &self.gamma, &inputs, self.period_s);
        self.inputs = inputs;
        Ok(self)
    }

    /// Sets the names used in options and messages.
    ///
    /// # Errors
    /// [`SampledPlantError`] when their numbers are not n and m.
    pub fn with_names(mut self, states: Vec<String>, inputs: Vec<String>) -> Result<Self, SampledPlantError> {
        check_count("the state names", states.len(), self.state_count())?;
        check_count("the input names", inputs.len(), self.input_count())?;
        (self.state_names, self.input_names) = (states, inputs);
        Ok(self)
    }

    /// Sets the size of an excursion of each state that matters as much as full input does (Bryson's rule). The
    /// default is a tenth of what full input reaches in two seconds; for positions, a thirtieth of that in ten.
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
    /// Names of the inputs.
    pub fn input_names(&self) -> &[String] {
        &self.input_names
    }
    /// Size of the states, see [`Self::with_scales`].
    pub fn scales(&self) -> &[f64] {
        &self.scales
    }
    /// Number of states, n.
    pub fn state_count(&self) -> usize {
        self.a.nrows()
    }
    /// Number of inputs, m.
    pub fn input_count(&self) -> usize {
        self.b.ncols()
    }

    /// For each state, of which other state it is the integral by definition; see [`whirlstand_vehicle::kinematic_row`].
    pub fn kinematic_rows(&self) -> Vec<Option<(usize, f64)>> {
        (0..self.state_count()).map(|i| kinematic_row(&self.a, &self.b, i)).collect()
    }
}

fn check_count(what: &'static str, got: usize, wanted: usize) -> Result<(), SampledPlantError> {
    if got == wanted { Ok(()) } else { Err(SampledPlantError::Size { what, got, wanted, unit: "entries" }) }
}

/// A tenth of the largest excursion that full steps on the inputs cause within two seconds; a thirtieth of that
/// within ten for a state on which nothing depends, as a position, because an outer, slower loop holds it.
fn default_scales(
    a: &DMatrix<f64>,
    phi: &DMatrix<f64>,
    gamma: &DMatrix<f64>,
    inputs: &[InputLimits],
    period_s: f64,
) -> Vec<f64> {
    let n = phi.nrows();
    let steps = |time: f64| (time / period_s).ceil().clamp(1.0, 20_000.0) as usize;
    let until: Vec<usize> = (0..n)
        .map(|j| if a.column(j).iter().all(|v| *v == 0.0) { steps(10.0) } else { steps(2.0) })
        .collect();
    let last = until.iter().copied().max().unwrap_or(0);
    let mut reach = vec![0f64; n];
    for (j, limits) in inputs.iter().enumerate() {
        let drive = gamma.column(j) * limits.authority();
        let mut x = nalgebra::DVector::<f64>::zeros(n);
        for k in 0..last {
            x = phi * x + &drive;
            for i in (0..n).filter(|&i| k < until[i]) {
                reach[i] = reach[i].max(x[i].abs());
            }
        }
    }
    let largest = reach.iter().copied().filter(|r| r.is_finite()).fold(0.0, f64::max);
    // A state that no input moves is measured by those that move: weighing it by its own reach, which is nothing,
    // would leave only rounding of the others.
    let sized = |r: f64| match r {
        _ if largest == 0.0 => 1.0,
        r if r < 1e-6 * largest => largest,
        r => r,
    };
    let share = |i: usize| if until[i] == last && last > steps(2.0) { 1.0 / 30.0 } else { 0.1 };
    reach.iter().enumerate().map(|(i, r)| if r.is_finite() { share(i) * sized(*r) } else { 1.0 }).collect()
}
