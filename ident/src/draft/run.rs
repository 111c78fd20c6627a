//! Drafts a vehicle: from the log to the text of a vehicle file.

use std::path::Path;

use whirlstand_logs::{AnyReadError, Record};
use whirlstand_vehicle::Intersample;

use super::answer::{Draft, LeftOut};
use super::comparison::{compare, takes_away};
use super::compose::Axis;
use super::error::DraftError;
use super::finish::{Names, finish};
use super::flown::Flight;
use super::intersample::likelier;
use super::mixer::Mixer;
use super::proposal::{Chosen, Proposal, is_integral, propose};
use super::reading::{open_all, read_chosen};
use super::select::answers_the_input;
use super::structure::{Actuators, Signals};
use super::survey::{Link, check_motors, fast_enough, link, moves, or_too_slow};
use super::turns::in_degrees;

/// Shortest step of a fit, s: the motion of a vehicle is slower than a gyroscope's sampling.
const SHORTEST_STEP_S: f64 = 0.004;
/// Longest step to which a faster record is resampled, s.
const LONGEST_STEP_S: f64 = 0.008;
/// Number of steps above which a record is resampled to longer ones.
const MANY_STEPS: f64 = 6000.0;

/// Drafts a vehicle from the part of one log, or of each of several, between two times, s of its clock. `observe`
/// receives the progress as text.
///
/// # Errors
/// [`DraftError`], as a full sentence with the remedy.
pub fn draft<P: AsRef<Path>>(
    paths: &[P],
    names: &Names,
    part: (Option<f64>, Option<f64>),
    observe: &(dyn Fn(&str) + Sync),
) -> Result<Draft, DraftError> {
    let logs: Vec<String> = paths.iter().map(|path| path.as_ref().display().to_string()).collect();
    let log = logs.join(", ");
    observe("looking for inputs and outputs");
    let time = names.time.as_deref();
    let opened = open_all(paths, time)?;
    let mut proposal = propose(&log, &opened.offered, opened.clocks, &names.choice)?;
    if names.choice.outputs.is_empty() {
        in_degrees(&mut proposal.outputs, &opened.offered);
    }
    let made = |proposal: &Proposal| from_proposal(paths, (&logs, names), proposal, part, observe);
    let found = made(&proposal);
    let unexplained = matches!(
        found,
        Err(DraftError::OutputsAtRest { .. }
            | DraftError::Unexplained { .. }
            | DraftError::NoStructure { .. })
    );
    // A rate that no input explains may be the noisier picture of a motion that its angle shows: a vehicle that swings about
    // its rest on a stand, or one whose motors are slow.
    if unexplained && let Some(angles) = proposal.with_angles() {
        return made(&angles).or(found);
    }
    found
}

/// Drafts a vehicle with the first inputs of a proposal that explain its outputs.
fn from_proposal<P: AsRef<Path>>(
    paths: &[P],
    (logs, names): (&[String], &Names),
    proposal: &Proposal,
    part: (Option<f64>, Option<f64>),
    observe: &(dyn Fn(&str) + Sync),
) -> Result<Draft, DraftError> {
    let time = (names.time.as_deref(), names.period_s);
    let mut refused = None;
    for group in &proposal.inputs {
        let chosen: Vec<&Chosen> = group.iter().chain(&proposal.outputs).chain(&proposal.motors).collect();
        let records = paths.iter().map(|path| read_chosen(path.as_ref(), &chosen, time, part));
        let records: Vec<Record> = records.collect::<Result<_, _>>()?;
        let moving = |input: &&Chosen| records.iter().any(|record| moves(record, input));
        let inputs: Vec<Chosen> = group.iter().filter(moving).cloned().collect();
        if inputs.is_empty() {
            continue;
        }
        let ends_chosen = (part.0.is_some(), part.1.is_some());
        let flight =
            Flight::of(records, (&inputs, &proposal.outputs), ends_chosen).map_err(AnyReadError::from)?;
        let Some(flight) = flight else { continue };
        match from_inputs((logs, names), proposal, (inputs, &flight), observe) {
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
    Err(refused
        .unwrap_or_else(|| DraftError::InputsAtRest { log: logs.join(", "), inputs: still.join(", ") }))
}

/// Drafts a vehicle that is driven by some inputs of the proposal.
fn from_inputs(
    (logs, names): (&[String], &Names),
    proposal: &Proposal,
    (inputs, flight): (Vec<Chosen>, &Flight),
    observe: &(dyn Fn(&str) + Sync),
) -> Result<Draft, DraftError> {
    let record = &flight.record;
    check_motors(record, &proposal.motors, &inputs)?;
    let (angles, outputs): (Vec<Chosen>, Vec<Chosen>) = proposal
        .outputs
        .iter()
        .cloned()
        .partition(|o| proposal.outputs.iter().any(|rate| is_integral(&o.name, &rate.name)));
    let unexplained = |rate: &Chosen| LeftOut {
        output: rate.name.clone(),
        why: "the inputs do not explain it on held-out data, but its angle".into(),
    };
    let mut left_out: Vec<LeftOut> = proposal.unexplained.iter().map(unexplained).collect();
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
        return Err(refused(DraftError::NoStructure { log: logs.join(", "), found: found.join("; ") }));
    }
    finish((logs, names), flight, (&axes, mixer.as_ref()), &angles, left_out)
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
