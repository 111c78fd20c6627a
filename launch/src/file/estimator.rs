//! `[estimator]`: what its numbers mean in the units of the vehicle's sensors.

use serde::Deserialize;
use whirlstand_control::{Selector, Weights};
use whirlstand_nodes::config::{EstimatorConfig, EstimatorKind};
use whirlstand_vehicle::Output;

use super::amount::Amount;
use super::document::{LaunchError, at};
use super::plan::Planner;
use super::schema::LaunchFile;

/// The table as it is written.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct EstimatorSection {
    pub kind: EstimatorKind,
    /// SI for a density of noise on each state: its unit is composite, and no text is taken for it.
    pub process_noise: Option<Weights>,
    pub bias: Option<Vec<Selector>>,
    /// In the unit of the biased sensors.
    pub bias_std: Option<Amount>,
    /// In the unit of the biased sensors: what a bias wanders in the first second.
    pub bias_walk: Option<Amount>,
    pub outputs: Option<Vec<Selector>>,
}

impl Planner<'_> {
    /// The options of the filter, in SI.
    pub(super) fn estimator(&self, file: &LaunchFile) -> Result<EstimatorConfig, LaunchError> {
        let section = &file.estimator;
        Ok(EstimatorConfig {
            kind: section.kind,
            process_noise: section.process_noise.clone(),
            bias: section.bias.clone(),
            bias_std: self.of_biases(section, "bias_std", section.bias_std.as_ref())?,
            bias_walk: self.of_biases(section, "bias_walk", section.bias_walk.as_ref())?,
            outputs: section.outputs.clone(),
        })
    }

    /// A number that holds for every biased sensor: it must mean the same for all of them.
    fn of_biases(
        &self,
        section: &EstimatorSection,
        key: &str,
        amount: Option<&Amount>,
    ) -> Result<Option<f64>, LaunchError> {
        let Some(amount) = amount else { return Ok(None) };
        let here = at!["estimator", key];
        let mut si = match amount {
            Amount::Si(value) => *value,
            Amount::Written(quantity) => quantity.si,
        };
        for output in self.biased(section) {
            si = self.signal(here, key, amount, &output.unit).map_err(|e| {
                let of =
                    format!("{} (it holds for the bias of {}, in {})", e.message, output.name, output.unit);
                LaunchError { message: of, ..e }
            })?;
        }
        Ok(Some(si))
    }

    /// The sensors whose bias is estimated: those that are named, or the gyros, which are rates whose angle is measured as well.
    fn biased(&self, section: &EstimatorSection) -> Vec<&Output> {
        let outputs = &self.vehicle.outputs;
        let Some(named) = &section.bias else {
            let is_gyro = |o: &&Output| {
                o.name.strip_suffix("_rate").is_some_and(|angle| self.vehicle.output_index(angle).is_some())
            };
            return outputs.iter().filter(is_gyro).collect();
        };
        let index = |selector: &Selector| match selector {
            Selector::Index(i) => Some(*i),
            Selector::Name(name) => self.vehicle.output_index(name),
        };
        named.iter().filter_map(index).filter_map(|i| outputs.get(i)).collect()
    }
}
