//! Switches of effects, by time window or by hand.

use crate::effects::{Effect, Kind, Window};

/// State of an effect's switch: its window, until it is switched by hand.
#[derive(Debug, Clone)]
pub struct Switch {
    /// Index of the effect in the vehicle.
    effect: usize,
    window: Window,
    by_hand: Option<bool>,
}

impl Switch {
    pub fn new(effect: usize, described: &Effect) -> Self {
        let mut window = described.window();
        if described.kind() == Kind::ModeTransition && !window.is_always() {
            let at_s = described.get("at_s");
            window.from_s = Some(window.from_s.map_or(at_s, |from| from.max(at_s)));
        }
        Self { effect, window, by_hand: None }
    }

    /// True when the effect always acts.
    pub fn is_always(&self) -> bool {
        self.window.is_always()
    }

    /// True when the effect acts at `t`.
    #[inline]
    pub fn is_on(&self, t: f64) -> bool {
        self.by_hand.unwrap_or_else(|| self.window.holds(t))
    }

    /// Time since the effect began, s, for effects that grow with it.
    pub fn since(&self, t: f64) -> f64 {
        t - self.window.from_s.unwrap_or(0.0)
    }

    /// True when this is the switch of that effect.
    pub fn is_of(&self, effect: usize) -> bool {
        self.effect == effect
    }

    /// Switches the effect; true if this is its switch.
    pub fn set(&mut self, effect: usize, on: bool) -> bool {
        let is_meant = effect == self.effect && !self.window.is_always();
        if is_meant {
            self.by_hand = Some(on);
        }
        is_meant
    }
}

#[cfg(test)]
mod tests {
    use crate::effects::{Effect, Kind, Window};
    use crate::model::Vehicle;
    use crate::simulator::Simulator;

    const PERIOD: f64 = 0.01;

    fn cart(effect: Effect) -> Vehicle {
        let text = "A = [[0.0]]\nB = [[1.0]]\nstates = [{ name = 'v' }]\ninputs = [{ name = 'u' }]\n";
        let mut vehicle = Vehicle::parse(text, "cart").unwrap();
        vehicle.add_effect(effect).unwrap();
        vehicle
    }

    /// State and measurement at each step, with the input at 1; the effect is switched at step 60 if asked.
    fn flown(vehicle: &Vehicle, by_hand: Option<bool>) -> Vec<(f64, f64)> {
        let mut simulator = Simulator::new(vehicle, PERIOD, 1).unwrap();
        let one = |k: usize| {
            if let (60, Some(on)) = (k, by_hand) {
                assert!(simulator.switch(0, on) && !simulator.switch(1, on));
            }
            simulator.apply(&[1.0]);
            let row = (simulator.state()[0], simulator.measure()[0]);
            simulator.advance();
            row
        };
        (0..100).map(one).collect()
    }

    fn during(kind: Kind, place: &str, parameters: &[(&str, f64)]) -> Vehicle {
        let window = Window { from_s: Some(0.2), until_s: Some(0.5) };
        cart(Effect::new(kind, place, parameters).unwrap().during(window).unwrap())
    }

    #[test]
    fn an_input_loses_half_its_effect_in_its_window_only() {
        let path = flown(&during(Kind::InputGain, "u", &[("factor", 0.5)]), None);
        for (k, expected) in [(20, 0.2), (50, 0.35), (99, 0.84)] {
            assert!((path[k].0 - expected).abs() < 1e-12, "step {k}: {}", path[k].0);
        }
        let path = flown(&during(Kind::InputGain, "u", &[("factor", 0.5)]), Some(true));
        assert!((path[99].0 - (0.45 + 0.5 * 0.39)).abs() < 1e-12, "{}", path[99].0);
    }

    #[test]
    fn a_sensor_is_wrong_in_its_window_only_and_a_drift_grows_from_its_beginning() {
        let error = |path: &[(f64, f64)], k: usize| path[k].1 - path[k].0;
        let path = flown(&during(Kind::SensorBias, "v", &[("offset", 2.0)]), None);
        let at = [19, 20, 49, 50].map(|k| error(&path, k));
        assert!(at.iter().zip([0.0, 2.0, 2.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{at:?}");
        let path = flown(&during(Kind::SensorDrift, "v", &[("rate_per_s", 1.0)]), None);
        assert!((error(&path, 20)).abs() < 1e-12 && (error(&path, 40) - 0.2).abs() < 1e-12);
        let path = flown(&during(Kind::SensorScale, "v", &[("factor", 3.0)]), Some(true));
        assert!((path[70].1 - 3.0 * path[70].0).abs() < 1e-12);
    }

    #[test]
    fn noise_outside_its_window_takes_the_same_numbers() {
        let whole = flown(&cart(Effect::new(Kind::Noise, "v", &[("std", 1.0)]).unwrap()), None);
        let part = flown(&during(Kind::Noise, "v", &[("std", 1.0)]), None);
        for k in 0..100 {
            let expected = if (20..50).contains(&k) { whole[k].1 } else { part[k].0 };
            assert_eq!(part[k].1, expected, "step {k}");
        }
    }

    #[test]
    fn a_rate_limit_that_begins_starts_where_the_signal_is() {
        let path = flown(&during(Kind::RateLimit, "u", &[("limit_per_s", 0.1)]), None);
        assert!((path[99].0 - 0.99).abs() < 1e-12, "{}", path[99].0);
    }
}
