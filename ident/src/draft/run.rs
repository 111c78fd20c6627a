//! Drafts a vehicle: from the log to the text of a vehicle file.

use std::path::Path;

use whirlstand_logs::Record;
use whirlstand_logs::stats::{rms, white_noise_std};
use whirlstand_vehicle::{
    ESTIMATED_IN_MOTION, FIT_PERIOD, Intersample, Matrix, SENSOR_NOISE, Target, Vehicle,
};

use super::answer::{
    AxisAnswer, DRAFT_SCHEMA, Draft, HeldOut, LeftOut, ParameterAnswer, SignalAnswer, TriedAnswer,
};
use super::comments;
use super::compose::{Angle, Axis, Composed, compose};
use super::error::DraftError;
use super::flown::Flown;
use super::intersample::likelier;
use super::mixer::Mixer;
use super::names::model_name;
use super::own_past::{compare, starts, takes_away};
use super::proposal::{Choice, Chosen, Proposal, propose, rate_of};
use super::reading::{open, own_samples, read_chosen};
use super::select::answers_the_input;
use super::structure::{Actuators, Signals, rounded};
use super::survey::{Link, check_motors, fast_enough, link, moves, or_too_slow};
use crate::identify::align::lags;
use crate::identify::force_fit::{FORCES, WANDERING};

/// Shortest step of a fit, s: the motion of a vehicle is slower than a gyroscope's sampling.
const SHORTEST_STEP_S: f64 = 0.004;
/// Longest step to which a faster record is resampled, s.
const LONGEST_STEP_S: f64 = 0.008;
/// Number of steps above which a record is resampled to longer ones.
const MANY_STEPS: f64 = 6000.0;
/// Margin of an input's limits beyond the record's range, as a share of it.
const LIMIT_ROOM: f64 = 0.1;
/// Correlation of an angle with the integral of its rate from which both show the same motion.
const SAME_MOTION: f64 = 0.7;

/// Options of a draft.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Names {
    /// Signals chosen by the user.
    pub choice: Choice,
    /// Name of the time column of a CSV, as in `--map t=`.
    pub time: Option<String>,
    /// Name of the vehicle; by default that of the log without its extension.
    pub vehicle: Option<String>,
    /// SHA-256 of the log, for the file's provenance; empty for none.
    pub sha256: String,
}

/// Drafts a vehicle from the part of a log between two times, s of its clock. `observe` receives the progress
/// as text.
///
/// # Errors
/// [`DraftError`], as a full sentence with the remedy.
pub fn draft(
    path: &Path,
    names: &Names,
    part: (Option<f64>, Option<f64>),
    observe: &(dyn Fn(&str) + Sync),
) -> Result<Draft, DraftError> {
    let log = path.display().to_string();
    observe("looking for inputs and outputs");
    let time = names.time.as_deref();
    let opened = open(path, time)?;
    let proposal = propose(&log, &opened.offered, opened.clocks, &names.choice)?;
    let mut refused = None;
    for group in &proposal.inputs {
        let chosen: Vec<&Chosen> = group.iter().chain(&proposal.outputs).chain(&proposal.motors).collect();
        let record = read_chosen(path, &chosen, time, part)?;
        let inputs: Vec<Chosen> = group.iter().filter(|c| moves(&record, c)).cloned().collect();
        if inputs.is_empty() {
            continue;
        }
        let flown = Flown::find(&record, &inputs, (part.0.is_some(), part.1.is_some()));
        let record = match flown {
            Some(Flown { from_s, to_s }) => {
                record.between(from_s.unwrap_or(f64::NEG_INFINITY), to_s.unwrap_or(f64::INFINITY))
            }
            None => record,
        };
        let flight = Flight { record: &record, flown };
        match from_inputs(&log, names, &proposal, (inputs, flight), observe) {
            // A log may hold what was asked of the vehicle and what its motors did: where one explains nothing, the
            // other may. The first refusal is told, as it is about the inputs that were proposed first.
            Err(
                why @ (DraftError::Unexplained { .. }
                | DraftError::NoStructure { .. }
                | DraftError::TooSlow { .. }),
            ) => {
                refused.get_or_insert(why);
            }
            found => return found,
        }
    }
    let still: Vec<&str> = proposal.inputs.iter().flatten().map(|c| c.source.as_str()).collect();
    Err(refused.unwrap_or_else(|| DraftError::InputsAtRest { log: log.clone(), inputs: still.join(", ") }))
}

/// The record of a flight, and the part of the log that it is.
#[derive(Clone, Copy)]
struct Flight<'r> {
    record: &'r Record,
    flown: Option<Flown>,
}

