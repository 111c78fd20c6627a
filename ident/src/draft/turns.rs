//! Decides from their size whether angles and rates without a stated unit are in degrees.

use std::fmt::Write as _;

use super::names::bare;
use super::proposal::{Chosen, Offered};

/// Units of turning without a stated unit: as assumed, and instead where one of these outputs is larger than this. A vehicle
/// rolls and pitches by less than a turn (its heading may have been counted on), and the gyroscopes of small vehicles end
/// at 2000 deg/s.
const TURNS: [(&str, &str, f64, &[&str]); 2] = [
    ("[rad", "deg", std::f64::consts::TAU, &["roll", "pitch"]),
    ("[rad/s", "deg/s", 35.0, &["roll_rate", "pitch_rate", "yaw_rate"]),
];

/// Takes angles without a stated unit for degrees where one of them is larger than radians allow, and rates likewise.
pub fn in_degrees(outputs: &mut [Chosen], offered: &[Offered]) {
    for (radians, degrees, most, axes) in TURNS {
        let largest = |c: &Chosen| offered.iter().find(|o| o.name == bare(&c.source))?.largest;
        let assumed = |c: &&mut Chosen| c.source.strip_suffix(']').is_some_and(|s| s.ends_with(radians));
        let beyond = |c: &&Chosen| axes.contains(&c.name.as_str()) && largest(c).is_some_and(|v| v > most);
        let Some(first) = outputs.iter().find(beyond).map(|c| (bare(&c.source).to_string(), largest(c)))
        else {
            continue;
        };
        for chosen in outputs.iter_mut().filter(assumed) {
            chosen.source = format!("{}[{degrees}]", bare(&chosen.source));
            let _ = write!(
                chosen.why,
                "; in {degrees}, as {} reaches {:.0}, too much for {}",
                first.0,
                first.1.unwrap_or_default(),
                &radians[1..]
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::proposal::{Choice, propose};
    use super::*;

    #[test]
    fn angles_and_rates_that_are_too_large_for_radians_are_in_degrees() {
        let column = |(name, unit): (&str, Option<&str>)| Offered {
            name: name.into(),
            unit: unit.map(Into::into),
            rate_hz: None,
            largest: None,
        };
        let mut log =
            [("roll", None), ("yaw", None), ("pitch", Some("rad")), ("gx", None), ("u1", None)].map(column);
        let outputs = |log: &[Offered]| {
            let mut found = propose("x.csv", log, false, &Choice::default()).unwrap().outputs;
            in_degrees(&mut found, log);
            found
        };
        let sources = |log: &[Offered]| outputs(log).into_iter().map(|c| c.source).collect::<Vec<_>>();
        let largest = |log: &mut [Offered], values: [f64; 4]| {
            log.iter_mut().zip(values).for_each(|(o, v)| o.largest = Some(v));
        };
        largest(&mut log, [3.0, 20.0, 1.5, 34.0]);
        assert_eq!(sources(&log), ["gx[rad/s]", "roll[rad]", "pitch", "yaw[rad]"]);
        largest(&mut log, [41.0, 20.0, 1.5, 210.0]);
        assert_eq!(sources(&log), ["gx[deg/s]", "roll[deg]", "pitch", "yaw[deg]"]);
        let found = outputs(&log);
        assert!(found[1].why.ends_with("in deg, as roll reaches 41, too much for rad"), "{found:?}");
    }
}
