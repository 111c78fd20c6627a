//! The estimation problem: a vehicle with free parameters, and its simulation with sensitivities.

use std::ops::Range;

use nalgebra::DMatrix;
use whirlstand_vehicle::{Matrix, Target, Vehicle};

use super::IdentifyError;
use super::data::Segment;

/// Perturbation of a parameter in a central difference, as a share of its value, or of its range where that is smaller.
const PARAMETER_STEP: f64 = 1e-5;

/// A free parameter in SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name, such as `A[2,1]`.
    pub name: String,
    /// Target in the vehicle: a matrix entry or a parameter of an effect.
    pub target: Target,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// Start value from the vehicle file, if it gives one.
    pub start: Option<f64>,
    /// SI value of one unit of the vehicle file.
    pub factor: f64,
}

/// Unknowns estimated for each segment in addition to the parameters (nuisances).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nuisance {
    /// True to estimate the state at the start of the segment.
    pub initial_state: bool,
    /// True to estimate a constant error of every output (sensor bias, trim).
    pub output_offsets: bool,
}

impl Default for Nuisance {
    fn default() -> Self {
        Self { initial_state: true, output_offsets: false }
    }
}

/// The vehicle, its free parameters and the outputs that are fitted.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The vehicle with all values that are not free.
    pub vehicle: Vehicle,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// Nuisances estimated for each segment.
    pub nuisance: Nuisance,
    /// Weight of each output; 0 for an output in no segment.
    pub weights: Vec<f64>,
    /// Time between two steps, s.
    pub period_s: f64,
}

impl Problem {
    /// The estimation problem of a vehicle file and data.
    ///
    /// # Errors
    /// When no parameter is free, or segments have different periods.
    pub fn new(vehicle: &Vehicle, segments: &[Segment], nuisance: Nuisance) -> Result<Self, IdentifyError> {
        if vehicle.free.is_empty() {
            return Err(IdentifyError::NothingFree { vehicle: vehicle.name.clone() });
        }
        let period_s = segments.first().map_or(0.0, |s| s.period_s);
        if let Some(other) = segments.iter().find(|s| (s.period_s / period_s - 1.0).abs() > 1e-6) {
            return Err(IdentifyError::Periods {
                first: segments[0].origin.clone(),
                first_s: period_s,
                other: other.origin.clone(),
                other_s: other.period_s,
            });
        }
        let parameters = vehicle.free.iter().map(|f| Parameter {
            name: vehicle.free_name(&f.target),
            target: f.target.clone(),
            lower: f.lower,
            upper: f.upper,
            start: f.start,
            factor: vehicle.free_factor(&f.target),
        });
        let present = super::data::present(segments, vehicle.outputs.len());
        let weights = vehicle.outputs.iter().zip(&present);
        let weights =
            weights.map(|(o, here)| if *here { vehicle.fit_weight(&o.name) } else { 0.0 }).collect();
        Ok(Self { parameters: parameters.collect(), nuisance, weights, period_s, vehicle: vehicle.clone() })
    }

    /// Number of states.
    pub fn n(&self) -> usize {
        self.vehicle.states.len()
    }

    /// Number of outputs.
    pub fn p(&self) -> usize {
        self.vehicle.outputs.len()
    }

    /// Number of inputs.
    pub fn m(&self) -> usize {
        self.vehicle.inputs.len()
    }

    /// Number of nuisances of a segment: initial states and output offsets.
    pub fn nuisances(&self) -> usize {
        let states = if self.nuisance.initial_state { self.n() } else { 0 };
        states + if self.nuisance.output_offsets { self.p() } else { 0 }
    }

    /// The vehicle with the free parameters at `theta`, SI.
    pub fn vehicle_at(&self, theta: &[f64]) -> Vehicle {
        let mut vehicle = self.vehicle.clone();
        for (parameter, value) in self.parameters.iter().zip(theta) {
            // Bounds were checked against the table when the file was read, and values stay within them.
            let set = vehicle.set_free(&parameter.target, *value);
            debug_assert!(set.is_ok(), "{set:?}");
        }
        vehicle
    }

