//! Checks that the outputs of an armed autopilot counteract a tilt.

use whirlstand_bridge::mixer::{Demand, Mixer};

use super::Finding;
use super::tilt::AXES;

/// Smallest demand that is conclusive.
const QUIET: f64 = 0.01;

/// Mean demand of the outputs about each axis.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Demands {
    sum: [f64; 3],
    count: u32,
}

impl Demands {
    /// Adds a set of outputs.
    pub(super) fn add(&mut self, mixer: &Mixer, values: &[f64]) {
        let demands = [Demand::Roll, Demand::Pitch, Demand::Yaw].map(|d| mixer.demand(d, values));
        if demands.iter().all(|d| d.is_finite()) {
            self.sum.iter_mut().zip(demands).for_each(|(sum, d)| *sum += d);
            self.count += 1;
        }
    }

    fn mean(&self) -> Option<[f64; 3]> {
        (self.count > 0).then(|| self.sum.map(|s| s / f64::from(self.count)))
    }
}

/// Evaluates the outputs before and during a tilt of `by` about `axis`.
pub(super) fn check(axis: usize, by: f64, before: &Demands, during: &Demands) -> Finding {
    let [name, words] = [AXES[axis].0, AXES[axis].1[usize::from(by < 0.0)]];
    let (Some(before), Some(during)) = (before.mean(), during.mean()) else {
        return Finding::Unknown(format!("{name}, {words}: its motors report no numbers"));
    };
    let change: [f64; 3] = std::array::from_fn(|i| during[i] - before[i]);
    let most = (0..3).max_by(|a, b| change[*a].abs().total_cmp(&change[*b].abs())).unwrap_or(axis);
    if change[most].abs() < QUIET {
        return Finding::Unknown(format!("{name}, {words}: its motors do not answer"));
    }
    let seen = format!("{name}, {words}: its motors answer with {:+.2} of the full demand", change[axis]);
    if most != axis {
        Finding::Wrong(format!(
            "{seen}, and {:+.2} about {}: the outputs are in another order",
            change[most], AXES[most].0
        ))
    } else if change[axis] * by > 0.0 {
        Finding::Wrong(format!("{seen}: they push the same way, so an output or a sign is wrong"))
    } else {
        Finding::Good(format!("{seen}: they push back"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_bridge::mixer::MixerOptions;
    use whirlstand_vehicle::Vehicle;

    #[test]
    fn outputs_that_push_back_are_told_from_those_that_do_not() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mixer = Mixer::new(&MixerOptions::default(), &[1, 2, 3, 4], &vehicle).unwrap();
        // Front right, rear left, front left, rear right.
        let demands = |motors: [f64; 4]| {
            let mut demands = Demands::default();
            demands.add(&mixer, &motors);
            demands
        };
        let even = demands([0.5; 4]);
        let left_up = demands([0.4, 0.6, 0.6, 0.4]);
        let said = |axis, by, during: &Demands| check(axis, by, &even, during);
        assert!(matches!(said(0, 0.3, &even), Finding::Unknown(t) if t.contains("do not answer")));
        assert!(matches!(said(0, 0.3, &Demands::default()), Finding::Unknown(t) if t.contains("no numbers")));
        assert!(matches!(said(0, -0.3, &left_up), Finding::Good(t) if t.contains("push back")));
        assert!(matches!(said(0, 0.3, &left_up), Finding::Wrong(t) if t.contains("the same way")));
        assert!(matches!(said(1, 0.3, &left_up), Finding::Wrong(t) if t.contains("about roll")));
        let mut broken = even;
        broken.add(&mixer, &[f64::NAN; 4]);
        assert!(
            matches!(check(0, 0.3, &broken, &left_up), Finding::Wrong(_)),
            "what is no number is left out"
        );
    }
}
