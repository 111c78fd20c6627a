//! What is sought: the vehicle with its free parameters, and how a simulation and its sensitivities come from them.

use nalgebra::DMatrix;
use whirlstand_vehicle::{Matrix, Target, Vehicle};

use super::IdentifyError;
use super::data::Segment;
use super::linear::Linear;
use super::predictor::Gains;
use super::simulated::Simulated;

/// A free parameter as the search sees it, SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Name, as `A[2,1]`.
    pub name: String,
    /// What it stands for.
    pub target: Target,
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// Where the search shall start, if the file says so.
    pub start: Option<f64>,
    /// SI value of one in the unit of the vehicle file.
    pub factor: f64,
}

/// What is estimated beside the parameters, anew for each segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nuisance {
    /// The state at the segment's start.
    pub initial_state: bool,
    /// A constant error of every output: sensor bias, trim.
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
    /// The vehicle; what is not free is taken from it.
    pub vehicle: Vehicle,
    /// The free parameters.
    pub parameters: Vec<Parameter>,
    /// What else is estimated.
    pub nuisance: Nuisance,
    /// Weight of each output; 0 for one that no segment has.
    pub weights: Vec<f64>,
    /// Period, s.
    pub period_s: f64,
}

impl Problem {
    /// The problem that a vehicle file and the data state.
    ///
    /// # Errors
    /// When nothing is free, or segments have different periods.
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

    /// How many numbers are estimated for each segment alone.
    pub fn nuisances(&self) -> usize {
        let states = if self.nuisance.initial_state { self.n() } else { 0 };
        states + if self.nuisance.output_offsets { self.p() } else { 0 }
    }

    /// The vehicle with the given parameters.
    pub fn vehicle_at(&self, theta: &[f64]) -> Vehicle {
        let mut vehicle = self.vehicle.clone();
        for (parameter, value) in self.parameters.iter().zip(theta) {
            // Bounds were checked against the table when the file was read, and values stay within them.
            let set = vehicle.set_free(&parameter.target, *value);
            debug_assert!(set.is_ok(), "{set:?}");
        }
        vehicle
    }

    /// A, B, C and D with the given parameters; those of effects have no part in them.
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

    /// True when the simulation is linear in state and input with nothing but A, B, C and D, so that sensitivities
    /// are exact recursions.
    pub fn is_plain(&self) -> bool {
        self.vehicle.effects.is_empty()
            && self.parameters.iter().all(|p| matches!(p.target, Target::Entry(..)))
    }

    /// The simulation at `theta`, ready to be swept over segments. `None` when it has no finite step.
    pub fn simulation(&self, theta: &[f64]) -> Option<Box<dyn Sweep + '_>> {
        if self.is_plain() {
            Some(Box::new(Linear::new(self, theta, None)?))
        } else {
            Some(Box::new(Simulated::new(self, theta, None)?))
        }
    }

    /// The predictor at `theta` with the gains computed there. `None` when it has no finite step.
    pub fn predictor<'p>(&'p self, theta: &[f64], gains: &'p Gains) -> Option<Box<dyn Sweep + 'p>> {
        if self.is_plain() {
            Some(Box::new(Linear::new(self, theta, Some(gains))?))
        } else {
            Some(Box::new(Simulated::new(self, theta, Some(gains))?))
        }
    }

    /// Derivatives of A, B, C, D by a parameter, if it is an entry of one of them.
    pub fn entry(&self, parameter: usize) -> Option<(Matrix, usize, usize)> {
        match self.parameters[parameter].target {
            Target::Entry(matrix, i, j) => Some((matrix, i, j)),
            Target::Effect(..) => None,
        }
    }

    /// The matrix with a one at the entry.
    pub fn unit(rows: usize, columns: usize, (i, j): (usize, usize)) -> DMatrix<f64> {
        let mut unit = DMatrix::zeros(rows, columns);
        unit[(i, j)] = 1.0;
        unit
    }
}

/// One step of a sweep.
#[derive(Debug)]
pub struct Step<'a> {
    /// Number of the step.
    pub k: usize,
    /// Predicted outputs.
    pub predicted: &'a [f64],
    /// For every output the derivatives by all parameters, then by the segment's nuisances; outputs x columns.
    pub slopes: &'a [f64],
}

/// A simulation or predictor with its sensitivities.
pub trait Sweep: Sync {
    /// Columns of `slopes`.
    fn columns(&self) -> usize;

    /// Runs over a segment from the given nuisances; false when it left all bounds.
    fn sweep(&self, segment: &Segment, nuisance: &[f64], visit: &mut dyn FnMut(Step<'_>)) -> bool;
}

/// Splits the nuisances of a segment into initial state and output offsets; what is not estimated is empty.
pub fn split<'a>(problem: &Problem, nuisance: &'a [f64]) -> (&'a [f64], &'a [f64]) {
    let states = if problem.nuisance.initial_state { problem.n() } else { 0 };
    nuisance.split_at(states.min(nuisance.len()))
}
