//! Plausibility of values that fit their unit but no vehicle: they are refused, with the value in two units.

use whirlstand_msgs::units::{clean, number};

use crate::effects::Effect;
use crate::error::EffectError;
use crate::model::State;

/// Largest valid attitude, deg. The models are linear about level flight and invalid beyond it.
const LARGEST_ATTITUDE_DEG: f64 = 90.0;

/// Reason why the value `si` of a state, rad, is no attitude that a vehicle flies at; `None` for all other
/// states and values.
pub fn check_attitude(state: &State, si: f64) -> Option<String> {
    let is_attitude = ["roll", "pitch"].contains(&state.name.as_str()) && state.unit.si_symbol() == "rad";
    // 90 deg may be slightly more after conversion from rad.
    let is_beyond = si.to_degrees().abs() > LARGEST_ATTITUDE_DEG * (1.0 + 1e-12);
    (is_attitude && is_beyond).then(|| {
        format!(
            "is {} deg = {} rad: a linear model is not valid for attitudes beyond {LARGEST_ATTITUDE_DEG} deg; check \
             the unit",
            number(si.to_degrees()),
            number(si)
        )
    })
}

impl Effect {
    /// Checks that a delay is shorter than `span`, for example `the run`, which lasts `span_s`.
    ///
    /// # Errors
    /// When no value would arrive before the end; the message gives the delay in two units.
    pub fn check_delay(&self, span_s: f64, span: &str) -> Result<(), EffectError> {
        match self.parameter("delay_s") {
            Some(delay) if delay > 0.0 && delay >= span_s => Err(EffectError {
                effect: self.kind().name().into(),
                place: self.place().into(),
                field: Some("delay_s".into()),
                reason: format!(
                    "is {} s = {} ms, but {span} lasts {} s, so nothing would arrive before it ends; check the unit",
                    clean(delay),
                    clean(1e3 * delay),
                    clean(span_s)
                ),
            }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Kind;
    use crate::model::Vehicle;

    #[test]
    fn an_attitude_beyond_90_deg_is_read_back_in_both_units() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let check = |state: usize, si| check_attitude(&vehicle.states[state], si);
        let told = check(0, 10.0).unwrap();
        assert!(told.starts_with("is 573 deg = 10.0 rad"), "{told}");
        assert!(check(2, -1.6).is_some());
        assert_eq!(check(0, 90f64.to_radians()), None);
        assert_eq!(check(1, 10.0), None, "a rate has no such limit");
    }

    #[test]
    fn a_delay_as_long_as_the_run_is_refused() {
        let delay = |s| Effect::new(Kind::InputDelay, "u_roll", &[("delay_s", s)]).unwrap();
        assert!(delay(11.9).check_delay(12.0, "the run").is_ok());
        assert!(delay(0.0).check_delay(0.0, "the run").is_ok());
        let told = delay(60.0).check_delay(12.000_000_000_000_01, "the run").unwrap_err().to_string();
        assert!(told.contains("delay_s is 60 s = 60000 ms, but the run lasts 12 s"), "{told}");
        let gain = Effect::new(Kind::InputGain, "u_roll", &[("factor", 60.0)]).unwrap();
        assert!(gain.check_delay(1.0, "the run").is_ok());
    }
}