    /// A, B, C and D with the free parameters at `theta`, SI; parameters of effects do not enter them.
    pub fn matrices_at(&self, theta: &[f64]) -> [DMatrix<f64>; 4] {
        let v = &self.vehicle;
        let mut all = [v.a.clone(), v.b.clone(), v.c.clone(), v.d.clone()];
        for (parameter, value) in self.parameters.iter().zip(theta) {
            if let Target::Entry(matrix, i, j) = parameter.target {
                let which = match matrix {
                    Matrix::A => 0,
                    Matrix::B => 1,
                    Matrix::C => 2,
                    Matrix::D => 3,
                };
                all[which][(i, j)] = *value;
            }
        }
        all
    }

    /// True when the simulation is linear in state and input and consists of A, B, C and D only, so that
    /// sensitivities have exact recursions.
    pub fn is_plain(&self) -> bool {
        self.vehicle.effects.is_empty()
            && self.parameters.iter().all(|p| matches!(p.target, Target::Entry(..)))
    }

    /// The matrix, row and column of a parameter; `None` when it is not a matrix entry.
    pub fn entry(&self, parameter: usize) -> Option<(Matrix, usize, usize)> {
        match self.parameters[parameter].target {
            Target::Entry(matrix, i, j) => Some((matrix, i, j)),
            Target::Effect(..) => None,
        }
    }

    /// A matrix with a one at row i, column j, and zeros elsewhere: the derivative by that entry.
    pub fn unit(rows: usize, columns: usize, (i, j): (usize, usize)) -> DMatrix<f64> {
        let mut unit = DMatrix::zeros(rows, columns);
        unit[(i, j)] = 1.0;
        unit
    }
}

/// Values on both sides of a parameter for a central difference, the larger first, as far as its bounds allow.
pub fn parameter_sides(parameter: &Parameter, value: f64) -> [f64; 2] {
    let range = parameter.upper - parameter.lower;
    let step = PARAMETER_STEP * range.min(value.abs().max(1e-2 * range));
    [(value + step).min(parameter.upper), (value - step).max(parameter.lower)]
}

/// One step of a sweep.
#[derive(Debug)]
pub struct Step<'a> {
    /// Index of the step within the segment, from 0.
    pub k: usize,
    /// Predicted outputs, SI.
    pub predicted: &'a [f64],
    slopes: &'a [f64],
    columns: usize,
    stride: usize,
}

impl<'a> Step<'a> {
    /// Step `k`; the derivatives of output i begin at `slopes[i * stride]`, `columns` of them.
    pub fn new(k: usize, predicted: &'a [f64], slopes: &'a [f64], columns: usize, stride: usize) -> Self {
        Self { k, predicted, slopes, columns, stride }
    }

    /// Derivatives of output `i` by all parameters, then by the segment's nuisances.
    pub fn slopes(&self, i: usize) -> &'a [f64] {
        &self.slopes[i * self.stride..][..self.columns]
    }
}

/// A simulation or predictor with its sensitivities.
pub trait Sweep: Sync {
    /// Number of derivatives of an output, [`Step::slopes`]: parameters, then nuisances of a segment.
    fn columns(&self) -> usize;

    /// Simulates a segment with the given nuisances and calls `visit` at every step; false when the run
    /// diverged.
    fn sweep(&self, segment: &Segment, nuisance: &[f64], visit: &mut dyn FnMut(&Step<'_>)) -> bool;

    /// The same as a run whose parts can be swept on their own; `None` where the future depends on the past by more than
    /// the state, or the state at a cut is not among the unknowns.
    fn divisible(&self) -> Option<&dyn Divisible> {
        None
    }
}

/// A sweep whose parts can be swept on their own.
pub trait Divisible: Sync {
    /// The states before the steps `at`, which ascend; `None` when the run diverged.
    fn states(&self, segment: &Segment, nuisance: &[f64], at: &[usize]) -> Option<Vec<Vec<f64>>>;

    /// Simulates some steps of a segment; the initial state among the nuisances is that before the first of them. Returns
    /// the derivatives of the state after the last of them by the same unknowns, states x columns; `None` when the run
    /// diverged.
    fn sweep_part(
        &self,
        segment: &Segment,
        steps: Range<usize>,
        nuisance: &[f64],
        visit: &mut dyn FnMut(&Step<'_>),
    ) -> Option<DMatrix<f64>>;
}

/// Splits the nuisances of a segment into initial state and output offsets; those not estimated are empty.
pub fn split<'a>(problem: &Problem, nuisance: &'a [f64]) -> (&'a [f64], &'a [f64]) {
    let states = if problem.nuisance.initial_state { problem.n() } else { 0 };
    nuisance.split_at(states.min(nuisance.len()))
}
