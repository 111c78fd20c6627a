//! The mirror beside a vehicle that has its own clock, at the end of a link.

use whirlstand_mirror::{Finding, Mirror, Options, Stage};
use whirlstand_vehicle::{Effect, Engine, Kind, Vehicle};

use crate::support::remote::{Link, Remote};

const PERIOD_S: f64 = 0.01;

/// Clocks that agree and clocks that do not, a prompt link and one that takes a few periods.
const LINKS: [Link; 4] = [
    Link { drift: 0.0, latency: 0.1, jitter: 0.1, rounding: 0.0 },
    Link { drift: 1e-4, latency: 0.1, jitter: 0.3, rounding: 0.0 },
    Link { drift: -1e-4, latency: 0.5, jitter: 1.0, rounding: 0.0 },
    Link { drift: 3e-5, latency: 2.0, jitter: 0.5, rounding: 0.0 },
];

fn fly(
    vehicle: &Vehicle,
    seed: u64,
    seconds: f64,
    effect: Option<(&Effect, u64)>,
    link: Link,
) -> Vec<Finding> {
    let mut flight = Remote::new(vehicle, PERIOD_S, seed, effect, link);
    let mut mirror = Mirror::new(vehicle, PERIOD_S, &Options::new(Engine::Off, true, PERIOD_S)).unwrap();
    let steps = (seconds / PERIOD_S) as u64;
    let looked = (0..steps).filter_map(|_| {
        flight.fly();
        // Before the first measurement the bench waits.
        if flight.step > 10 { mirror.observe(&flight.sample()) } else { None }
    });
    looked.collect()
}

#[test]
fn clocks_and_links_are_no_change_of_the_vehicle() {
    for name in ["quadrotor", "helicopter-hover"] {
        let vehicle = Vehicle::builtin(name).unwrap();
        for (seed, link) in (11..).zip(LINKS) {
            let findings = fly(&vehicle, seed, 300.0, None, link);
            assert!(findings.is_empty(), "{name}, {link:?}: {findings:?}");
        }
    }
}

#[test]
fn a_link_that_rounds_is_no_change_of_the_vehicle() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    // That of CRSF is a tenth of the noise of a good attitude, that of other telemetry is larger than the noise.
    for (seed, rounding) in [(21, 0.1), (22, 1.0)] {
        let link = Link { drift: 3e-5, latency: 0.1, jitter: 0.1, rounding };
        let findings = fly(&vehicle, seed, 300.0, None, link);
        assert!(findings.is_empty(), "{link:?}: {findings:?}");
    }
}

/// Names of four effects that begin in flight, at the end of a link: how many are right and how many wrong.
fn named_behind(link: Link, seed: u64) -> (usize, usize) {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    let rate = vehicle.outputs[vehicle.output_index("roll_rate").unwrap()].noise;
    let (mut named, mut wrong) = (0, 0);
    for (kind, place, parameter, value) in [
        (Kind::InputGain, "u_roll", "factor", 0.6),
        (Kind::InputDelay, "u_pitch", "delay_s", 0.1),
        (Kind::SensorBias, "pitch", "offset", 0.01),
        (Kind::Noise, "roll_rate", "std", 2.5 * rate),
    ] {
        let effect = Effect::new(kind, place, &[(parameter, value)]).unwrap();
        let onset = 2000;
        let findings = fly(&vehicle, seed, 45.0, Some((&effect, onset)), link);
        let first = findings.first().unwrap_or_else(|| panic!("{link:?}: {kind} was not found"));
        assert!(first.stage == Stage::Wrong && first.step >= onset, "{link:?}: {findings:#?}");
        let last = findings.iter().rfind(|f| f.stage != Stage::Over).and_then(|f| f.cause.as_ref());
        let right = last.map(|c| (c.effect.kind(), c.effect.place()) == (kind, place));
        println!(
            "{link:?}, {kind} on {place}: {right:?} {:?}",
            last.map(|c| (c.effect.kind(), c.values[0].value))
        );
        named += usize::from(right == Some(true));
        wrong += usize::from(right == Some(false));
        if let (Some(cause), Some(true), true) = (last, right, kind != Kind::Noise) {
            // Of noise, some is expected of the jitter, whether there is jitter or not.
            let told = cause.values[0].value;
            assert!((told / value - 1.0).abs() < 0.2, "{link:?}: {kind} {value}: {told}");
        }
    }
    (named, wrong)
}

fn are_named(links: std::ops::Range<usize>) {
    let found = links.map(|i| named_behind(LINKS[i], 31 + i as u64));
    let (named, wrong) = found.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    assert!(named >= 7 && wrong == 0, "{named} of 8 have their name, {wrong} another");
}

#[test]
fn what_changes_at_the_end_of_a_prompt_link_is_named() {
    are_named(0..2);
}

#[test]
fn what_changes_at_the_end_of_a_link_whose_messages_differ_by_half_a_period_and_more_is_named() {
    are_named(2..4);
}
