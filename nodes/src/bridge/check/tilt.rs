//! Tilts the simulated vehicle, and compares the attitude reported by an autopilot.

use std::time::Duration;

use whirlstand_bridge::sensors::{Motion, wrapped};

/// Tilt angle, rad.
pub(super) const TILT: f64 = 0.3;

/// Duration of a tilt.
pub(super) const RAMP: Duration = Duration::from_millis(1000);

/// Smallest share of the tilt that must be reported about its axis.
const FOLLOWED: f64 = 0.7;

/// Largest share of the tilt that may be reported about another axis.
const STRAY: f64 = 0.35;

/// The axes, with the words for a positive and a negative rotation.
pub(super) const AXES: [(&str, [&str; 2]); 3] = [
    ("roll", ["right side down", "left side down"]),
    ("pitch", ["nose up", "nose down"]),
    ("yaw", ["nose right", "nose left"]),
];

/// Motion of the vehicle `spent` after the tilt about `axis` from `from` to `to` began; at rest at both ends.
pub(super) fn motion(axis: usize, from: f64, to: f64, spent: Duration) -> Motion {
    let share = (spent.as_secs_f64() / RAMP.as_secs_f64()).min(1.0);
    let mut motion = Motion::default();
    motion.angles[axis] = from + (to - from) * 0.5 * (1.0 - (std::f64::consts::PI * share).cos());
    motion
}

/// Evaluates the attitude that an autopilot reported before and after a tilt of `by` about `axis`.
///
/// # Errors
/// A description of the error.
pub(super) fn check(axis: usize, by: f64, before: [f64; 3], after: [f64; 3]) -> Result<String, String> {
    let change: [f64; 3] = std::array::from_fn(|i| wrapped(after[i] - before[i]));
    let [name, words] = [AXES[axis].0, AXES[axis].1[usize::from(by < 0.0)]];
    let most = (0..3).max_by(|a, b| change[*a].abs().total_cmp(&change[*b].abs())).unwrap_or(axis);
    let degrees = |angle: f64| format!("{:+.1} deg", angle.to_degrees());
    let seen = format!("{name}: {} ({words}), and it says {}", degrees(by), degrees(change[axis]));
    if most != axis && change[most].abs() > FOLLOWED * TILT {
        return Err(format!("{seen} and {} {}: the axes are exchanged", AXES[most].0, degrees(change[most])));
    }
    if change[axis] * by < 0.0 && change[axis].abs() > STRAY * TILT {
        return Err(format!("{seen}: the sign is turned"));
    }
    let share = change[axis] / by;
    if !(FOLLOWED..=2.0 - FOLLOWED).contains(&share) {
        return Err(format!("{seen}: the reported attitude does not follow"));
    }
    match (0..3).find(|i| *i != axis && change[*i].abs() > STRAY * TILT) {
        Some(i) => Err(format!("{seen}, and {} {}: that axis was not moved", AXES[i].0, degrees(change[i]))),
        None => Ok(seen),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilt_is_smooth_and_ends_where_it_should() {
        let ms = Duration::from_millis;
        assert_eq!(motion(1, 0.0, TILT, ms(0)).angles, [0.0; 3]);
        assert!((motion(1, 0.0, TILT, ms(500)).angles[1] - 0.5 * TILT).abs() < 1e-12);
        assert_eq!(motion(1, TILT, -TILT, ms(9000)).angles, [0.0, -TILT, 0.0]);
        let fastest = (0..1000).map(|k| {
            let at = |ms| motion(0, 0.0, TILT, Duration::from_millis(ms)).angles[0];
            (at(k + 1) - at(k)) * 1e3
        });
        assert!(fastest.fold(0.0, f64::max) < 0.5, "rad/s");
    }

    #[test]
    fn each_way_to_be_wrong_has_its_words() {
        let before = [0.01, -0.02, 3.1];
        let said = |axis: usize, by: f64, change: [f64; 3]| {
            check(axis, by, before, std::array::from_fn(|i| before[i] + change[i]))
        };
        for by in [TILT, -TILT] {
            assert!(said(0, by, [0.97 * by, 0.02, 0.0]).is_ok());
            assert!(said(2, by, [0.0, 0.0, 0.97 * by]).is_ok(), "over half a turn");
            for (change, words) in [
                ([-by, 0.0, 0.0], "sign is turned"),
                ([0.0, by, 0.0], "and pitch"),
                ([0.0, -by, 0.0], "exchanged"),
                ([0.1 * by, 0.0, 0.0], "does not follow"),
                ([2.0 * by, 0.0, 0.0], "does not follow"),
                ([by, 0.0, 0.5 * by], "and yaw"),
            ] {
                let wrong = said(0, by, change).unwrap_err();
                assert!(wrong.contains(words) && wrong.starts_with("roll: "), "{wrong}");
            }
        }
    }
}
