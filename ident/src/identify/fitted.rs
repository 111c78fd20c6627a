//! Result of a fit: the problem without fixed parameters, the values and their covariance, and the noise.

use nalgebra::DMatrix;

use super::ar::Ar;
use super::data::Segment;
use super::predictor::NoiseStructure;
use super::problem::{Parameter, Problem};
use super::search::Outcome;

/// A parameter that was fixed because the data do not determine it.
#[derive(Debug, Clone, PartialEq)]
pub struct Fixed {
    /// The parameter.
    pub parameter: Parameter,
    /// The value at which it was fixed, SI.
    pub value: f64,
    /// Reason why the data do not determine it, as a sentence.
    pub why: String,
}

/// The noise model of a fit.
#[derive(Debug, Clone)]
pub enum NoiseFit {
    /// One autoregressive model per output, by which the cost weighted the residuals.
    Outputs(Vec<Ar>),
    /// Process and measurement noise, with the logarithms of their standard deviations in this order.
    Kalman(NoiseStructure, Vec<f64>),
}

/// The result of a fit.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The problem, in which only the parameters that the data determine are free.
    pub problem: Problem,
    /// Values of the parameters of `problem`, SI.
    pub theta: Vec<f64>,
    /// Nuisances of every segment, SI; with the initial forces where the noise has any.
    pub nuisances: Vec<Vec<f64>>,
    /// Covariance of the parameters, parameters x parameters, SI.
    pub covariance: DMatrix<f64>,
    /// Parameters that were fixed, as the data do not determine them.
    pub fixed: Vec<Fixed>,
    /// The noise model.
    pub noise: NoiseFit,
    /// Final cost.
    pub cost: f64,
    /// Effort and success of the search.
    pub outcome: Outcome,
}

impl Fit {
    /// The problem with all parameters at their fitted values and none free.
    pub fn frozen(&self) -> Problem {
        let mut problem = self.problem.clone();
        problem.vehicle = self.problem.vehicle_at(&self.theta);
        problem.parameters.clear();
        problem
    }
}

/// Zero nuisances for every segment, the start of the first sweep.
pub fn no_nuisances(problem: &Problem, segments: &[Segment]) -> Vec<Vec<f64>> {
    vec![vec![0.0; problem.nuisances()]; segments.len()]
}

/// White noise of unit variance on every output.
pub fn white(problem: &Problem) -> Vec<Ar> {
    vec![Ar::white(1.0); problem.p()]
}

/// Lower and upper bound of every parameter, SI.
pub fn bounds(problem: &Problem) -> Vec<(f64, f64)> {
    problem.parameters.iter().map(|p| (p.lower, p.upper)).collect()
}
