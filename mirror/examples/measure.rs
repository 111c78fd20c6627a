//! Flights for each of twelve effects that begin at a random time: how soon the mirror says that something changed, against
//! the best possible, and what it calls it. `cargo run --release -p whirlstand-mirror --example measure -- FLIGHTS [EFFECT]`.
//!
//! Flight i of an effect has seed i, from 1. Sizes and places are drawn evenly from the ranges that stand in `draw`.

mod support;

use support::Flight;
use whirlstand_mirror::{Cause, Mirror, Options, Stage};
use whirlstand_vehicle::{Effect, Engine, Kind, Stream, Vehicle};

const PERIOD_S: f64 = 0.005;

/// Time for a name, s.
const NAMED_S: f64 = 10.0;

/// What else there is to be told: log-likelihood ratio that a false alarm once in 100 h asks for, `ln(100 h / period)`.
fn asked() -> f64 {
    (360_000.0 / PERIOD_S).ln()
}

const EFFECTS: [&str; 12] = [
    "loss of effectiveness",
    "delay",
    "lag",
    "bias",
    "drift",
    "friction",
    "vibration",
    "noise",
    "stuck sensor",
    "mode transition",
    "limit",
    "backlash",
];

/// The effect of a flight: its kind and size.
fn draw(what: &str, vehicle: &Vehicle, stream: &mut Stream, spans: &[(f64, f64)]) -> Effect {
    let mut between = |low: f64, high: f64| low + (high - low) * stream.uniform();
    let input = (between(0.0, 2.0) as usize).min(vehicle.inputs.len() - 1);
    let attitude = ["roll", "roll_rate", "pitch", "pitch_rate"][(between(0.0, 4.0) as usize).min(3)];
    let rate = ["roll_rate", "pitch_rate"][(between(0.0, 2.0) as usize).min(1)];
    let sigma = vehicle.outputs[vehicle.output_index(attitude).unwrap()].noise;
    let (name, (low, high)) = (vehicle.inputs[input].name.clone(), spans[input]);
    let (middle, play) = (0.5 * (low + high), high - low);
    let new = |kind, place: &str, parameters: &[(&str, f64)]| Effect::new(kind, place, parameters).unwrap();
    match what {
        "loss of effectiveness" => new(Kind::InputGain, &name, &[("factor", between(0.4, 0.9))]),
        "delay" => new(Kind::InputDelay, &name, &[("delay_s", between(0.02, 0.12))]),
        "lag" => new(Kind::ActuatorLag, &name, &[("time_constant_s", between(0.03, 0.2))]),
        "bias" => new(Kind::SensorBias, attitude, &[("offset", sigma * between(1.0, 8.0))]),
        "drift" => new(Kind::SensorDrift, attitude, &[("rate_per_s", sigma * between(0.5, 5.0))]),
        "friction" => new(Kind::CoulombFriction, rate, &[("level", between(0.02, 0.2))]),
        "vibration" => new(
            Kind::Vibration,
            attitude,
            &[
                ("frequency_hz", between(3.0, 80.0)),
                ("amplitude", sigma * between(0.5, 3.0)),
                ("phase_rad", between(0.0, 6.0)),
            ],
        ),
        "noise" => new(Kind::Noise, attitude, &[("std", sigma * between(1.75, 4.0))]),
        "stuck sensor" => new(Kind::Dropouts, attitude, &[("fraction", 1.0)]),
        "mode transition" => {
            let to = ["helicopter-longitudinal", "helicopter-lateral"][(between(0.0, 2.0) as usize).min(1)];
            Effect::mode_transition(0.0, to).unwrap()
        }
        "limit" => {
            let share = between(0.2, 0.4);
            new(
                Kind::InputSaturation,
                &name,
                &[("lower", middle - share * play), ("upper", middle + share * play)],
            )
        }
        _ => new(Kind::Backlash, &name, &[("width", play * between(0.1, 0.5))]),
    }
}

/// Least and greatest value of each input in the first seconds of a clean flight.
fn spans(vehicle: &Vehicle, seed: u64) -> Vec<(f64, f64)> {
    let mut flight = Flight::new(vehicle, PERIOD_S, seed, None);
    let mut spans = vec![(f64::INFINITY, f64::NEG_INFINITY); vehicle.inputs.len()];
    for step in 0..(8.0 / PERIOD_S) as u64 {
        flight.fly();
        let moved = spans.iter_mut().zip(&flight.u).filter(|_| step > 100);
        moved.for_each(|(s, u)| *s = (s.0.min(*u), s.1.max(*u)));
    }
    spans
}

#[derive(Default)]
struct Row {
    flights: u32,
    early: u32,
    detected: u32,
    bounds: Vec<f64>,
    delays: Vec<f64>,
    sufficient: u32,
    right: u32,
    wrong: u32,
    wrong_ever: u32,
    named_after: Vec<f64>,
}

/// Whether a cause is the one that was hidden.
fn is_right(cause: &Cause, truth: &Effect) -> bool {
    let same = |kind: Kind, place: &str| kind == truth.kind() && place == truth.place();
    let told = same(cause.effect.kind(), cause.effect.place())
        && (truth.kind() != Kind::ModeTransition || cause.effect.text() == truth.text());
    told || cause.indistinguishable.iter().any(|(kind, place)| same(*kind, place))
}

/// What a mirror said of a flight.
#[derive(Default)]
struct Heard {
    /// Step at which it first said that something is wrong, after it was.
    detected: Option<u64>,
    /// It said so before.
    early: bool,
    /// The last cause that stands, and when it was told.
    said: Option<(u64, Cause)>,
    wrong_ever: bool,
    lines: Vec<String>,
}

