//! The report of a diagnosis, from a record whose cause is known.

use std::io::Read;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::GzDecoder;
use whirlstand_diagnose::answer::{Diagnosis, EvidenceCurve};
use whirlstand_diagnose::{Options, Verdict, diagnose};
use whirlstand_logs::Record;
use whirlstand_report::diagnosis_report;
use whirlstand_vehicle::{Effect, Kind, Simulator, Stream, Vehicle};

const PERIOD_S: f64 = 0.01;

/// A flight of the quadrotor under random steps, with effects that the vehicle file does not have.
fn flight(effects: &[Effect], seconds: f64, seed: u64) -> Record {
    let mut truth = Vehicle::find("quadrotor").unwrap();
    for effect in effects {
        truth.add_effect(effect.clone()).unwrap();
    }
    truth.outputs.iter_mut().for_each(|o| o.vibration = None);
    let steps = (seconds / PERIOD_S) as usize;
    let mut stream = Stream::new(seed, "sticks");
    let mut u = vec![0.0; 2 * steps];
    for j in 0..2 {
        let (mut level, mut until) = (0.0, 0.0);
        for k in 0..steps {
            if k as f64 * PERIOD_S >= until {
                level = 10.0 * stream.normal().clamp(-1.0, 1.0);
                until += 0.3 + 1.2 * stream.normal().abs();
            }
            u[2 * k + j] = level;
        }
    }
    let mut y = vec![0.0; truth.outputs.len() * steps];
    Simulator::new(&truth, PERIOD_S, seed).unwrap().run(&u, &mut y);
    let mut record = Record::new("flight.csv", (0..steps).map(|k| k as f64 * PERIOD_S).collect()).unwrap();
    for (j, input) in truth.inputs.iter().enumerate() {
        let values = u.iter().skip(j).step_by(2).copied().collect();
        record.push(&input.name, input.unit.si_symbol(), values).unwrap();
    }
    for (i, output) in truth.outputs.iter().enumerate() {
        let values = y.iter().skip(i).step_by(truth.outputs.len()).copied().collect();
        record.push(&output.name, output.unit.si_symbol(), values).unwrap();
    }
    record
}

fn diagnosed(effects: &[Effect], seed: u64) -> Diagnosis {
    let record = flight(effects, 40.0, seed);
    diagnose(vec![record], &Vehicle::find("quadrotor").unwrap(), &Options::default()).unwrap()
}

fn curve<'d>(answer: &'d Diagnosis, cause: &str) -> &'d EvidenceCurve {
    let accepted = answer.figures.evidence.iter().find(|c| c.accepted && c.cause == cause);
    accepted.unwrap_or_else(|| panic!("no evidence for {cause}: {}", answer.summary))
}

/// The text of the page with its data readable, and without Plotly, which holds nearly every word.
fn own_part(html: &str) -> String {
    let (head, rest) = html.split_once("<script type=\"text/plain\" id=\"plotly\">").unwrap();
    let (_, rest) = rest.split_once("id=\"data\">").unwrap();
    let (packed, tail) = rest.split_once('<').unwrap();
    let bytes = STANDARD.decode(packed).unwrap();
    let mut data = String::new();
    GzDecoder::new(bytes.as_slice()).read_to_string(&mut data).unwrap();
    format!("{head}{data}{tail}")
}

#[test]
fn a_late_tone_ridden_flight_is_shown_with_its_delay_and_its_tone() {
    let delay = Effect::new(Kind::InputDelay, "u_roll", &[("delay_s", 0.06)]).unwrap();
    let tone = [("frequency_hz", 12.3), ("amplitude", 0.02), ("phase_rad", 0.4)];
    let tone = Effect::new(Kind::Vibration, "pitch_rate", &tone).unwrap();
    let answer = diagnosed(&[delay, tone], 1);
    assert_eq!(answer.verdict, Verdict::Explained, "{}", answer.summary);

    // A step of the input has not arrived before the delay, and has after it.
    let late = curve(&answer, "input_delay on u_roll");
    for (points, slack) in [(&late.measured, 0.3), (&late.explained, 0.2)] {
        for (t, share) in points.0.iter().zip(&points.1) {
            if (t - 0.06).abs() > 0.015 {
                let expected = if *t < 0.06 { 0.0 } else { 1.0 };
                assert!((share - expected).abs() < slack, "{t} {share}");
            }
        }
    }
    // Folded on its period, the tone is a wave of its amplitude.
    let wave = curve(&answer, "vibration on pitch_rate");
    let highest = wave.measured.1.iter().copied().fold(0.0, f64::max);
    assert!((highest - 0.02).abs() < 0.003, "{highest}");

    let html = diagnosis_report(&answer).unwrap();
    let own = own_part(&html);
    let verdict = own
        .split("class=\"verdict good\">")
        .nth(1)
        .unwrap()
        .split('<')
        .next()
        .unwrap()
        .replace("&#x2f;", "/");
    assert_eq!(verdict, answer.summary, "the verdict is the first line");
    for heading in [
        "What the record shows",
        "Causes",
        "The extended vehicle",
        "Improvement on held-out data",
        "correlation of the residual with u_roll",
        "spectrum of the residual",
        "Not testable with this record",
    ] {
        assert!(own.contains(heading), "{heading}");
    }
    assert!(own.contains("12.30 Hz"), "the tone is marked in the spectrum");
    assert!(own.contains("\"kind\":\"held_out\""), "the held-out part is shaded");
    assert!(
        own.contains("<span class=\"added\">effect = &quot;input_delay&quot;"),
        "the effect is in the diff"
    );
    assert!(!own.contains("<span class=\"removed\">"), "nothing was taken away");
}

#[test]
fn friction_shows_as_a_step_against_the_speed() {
    let friction = Effect::new(Kind::CoulombFriction, "roll_rate", &[("level", 0.08)]).unwrap();
    let answer = diagnosed(&[friction], 2);
    let step = curve(&answer, "coulomb_friction on roll_rate");
    let far = step.measured.0.iter().copied().fold(0.0, |m: f64, x| m.max(x.abs()));
    for (x, force) in step.measured.0.iter().zip(&step.measured.1) {
        if x.abs() > 0.3 * far {
            assert!((force + 0.08 * x.signum()).abs() < 0.03, "{x} {force}");
        }
    }
}

#[test]
fn a_record_without_a_cause_has_a_page_too() {
    let answer = diagnosed(&[], 3);
    assert_eq!(answer.verdict, Verdict::Consistent, "{}", answer.summary);
    let own = own_part(&diagnosis_report(&answer).unwrap());
    assert!(own.contains(&answer.summary) && own.contains("measured and simulated"));
    assert!(!own.contains("What the record shows") && !own.contains("The extended vehicle"));
}
