//! Options of an identification.

use serde::{Deserialize, Serialize};

use super::pem::Noise;
use super::problem::Nuisance;

/// Minimisation method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Method {
    /// Genetic algorithm on the mean square error of the simulation.
    #[serde(rename = "ga")]
    Ga,
    /// Gauss-Newton and Levenberg-Marquardt on output or prediction error.
    #[serde(rename = "pem")]
    Pem,
    /// The genetic algorithm, then the second method from its result.
    #[serde(rename = "ga+pem")]
    GaPem,
}

impl Method {
    /// The name of the method on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Ga => "ga",
            Self::Pem => "pem",
            Self::GaPem => "ga+pem",
        }
    }
}

/// Options of an identification.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Minimisation method.
    pub method: Method,
    /// Noise model of the residuals; `None` selects the innovations form for closed loops and for models that
    /// are not stable, and white noise otherwise.
    pub noise: Option<Noise>,
    /// True when the record was taken with a controller in the loop.
    pub closed_loop: bool,
    /// Unknowns estimated separately for each part of the data.
    pub nuisance: Nuisance,
    /// True to subtract the means over the fitted data from all inputs and outputs.
    pub detrend: bool,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Largest number of simulations of the genetic algorithm.
    pub evaluations: usize,
    /// Generations without progress after which the genetic algorithm stops.
    pub stagnation: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::Pem,
            noise: None,
            closed_loop: false,
            nuisance: Nuisance::default(),
            detrend: false,
            seed: 1,
            evaluations: 400_000,
            stagnation: 100,
        }
    }
}