/// Drafts a vehicle that is driven by some inputs of the proposal.
fn from_inputs(
    log: &str,
    names: &Names,
    proposal: &Proposal,
    (inputs, flight): (Vec<Chosen>, Flight<'_>),
    observe: &(dyn Fn(&str) + Sync),
) -> Result<Draft, DraftError> {
    let record = flight.record;
    check_motors(record, &proposal.motors, &inputs)?;
    let (angles, outputs): (Vec<Chosen>, Vec<Chosen>) =
        proposal.outputs.iter().cloned().partition(|o| is_integral(o, &proposal.outputs));
    let mut left_out = Vec::new();
    let (inputs, outputs) = fast_enough(record, &inputs, &outputs, &mut left_out)?;
    let refused = |why| or_too_slow(record, &inputs, &outputs, why);
    observe("finding the input that explains each output");
    let mut even = on_even_steps(record, &inputs)?;
    let mixer = Mixer::of(&inputs);
    if let Some(mixer) = &mixer {
        even = mixer.mixed(even);
    }
    let steering = mixer.as_ref().map_or(&inputs, |m| &m.patterns);
    let links = link(&even, record, steering, &outputs, &mut left_out).map_err(refused)?;
    let own_steps = even.len() == record.len();
    let axes = axes(&even, &links, (mixer.is_some(), own_steps), &mut left_out, observe)?;
    if axes.is_empty() {
        let found = left_out.iter().map(|l| format!("{}: {}", l.output, l.why)).collect::<Vec<_>>();
        return Err(refused(DraftError::NoStructure { log: log.into(), found: found.join("; ") }));
    }
    finish(log, names, flight, (&axes, mixer.as_ref()), &angles, left_out)
}

/// True for an angle whose rate is among the outputs.
fn is_integral(output: &Chosen, outputs: &[Chosen]) -> bool {
    rate_of(&output.name).is_some_and(|rate| outputs.iter().any(|o| o.name == rate))
}

/// The record resampled to the steps that the fit needs, whole multiples of its own.
fn on_even_steps(record: &Record, inputs: &[Chosen]) -> Result<Record, DraftError> {
    let least = (record.duration() / MANY_STEPS).clamp(SHORTEST_STEP_S, LONGEST_STEP_S);
    let wanted = record.period().map_or(least, |own| (least / own).round().max(1.0) * own);
    if !record.is_finer_than(wanted) {
        return Ok(record.clone());
    }
    let held = |name: &str| inputs.iter().any(|input| input.name == name);
    // A record whose clock cannot be made even is refused by the fit with the reason.
    Ok(record.resampled(wanted, held).unwrap_or_else(|_| record.clone()))
}

/// Structures of all linked outputs; those that no structure predicts better than their past are left out.
/// Where all are driven by the same rotors, the axis that these explain best determines the rotors' delay and
/// lag.
fn axes(
    record: &Record,
    links: &[Link],
    (same_actuators, own_steps): (bool, bool),
    left_out: &mut Vec<LeftOut>,
    observe: &(dyn Fn(&str) + Sync),
) -> Result<Vec<(Link, Axis)>, DraftError> {
    let mut axes: Vec<(Link, Axis)> = Vec::new();
    let mut order: Vec<&Link> = links.iter().collect();
    if same_actuators {
        order.sort_by(|a, b| b.share().total_cmp(&a.share()));
    }
    for link in order {
        let first = axes.first().filter(|_| same_actuators);
        let known = first.map(|(_, axis)| Actuators::of(&axis.vehicle()));
        observe(&format!("fitting structures of {} from {}", link.output.name, link.input.name));
        let unit = |name: &str| {
            record.get(name).map_or_else(Default::default, |s| s.unit.parse().unwrap_or_default())
        };
        let signals = Signals {
            input: link.input.name.clone(),
            input_unit: unit(&link.input.name),
            output: link.output.name.clone(),
            output_unit: unit(&link.output.name),
            ratio: link.pair.output_spread / link.pair.input_spread.max(f64::MIN_POSITIVE),
            period_s: link.pair.period_s,
            intersample: Intersample::Held,
            actuators: known,
        };
        // Rotors drive several axes, and do the same between samples for each.
        let (pair, found) = likelier(link, &signals, own_steps && !same_actuators)?;
        let better = |errors: &[f64]| compare(&link.own_past, errors).is_some_and(|c| takes_away(&c));
        match found {
            Some((tried, _)) if !answers_the_input(&tried) => left_out.push(LeftOut {
                output: link.output.name.clone(),
                why: format!(
                    "the effect of {} on it in the best structure, {}, is within three standard errors of zero",
                    link.input.name,
                    tried.structure.words()
                ),
            }),
            Some((tried, all)) if better(&tried.completed) => {
                axes.push((link.clone(), Axis { pair, tried, all }));
            }
            Some((tried, _)) => left_out.push(LeftOut {
                output: link.output.name.clone(),
                why: format!(
                    "the best structure, {}, predicts held-out data no better than the output's own past",
                    tried.structure.words()
                ),
            }),
            None => left_out.push(LeftOut {
                output: link.output.name.clone(),
                why: "no structure could be fitted".into(),
            }),
        }
    }
    axes.sort_by_key(|(link, _)| links.iter().position(|l| l.output == link.output));
    Ok(axes)
}

/// Combines the axes and writes the text of the vehicle file.
fn finish(
    log: &str,
    names: &Names,
    Flight { record, flown }: Flight<'_>,
    (fitted, mixer): (&[(Link, Axis)], Option<&Mixer>),
    angles: &[Chosen],
    mut left_out: Vec<LeftOut>,
) -> Result<Draft, DraftError> {
    let axes: Vec<Axis> = fitted.iter().map(|(_, axis)| axis.clone()).collect();
    let name = model_name(log, names.vehicle.as_deref());
    let angles = integrals(record, &name, (&axes, mixer), angles, &mut left_out)?;
    let own: Vec<Angle> = angles.iter().map(|(_, a)| a.clone()).collect();
    let Composed { mut vehicle, origins } = compose(&name, &axes, &own, mixer)?;
    vehicle.description = "Drafted from a record by whirlstand vehicle new".into();
    let outputs = fitted.iter().map(|(link, _)| &link.output).chain(angles.iter().map(|(c, _)| c));
    let used: Vec<&Chosen> = match mixer {
        Some(mixer) => mixer.rotors.iter().chain(outputs).collect(),
        None => fitted.iter().map(|(link, _)| &link.input).chain(outputs).collect(),
    };
    let named = used.iter().filter(|c| c.name != c.source);
    vehicle.map = named.map(|c| (c.name.clone(), c.source.clone())).collect();
    vehicle.map.extend(names.time.iter().map(|column| ("t".to_string(), column.clone())));
    limits_and_noise(&mut vehicle, record, &used);
    vehicle.provenance = provenance(log, names);
    let period_s = axes.first().map_or(0.0, |axis| axis.pair.period_s);
    if record.is_finer_than(period_s) {
        vehicle.provenance.push((FIT_PERIOD.into(), period_s.to_string()));
    }
    let mut draft = Draft {
        schema: DRAFT_SCHEMA.into(),
        log: log.into(),
        vehicle: name,
        period_s,
        axes: answers(&vehicle, &origins, fitted),
        angles: angles.iter().map(|(c, _)| c.name.clone()).collect(),
        signals: used
            .iter()
            .map(|c| SignalAnswer { name: c.name.clone(), source: c.source.clone(), why: c.why.clone() })
            .collect(),
        left_out,
        missing_values: record.missing_marks().iter().map(ToString::to_string).collect(),
        flown,
        vehicle_file: None,
        toml: String::new(),
    };
    if mixer.is_some() {
        // A rotor's gain, delay and lag are those of all others, which a list of single values cannot say: each on
        // its own is hardly determined, as the rotors move together.
        vehicle.free.retain(|free| matches!(free.target, Target::Entry(Matrix::A, ..)));
    }
    draft.toml = comments::text(&vehicle, mixer.is_some(), &draft);
    Vehicle::parse(&draft.toml, &draft.vehicle).map_err(whirlstand_vehicle::VehicleError::from)?;
    Ok(draft)
}

/// The angles that show the same motion as their rates.
fn integrals(
    record: &Record,
    name: &str,
    (axes, mixer): (&[Axis], Option<&Mixer>),
    angles: &[Chosen],
    left_out: &mut Vec<LeftOut>,
) -> Result<Vec<(Chosen, Angle)>, DraftError> {
    let there = |rate: &str| axes.iter().any(|a| a.tried.fit.problem.vehicle.outputs[0].name == rate);
    let mut found = Vec::new();
    for chosen in angles {
        let (Some(rate), Some(signal)) = (rate_of(&chosen.name), record.get(&chosen.name)) else { continue };
        let mut leave =
            |why: &str| left_out.push(LeftOut { output: chosen.name.clone(), why: why.to_string() });
        if !there(rate) {
            leave("its rate is not an axis of the model");
        } else if signal.values.windows(2).any(|w| (w[1] - w[0]).abs() > std::f64::consts::PI) {
            leave("it wraps around, which a linear model cannot do");
        } else {
            let unit = signal.unit.parse().unwrap_or_default();
            found.push((chosen.clone(), Angle { name: chosen.name.clone(), unit, rate: rate.into() }));
        }
    }
    let all: Vec<Angle> = found.iter().map(|(_, angle)| angle.clone()).collect();
    let lagged = lags(record, &compose(name, axes, &all, mixer)?.vehicle);
    let same = |angle: &Angle| lagged.iter().any(|l| l.output == angle.name && l.correlation > SAME_MOTION);
    let (kept, other): (Vec<_>, Vec<_>) = found.into_iter().partition(|(_, angle)| same(angle));
    left_out.extend(other.into_iter().map(|(chosen, angle)| LeftOut {
        output: chosen.name,
        why: format!("it does not match the integral of {}", angle.rate),
    }));
    Ok(kept)
}

fn limits_and_noise(vehicle: &mut Vehicle, record: &Record, used: &[&Chosen]) {
    let values = |name: &str| -> Vec<f64> {
        record
            .get(name)
            .map_or_else(Vec::new, |s| s.values.iter().copied().filter(|v| v.is_finite()).collect())
    };
    for input in &mut vehicle.inputs {
        let all = values(&input.name);
        let least = all.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let room = LIMIT_ROOM * (greatest - least);
        // Outwards also for a range that does not contain zero.
        let outwards = |v: f64, up: bool| if (v > 0.0) == up { rounded(v) } else { v };
        (input.lower, input.upper) = (outwards(least - room, false), outwards(greatest + room, true));
    }
    for output in &mut vehicle.outputs {
        let chosen = used.iter().find(|c| c.name == output.name);
        let own = chosen.map_or_else(Vec::new, |c| own_samples(record, c));
        output.noise = format!("{:.2e}", white_noise_std(&own)).parse().unwrap_or(0.0);
    }
}

fn provenance(log: &str, names: &Names) -> Vec<(String, String)> {
    let mut all = vec![
        ("program".to_string(), format!("whirlstand {}", env!("CARGO_PKG_VERSION"))),
        ("command".into(), "vehicle new".into()),
        ("method".into(), "pem".into()),
        ("noise".into(), "kalman".into()),
        (FORCES.into(), WANDERING.into()),
        (SENSOR_NOISE.into(), ESTIMATED_IN_MOTION.into()),
        ("log_1".into(), log.to_string()),
    ];
    if !names.sha256.is_empty() {
        all.push(("log_1_sha256".into(), names.sha256.clone()));
    }
    all
}

/// The axes with their parameters under the names of the whole vehicle.
fn answers(vehicle: &Vehicle, origins: &[(usize, usize)], fitted: &[(Link, Axis)]) -> Vec<AxisAnswer> {
    let one = |(index, (link, axis)): (usize, &(Link, Axis))| {
        let fit = &axis.tried.fit;
        let own = vehicle.free.iter().zip(origins).filter(|(_, (axis, _))| *axis == index);
        let parameters = own.map(|(whole, (_, own))| {
            let own = &fit.problem.vehicle.free[*own];
            let at = fit.problem.parameters.iter().position(|p| p.target == own.target);
            ParameterAnswer {
                name: vehicle.free_name(&whole.target),
                value: vehicle.free_value(&whole.target),
                unit: vehicle.free_unit_si(&whole.target),
                standard_error: at.map(|i| fit.covariance[(i, i)].max(0.0).sqrt()),
            }
        });
        AxisAnswer {
            parameters: parameters.collect(),
            output: link.output.name.clone(),
            unit: fit.problem.vehicle.outputs[0].unit.si_symbol(),
            input: link.input.name.clone(),
            intersample: axis.pair.intersample.name(),
            structure: axis.tried.structure,
            words: axis.tried.structure.words(),
            heldout: held_out(link, axis),
            tried: axis.all.iter().map(|(s, rmse)| TriedAnswer { words: s.words(), rmse: *rmse }).collect(),
        }
    };
    fitted.iter().enumerate().map(one).collect()
}

fn held_out(link: &Link, axis: &Axis) -> HeldOut {
    let known = |errors: &[f64]| -> Vec<f64> { errors.iter().copied().filter(|e| e.is_finite()).collect() };
    let measured: Vec<f64> = link
        .pair
        .held()
        .iter()
        .flat_map(|s| starts(s, 0, link.horizon).into_iter().map(|k| s.outputs[k + link.horizon]))
        .filter(|v| v.is_finite())
        .collect();
    let spread = rms(&measured).max(f64::MIN_POSITIVE);
    let fit = |errors: &[f64]| 100.0 * (1.0 - rms(&known(errors)) / spread);
    HeldOut {
        horizon_s: link.horizon as f64 * link.pair.period_s,
        seconds: link.pair.held_s(),
        fit: fit(&axis.tried.errors),
        own_past_fit: fit(&link.own_past),
        completed_fit: fit(&axis.tried.completed),
        rmse: rms(&known(&axis.tried.errors)),
    }
}