fn watch(flight: &mut Flight, mirror: &mut Mirror, truth: &Effect, onset: u64) -> Heard {
    let mut heard = Heard::default();
    for _ in 0..onset + (NAMED_S / PERIOD_S) as u64 {
        flight.fly();
        let Some(finding) = mirror.observe(&flight.sample()) else { continue };
        let cause = finding.cause.as_ref();
        let told = cause.map(|c| {
            (
                c.effect.kind(),
                c.effect.place().to_string(),
                c.values.clone(),
                c.probability,
                c.indistinguishable.clone(),
            )
        });
        heard.lines.push(format!(
            "    {:.2} s {:?} since {:.3} evidence {:.1} {told:?}",
            (finding.step as f64 - onset as f64) * PERIOD_S,
            finding.stage,
            (finding.since as f64 - onset as f64) * PERIOD_S,
            finding.evidence,
        ));
        match finding.stage {
            Stage::Wrong if finding.step < onset => heard.early = true,
            Stage::Wrong => heard.detected = heard.detected.or(Some(finding.step)),
            Stage::Named | Stage::Revised => {
                let cause = finding.cause.unwrap();
                heard.wrong_ever |= !is_right(&cause, truth);
                heard.said = Some((finding.step, cause));
            }
            Stage::Withdrawn => heard.said = None,
            Stage::Over => {}
        }
    }
    heard
}

/// The least delay of any detection of this size with so few false alarms (Lorden), s; `None` when the flight is too short for it.
fn bound(vehicle: &Vehicle, mirror: &Mirror, truth: &Effect, onset: u64) -> Option<f64> {
    match truth.kind() {
        Kind::Noise => {
            let i = vehicle.output_index(truth.place()).unwrap();
            let v = 1.0 + (truth.parameter("std").unwrap() / vehicle.outputs[i].noise).powi(2);
            Some(asked() / (0.5 * (v - 1.0 - v.ln())) * PERIOD_S)
        }
        // A value that repeats is certain within two steps.
        Kind::Dropouts => Some(2.0 * PERIOD_S),
        _ => mirror
            .evidence_of(truth, onset)
            .and_then(|sums| sums.iter().position(|sum| *sum >= asked()))
            .map(|k| (k + 1) as f64 * PERIOD_S),
    }
}

fn flight(what: &str, seed: u64, row: &mut Row, verbose: bool) {
    let vehicle =
        Vehicle::builtin(if what == "mode transition" { "helicopter-hover" } else { "quadrotor" }).unwrap();
    let mut stream = Stream::new(seed, what);
    let truth = draw(what, &vehicle, &mut stream, &spans(&vehicle, seed));
    let onset = ((8.0 + 6.0 * stream.uniform()) / PERIOD_S) as u64;
    let flown = match truth.text() {
        Some(to) => Effect::mode_transition(onset as f64 * PERIOD_S, to).unwrap(),
        None => truth.clone(),
    };
    let mut flight = Flight::new(&vehicle, PERIOD_S, seed, Some((&flown, onset)));
    let mut mirror = Mirror::new(&vehicle, PERIOD_S, &Options::new(Engine::Flying, true, PERIOD_S)).unwrap();
    let Heard { detected, early, said, wrong_ever, lines } = watch(&mut flight, &mut mirror, &truth, onset);
    let bound = bound(&vehicle, &mirror, &truth, onset);
    row.flights += 1;
    row.early += u32::from(early);
    if let Some(bound) = bound {
        row.bounds.push(bound);
        if let Some(step) = detected {
            row.delays.push((step - onset + 1) as f64 * PERIOD_S);
        }
    }
    row.detected += u32::from(detected.is_some());
    // Half of the time is for the alarm.
    let sufficient = bound.is_some_and(|b| b <= 0.5 * NAMED_S);
    row.sufficient += u32::from(sufficient);
    let right = said.as_ref().is_some_and(|(_, c)| is_right(c, &truth));
    row.right += u32::from(right && sufficient);
    row.wrong += u32::from(said.is_some() && !right);
    row.wrong_ever += u32::from(wrong_ever);
    if let Some((step, _)) = said.as_ref().filter(|_| right) {
        row.named_after.push((step - onset) as f64 * PERIOD_S);
    }
    if verbose || !right && sufficient || wrong_ever {
        println!(
            "  {what} {seed}: {:?} {:?} bound {bound:?} {}",
            truth.place(),
            truth.parameters().collect::<Vec<_>>(),
            if right { "right" } else { "NOT NAMED RIGHT" }
        );
        lines.iter().for_each(|line| println!("{line}"));
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn main() {
    let mut args = std::env::args().skip(1);
    let flights: u64 = args.next().map_or(20, |a| a.parse().expect("how many flights"));
    let only = args.next();
    let mut table = vec![format!("{flights} flights each, from seed 1")];
    table.push("| effect | detected | false before | bound s | delay s | sufficient | right | wrong | wrong at any time | named after s |".into());
    for what in EFFECTS.into_iter().filter(|e| only.as_ref().is_none_or(|o| e == o)) {
        let mut row = Row::default();
        (1..=flights).for_each(|seed| flight(what, seed, &mut row, only.is_some()));
        table.push(format!(
            "| {what} | {} of {} | {} | {:.2} | {:.2} | {} | {} | {} | {} | {:.1} |",
            row.detected,
            row.flights,
            row.early,
            median(&mut row.bounds),
            median(&mut row.delays),
            row.sufficient,
            row.right,
            row.wrong,
            row.wrong_ever,
            median(&mut row.named_after)
        ));
    }
    println!("{}", table.join("\n"));
}
