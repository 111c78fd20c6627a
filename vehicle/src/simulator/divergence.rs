//! What becomes of a value that has diverged.

/// Magnitude beyond which a state has diverged; it is held there, and the simulator says that it has diverged.
pub const LARGEST: f64 = 1e12;

/// What a value that has diverged is held at; 0 when it is NaN, which may be of either sign.
pub fn held(value: f64) -> f64 {
    if value.is_nan() { 0.0 } else { value.clamp(-LARGEST, LARGEST) }
}

/// Holds the entries that are beyond all bounds; `lost` becomes the first of them, unless one was lost before.
#[inline(always)]
pub fn hold(z: &mut [f64], lost: &mut Option<usize>) {
    // NaN is beyond any bound.
    let beyond = |v: &f64| v.is_nan() || v.abs() > LARGEST;
    if z.iter().fold(false, |any, v| any | beyond(v)) {
        for (i, value) in z.iter_mut().enumerate().filter(|(_, v)| beyond(v)) {
            lost.get_or_insert(i);
            *value = held(*value);
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::model::Vehicle;
    use crate::simulator::Simulator;

    const PERIOD: f64 = 0.01;

    /// v' = growth v + u, integrated to p, with effects.
    fn cart(growth: f64, effects: &str) -> Vehicle {
        let text = format!(
            "A = [[0.0, 1.0], [0.0, {growth:?}]]\nB = [[0.0], [1.0]]\n\
             states = [{{ name = \"p\", unit = \"m\" }}, {{ name = \"v\", unit = \"m/s\" }}]\n\
             inputs = [{{ name = \"u\" }}]\neffects = [{effects}]\n"
        );
        Vehicle::parse(&text, "cart").unwrap()
    }

    #[test]
    fn a_state_without_bounds_is_told() {
        let vehicle = cart(200.0, "{ effect = \"input_delay\", where = \"u\", delay_s = 0.013 }");
        let mut simulator = Simulator::new(&vehicle, PERIOD, 1).unwrap();
        for _ in 0..100_000 {
            simulator.step(&[1.0]);
        }
        assert!(simulator.diverged() && simulator.state().iter().all(|x| x.is_finite()));
        assert!(Simulator::new(&vehicle, 0.0, 1).is_err());
        assert!(Simulator::new(&vehicle, f64::NAN, 1).is_err());
        assert!(Simulator::new(&vehicle, 1e6, 1).unwrap_err().to_string().contains("cannot be simulated"));
    }

    /// With v' = u + v^3 the state is infinite within a period (a finite escape time), and a delayed sensor that
    /// samples within the period sees it before it is held.
    #[test]
    fn a_delayed_sensor_of_a_state_without_bounds_is_finite() {
        for k in 1..40u32 {
            let delay_s = 0.1 * PERIOD * f64::from(k);
            let vehicle = cart(
                0.0,
                &format!(
                    "{{ effect = \"cubic_stiffness\", where = \"v->v\", coefficient = -1.0 }}, \
                     {{ effect = \"sensor_delay\", where = \"v\", delay_s = {delay_s:?} }}"
                ),
            );
            let mut simulator = Simulator::new(&vehicle, PERIOD, 1).unwrap();
            // A force that changes slowly: the escapes fall on all parts of a period.
            for step in 0..2000 {
                let y = simulator.measure();
                assert!(y.iter().all(|y| y.is_finite()), "delay of {k}/10 periods, step {step}: {y:?}");
                simulator.step(&[1.0 + 1e-3 * f64::from(step)]);
            }
            assert!(simulator.diverged());
        }
    }
}
