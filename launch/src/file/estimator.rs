//! `[estimator]`: conversion of its numbers from the units of the vehicle's sensors and inputs to SI.

use whirlstand_control::Selector;
use whirlstand_nodes::config::EstimatorConfig;
use whirlstand_vehicle::SignalUnit;

use super::amount::Amount;
use super::document::{LaunchError, at};
use super::plan::Planner;
use super::schema::{EstimatorSection, LaunchFile};

impl Planner<'_> {
    /// The options of the filter, in SI.
    pub(super) fn estimator(&self, file: &LaunchFile) -> Result<EstimatorConfig, LaunchError> {
        let section = &file.estimator;
        let (sensors, inputs) = (self.biased(section), self.offset(section));
        let of_sensors = |key, amount: &Option<Amount>| self.of_all(&sensors, key, amount.as_ref());
        let of_inputs = |key, amount: &Option<Amount>| self.of_all(&inputs, key, amount.as_ref());
        Ok(EstimatorConfig {
            kind: section.kind,
            vibration: section.vibration,
            process_noise: section.process_noise.clone(),
            bias: section.bias.clone(),
            bias_std: of_sensors("bias_std", &section.bias_std)?,
            bias_walk: of_sensors("bias_walk", &section.bias_walk)?,
            input_bias: section.input_bias.clone(),
            input_bias_std: of_inputs("input_bias_std", &section.input_bias_std)?,
            input_bias_walk: of_inputs("input_bias_walk", &section.input_bias_walk)?,
            outputs: section.outputs.clone(),
        })
    }

    /// A number that applies to several signals, in SI. It must have the same meaning for all of them.
    fn of_all(
        &self,
        signals: &[Named<'_>],
        key: &str,
        amount: Option<&Amount>,
    ) -> Result<Option<f64>, LaunchError> {
        let Some(amount) = amount else { return Ok(None) };
        let here = at!["estimator", key];
        let mut si = match amount {
            Amount::Si(value) => *value,
            Amount::Written(quantity) => quantity.si,
        };
        for (name, unit) in signals {
            si = self.signal(here, key, amount, unit).map_err(|e| {
                let of = format!("{} (it holds for the bias of {name}, in {unit})", e.message);
                LaunchError { message: of, ..e }
            })?;
        }
        Ok(Some(si))
    }

    /// The sensors whose bias is estimated: the named ones, or else the gyros, which are rates whose angle is
    /// measured as well.
    fn biased(&self, section: &EstimatorSection) -> Vec<Named<'_>> {
        let outputs: Vec<Named<'_>> =
            self.vehicle.outputs.iter().map(|o| (o.name.as_str(), &o.unit)).collect();
        match &section.bias {
            Some(named) => selected(named, &outputs),
            None => {
                let is_gyro = |(name, _): &Named<'_>| {
                    name.strip_suffix("_rate").is_some_and(|angle| self.vehicle.output_index(angle).is_some())
                };
                outputs.into_iter().filter(is_gyro).collect()
            }
        }
    }

    /// The inputs whose offset is estimated.
    fn offset(&self, section: &EstimatorSection) -> Vec<Named<'_>> {
        let inputs: Vec<Named<'_>> = self.vehicle.inputs.iter().map(|i| (i.name.as_str(), &i.unit)).collect();
        selected(&section.input_bias, &inputs)
    }
}

/// A signal of the vehicle and its unit.
type Named<'v> = (&'v str, &'v SignalUnit);

/// The selected signals that exist; a wrong name is refused elsewhere.
fn selected<'v>(selectors: &[Selector], signals: &[Named<'v>]) -> Vec<Named<'v>> {
    let index = |selector: &Selector| match selector {
        Selector::Index(i) => Some(*i),
        Selector::Name(name) => signals.iter().position(|(known, _)| known == name),
    };
    selectors.iter().filter_map(index).filter_map(|i| signals.get(i).copied()).collect()
}
