//! Options with explicit default values, for callers that change them.

use super::{DesignError, regulator, resolve, sliding};
use crate::options::{LawOptions, LqrOptions, PpcOptions, SmcOptions, Weights};
use crate::sampled_plant::SampledPlant;

impl LawOptions {
    /// The same options with the defaults that the plant gives made explicit: `q`, `r` and `integral_q` of
    /// the regulator, the `bandwidth` of pole placement (not where `poles` are given), the `boundary_layer`
    /// of sliding mode.
    ///
    /// # Errors
    /// [`DesignError`], which names the option that does not fit the plant.
    pub fn resolved(&self, plant: &SampledPlant) -> Result<Self, DesignError> {
        Ok(match self {
            Self::Lqr(o) => {
                let integral = resolve::integral(plant, &o.integral)?;
                let weights = regulator::weights(plant, o, &integral)?;
                Self::Lqr(LqrOptions {
                    q: Some(Weights::List(weights.q)),
                    r: Some(Weights::List(weights.r)),
                    integral_q: Some(weights.integral_q).filter(|q| !q.is_empty()),
                    ..o.clone()
                })
            }
            Self::Ppc(o) if o.poles.is_some() => self.clone(),
            Self::Ppc(o) => {
                let bandwidth = resolve::positive("bandwidth", o.bandwidth, resolve::bandwidth(plant)?)?;
                Self::Ppc(PpcOptions { bandwidth: Some(bandwidth), ..o.clone() })
            }
            Self::Smc(o) => {
                let layer = sliding::switched(plant, o)?.layer;
                Self::Smc(SmcOptions { boundary_layer: Some(Weights::List(layer)), ..o.clone() })
            }
        })
    }
}
