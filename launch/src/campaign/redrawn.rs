//! The plan of a flight, derived from the plan of the first one. The launch file is not read again where only the
//! seed, numbers of effects and initial states differ.

use serde::Deserialize;
use whirlstand_campaign::{Campaign, Value};
use whirlstand_vehicle::{Effect, Vehicle};

use crate::file::{Document, Plan, at, initial_state};

/// The plan of the first flight, and the data needed to change it.
pub(super) struct Redrawn {
    first: Plan,
    /// The vehicle without the effects of the launch file.
    bare: Vehicle,
    /// The effects as the launch file writes them, with the values drawn for the first flight.
    effects: Vec<toml::Table>,
    duration_s: f64,
}

impl Redrawn {
    /// From the plan of flight 0 of `campaign`, which was read from `launch`. `None` where the file does not hold
    /// what the plan holds.
    pub fn new(launch: &Document, first: &Plan, campaign: &Campaign, own_effects: usize) -> Option<Self> {
        let mut document = launch.clone();
        for assignment in campaign.assignments(0, own_effects) {
            document.set("--set", &assignment).ok()?;
        }
        let effects = (0..first.config.effects.len())
            .map(|i| document.read_at::<toml::Table>(at!["effects", i]).ok()?)
            .collect::<Option<Vec<_>>>()?;
        let mut bare = first.vehicle.clone();
        bare.effects.truncate(bare.effects.len().checked_sub(effects.len())?);
        let duration_s = first.config.steps as f64 * first.config.period_ns as f64 * 1e-9;
        Some(Self { first: first.clone(), bare, effects, duration_s })
    }

    /// The plan of a flight with these drawn values; `None` where the launch file has to be read for it.
    pub fn plan(&self, drawn: &[(String, Value)]) -> Option<Plan> {
        let mut plan = self.first.clone();
        let mut effects = self.effects.clone();
        for (key, value) in drawn {
            let mut path = key.splitn(3, '.');
            match (path.next(), path.next(), path.next()) {
                (Some("seed"), None, None) => match value {
                    Value::Whole(seed) => plan.config.seed = u64::try_from(*seed).ok()?,
                    _ => return None,
                },
                (Some("effects"), Some(index), Some(parameter)) => {
                    let place = effects.get_mut(index.parse::<usize>().ok()?)?.get_mut(parameter)?;
                    *place = written(value)?;
                }
                (Some("plant"), Some("initial"), Some(state))
                    if plan.config.plant.initial.contains_key(state) =>
                {
                    let value = initial_state(&self.bare, state, written(value)?)?;
                    plan.config.plant.initial.insert(state.into(), value);
                }
                _ => return None,
            }
        }
        plan.vehicle = self.bare.clone();
        for effect in effects {
            let effect = Effect::deserialize(effect).ok()?;
            effect.check_delay(self.duration_s, "the run").ok()?;
            plan.vehicle.add_written_effect(effect).ok()?;
        }
        plan.config.effects = plan.vehicle.effects[self.bare.effects.len()..].to_vec();
        Some(plan)
    }

    /// Whether two plans describe the same flight; the texts in their logs may differ.
    pub fn flies_as(a: &Plan, b: &Plan) -> bool {
        let without_text = |plan: &Plan| {
            let mut config = plan.config.clone();
            config.recorder.iter_mut().for_each(|recorder| recorder.launch_text.clear());
            config
        };
        without_text(a) == without_text(b) && a.expect == b.expect && a.name == b.name
    }
}

/// A drawn number as a TOML value; `None` for a word.
fn written(value: &Value) -> Option<toml::Value> {
    match value {
        Value::Whole(value) => Some(toml::Value::Integer(*value)),
        Value::Number(number) if number.unit.is_empty() => Some(toml::Value::Float(number.value)),
        Value::Number(number) => Some(toml::Value::String(format!("{:?} {}", number.value, number.unit))),
        Value::Word(_) => None,
    }
}
