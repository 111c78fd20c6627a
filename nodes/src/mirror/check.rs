//! Evaluates a law designed for a finding, before it takes over.
//!
//! The law in charge and the new one fly the identified vehicle, over random draws of its uncertain
//! parameters: in this process, with the filter in use, with the same draws for both. As in `whirlstand
//! tune`, the new law must not lose the vehicle on more draws, and must have a significantly lower cost.

use whirlstand_control::{Design, SampledPlant};
use whirlstand_msgs::Finding;
use whirlstand_vehicle::{Stream, Vehicle};

use super::declared::declared_effects;
use crate::config::{NodeConfig, VehicleSource};
use crate::error::NodeError;
use crate::flight::Pilot;
use crate::setup::Setup;
use crate::succession::{extended, steps};

/// Number of draws. A paired mean over forty detects a change of 5 % where single flights differ by 15 %.
const DRAWS: u64 = 40;

/// Length of each flight, s: from an initial deviation until it has decayed.
const FLIGHT_S: f64 = 10.0;

/// Weight of a rate whose angle has a weight too, as in the regulator.
const RATES: f64 = 0.01;

/// Smallest share of draws on which the new law must be better.
const BETTER_SHARE: f64 = 0.5;

/// The bench for evaluating laws.
pub(super) struct Check {
    config: NodeConfig,
    setup: Setup,
}

/// A law that is better.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Better {
    /// Ratio of its cost to that of the law in charge, geometric mean over the draws; zero where the latter
    /// loses the vehicle on all.
    pub ratio: f64,
    /// Memory of its loop, s.
    pub memory_s: f64,
}

impl Check {
    pub(super) fn new(config: &NodeConfig, setup: &Setup) -> Self {
        let mut config = config.clone();
        config.effects = declared_effects(&config).cloned().collect();
        (config.mirror, config.recorder, config.bridge) = (None, None, None);
        config.steps = config.steps.min(steps(&config, FLIGHT_S));
        Self { config, setup: setup.clone() }
    }

    /// Memory of the first law's loop, s.
    pub(super) fn memory_s(&self) -> Option<f64> {
        self.design(&self.setup.model).ok().map(|design| design.memory_s())
    }

    /// Checks whether the law for `cause` is better than the one for `flying`, or than the first one.
    ///
    /// # Errors
    /// A sentence with the reason why it is not.
    pub(super) fn compare(&self, flying: Option<&Finding>, cause: &Finding) -> Result<Better, String> {
        let vehicle = extended(&self.setup.model, cause)?;
        let before = match flying {
            Some(flying) => extended(&self.setup.model, flying)?,
            None => self.setup.model.clone(),
        };
        let (old, new) = (self.design(&before)?, self.design(&vehicle)?);
        if old.plant == new.plant && self.config.controller.compensate.is_empty() {
            return Err("it is the current law".into());
        }
        let said = |e: NodeError| e.to_string();
        let bench = self.bench(0, &vehicle, cause, &new.plant);
        let first = Pilot::new(&bench).map_err(said)?;
        let pilots = [&before, &vehicle].map(|model| first.under_the_law_for(&bench, model));
        let [old, pilot] = pilots;
        let (old, pilot) = (old.map_err(said)?, pilot.map_err(said)?);
        let mut costs = Vec::new();
        for number in 0..DRAWS {
            let bench = self.bench(number, &vehicle, cause, &new.plant);
            let flown = |law: &Pilot| cost(&law.before(&bench)?, &bench, &new.plant);
            costs.push((flown(&old).map_err(said)?, flown(&pilot).map_err(said)?));
        }
        Ok(Better { ratio: judge(&costs)?, memory_s: new.memory_s() })
    }

    fn design(&self, model: &Vehicle) -> Result<Design, String> {
        let plant = Setup::plant_of(model, Setup::period_s(&self.config)).map_err(|e| e.to_string())?;
        let options = self.config.controller.options().ok_or("the stick alone is no law")?;
        Design::new(&plant, &options).map_err(|e| e.to_string())
    }

