//! Design by pole placement.

use nalgebra::DMatrix;

use super::linear_law::LinearLaw;
use super::reduced::{Reduced, ReducedLoop, scaling, split};
use super::report::pole;
use super::{DesignError, resolve};
use crate::options::PpcOptions;
use crate::place::place;
use crate::sampled_plant::SampledPlant;

/// Designs a law by robust pole placement.
pub fn ppc(
    plant: &SampledPlant,
    o: &PpcOptions,
    integral: &[usize],
) -> Result<(LinearLaw, Option<ReducedLoop>), DesignError> {
    let reduced = Reduced::of_each(plant, integral);
    let (phi, gamma) = (&reduced.phi, &reduced.gamma);
    let poles: Vec<_> = match &o.poles {
        Some(list) => {
            if o.bandwidth.is_some() || o.damping.is_some() {
                let second = if o.bandwidth.is_some() { "bandwidth" } else { "damping" };
                return Err(DesignError::Conflict { first: "poles", second });
            }
            let mut poles: Vec<_> = list.iter().map(|p| pole(*p, plant.period_s())).collect();
            // Lags and modes without a given pole keep their poles.
            if poles.len() == plant.own_count() + integral.len() {
                poles.extend(resolve::actuator_poles(plant)?.iter().map(|p| (p * plant.period_s()).exp()));
            }
            poles
        }
        None => {
            let bandwidth = resolve::positive("bandwidth", o.bandwidth, resolve::bandwidth(plant)?)?;
            let damping = resolve::positive("damping", o.damping, 0.8)?.min(1.0);
            let poles = resolve::default_poles(plant, bandwidth, damping, integral.len())?;
            poles.iter().map(|p| (p * plant.period_s()).exp()).collect()
        }
    };
    // Orthogonality of eigenvectors depends on units: radians and metres are made comparable first.
    let (state, input) = scaling(plant, integral);
    let scaled_phi = DMatrix::from_fn(phi.nrows(), phi.ncols(), |i, j| phi[(i, j)] * state[j] / state[i]);
    let scaled_gamma = DMatrix::from_fn(phi.nrows(), input.len(), |i, j| gamma[(i, j)] * input[j] / state[i]);
    let placed = place(&scaled_phi, &scaled_gamma, &poles)?;
    let gain = DMatrix::from_fn(input.len(), phi.nrows(), |i, j| placed.gain[(i, j)] * input[i] / state[j]);
    Ok((split(plant, integral, &reduced.whole(&gain)), reduced.closed(plant, integral, &gain)))
}