    /// A draw: the parameters of the cause within their uncertainty, and an initial deviation of up to a
    /// tenth of the inputs' authority.
    fn bench(&self, number: u64, vehicle: &Vehicle, cause: &Finding, plant: &SampledPlant) -> NodeConfig {
        let mut config = self.config.clone();
        config.seed = config.seed.wrapping_add(number);
        let mut stream = Stream::new(config.seed, "law in flight");
        let mut drawn = vehicle.clone();
        if let (Some(effect), true) = (drawn.effects.last_mut(), number > 0) {
            let names: Vec<_> = effect.parameters().map(|(name, _)| name).collect();
            let told = whirlstand_msgs::text_of(&cause.names).split(',').take(cause.count as usize);
            for (i, name) in told.enumerate().filter(|(_, name)| names.contains(name)) {
                let spread = (cause.high[i] - cause.low[i]) / (2.0 * 1.96);
                let value = cause.value[i] + spread * stream.normal();
                // Out of the range of the parameter, such as a negative delay: the estimated value is kept.
                drop(effect.set_parameter(name, value));
            }
        }
        for (name, scale) in plant.own_names().iter().zip(plant.scales()) {
            config.plant.initial.insert(name.clone(), scale * stream.normal());
        }
        let origin = self.config.vehicle.origin.clone();
        config.vehicle = VehicleSource { origin: origin.clone(), text: drawn.to_toml() };
        config.model = Some(VehicleSource { origin, text: self.setup.model.to_toml() });
        config
    }
}

/// Mean square of the errors of all states and of all inputs, each divided by its scale, rates with a
/// hundredth of the weight (Bryson's rule); infinite when the vehicle was lost.
fn cost(pilot: &Pilot, bench: &NodeConfig, plant: &SampledPlant) -> Result<f64, NodeError> {
    let n = plant.own_count();
    let mut weights: Vec<f64> = plant.scales()[..n].iter().map(|s| 1.0 / (s * s)).collect();
    for (rate, _) in plant.kinematic_rows().into_iter().flatten() {
        weights[rate] = RATES / plant.scales()[rate].powi(2);
    }
    let mut sum = 0.0;
    let flown = pilot.fly(bench, |step| {
        for (i, (x, weight)) in step.x.iter().zip(&weights).enumerate() {
            let wanted = if step.setpoint.tracked >> i & 1 == 1 { step.setpoint.x[i] } else { 0.0 };
            sum += weight * (x - wanted).powi(2);
        }
        sum += step.u.iter().zip(plant.inputs()).map(|(u, i)| (u / i.authority()).powi(2)).sum::<f64>();
    });
    match flown {
        Ok(_) => Ok(sum / bench.steps.max(1) as f64),
        Err(NodeError::Diverged { .. }) => Ok(f64::INFINITY),
        Err(error) => Err(error),
    }
}

/// Ratio of the costs, new over old, from pairs of flights.
fn judge(costs: &[(f64, f64)]) -> Result<f64, String> {
    let lost = |of: fn(&(f64, f64)) -> f64| costs.iter().filter(|c| of(c).is_infinite()).count();
    let (old, new) = (lost(|c| c.0), lost(|c| c.1));
    if new > old {
        return Err(format!(
            "it loses the vehicle on {new} of {} draws, the current law on {old}",
            costs.len()
        ));
    }
    let both = costs.iter().filter(|(a, b)| a.is_finite() && b.is_finite() && *a > 0.0 && *b > 0.0);
    let logs: Vec<f64> = both.map(|(a, b)| (b / a).ln()).collect();
    let count = logs.len() as f64;
    let mean = logs.iter().sum::<f64>() / count.max(1.0);
    let variance = logs.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    let better = costs.iter().filter(|(a, b)| b < a).count() as f64 / costs.len() as f64;
    let half = 1.96 * (variance / count.max(1.0)).sqrt();
    let is_cheaper = count >= 2.0 && mean + half < 0.0 && better > BETTER_SHARE;
    match (new < old, is_cheaper) {
        (true, _) if count == 0.0 => Ok(0.0),
        (true, _) | (_, true) => Ok(mean.exp()),
        _ => Err(format!(
            "its cost is not significantly lower: {:.2} times that of the current law",
            mean.exp()
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_is_better_only_where_the_draws_agree() {
        let old = [1.0, 1.1, 0.9, 1.05];
        let pairs = |new: [f64; 4]| old.into_iter().zip(new).collect::<Vec<_>>();
        assert!(judge(&pairs([0.5, 0.6, 0.45, 0.5])).unwrap() < 0.6);
        assert!(judge(&pairs([0.5, 2.0, 0.4, 1.9])).unwrap_err().contains("not significantly lower"));
        assert!(judge(&pairs(old)).is_err());
        let fatal = judge(&pairs([0.1, 0.1, 0.1, f64::INFINITY]));
        assert!(fatal.unwrap_err().contains("loses the vehicle on 1 of 4"));
        let saved: Vec<_> = old.into_iter().map(|new| (f64::INFINITY, new)).collect();
        assert_eq!(judge(&saved), Ok(0.0));
    }
}
