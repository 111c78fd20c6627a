//! Combines fitted axes into the vehicle, its file, and the answer about both.

use whirlstand_logs::stats::{rms, white_noise_std};
use whirlstand_logs::{Record, rounding_step};
use whirlstand_vehicle::{ESTIMATED_IN_MOTION, FIT_PERIOD, Matrix, SENSOR_NOISE, Target, Vehicle};

use super::answer::{
    AxisAnswer, DRAFT_SCHEMA, Draft, HeldOut, LeftOut, ParameterAnswer, SignalAnswer, TriedAnswer,
};
use super::comments;
use super::compose::{Angle, Axis, Composed, compose};
use super::error::DraftError;
use super::flown::Flight;
use super::mixer::Mixer;
use super::names::model_name;
use super::own_past::starts;
use super::proposal::{Choice, Chosen, is_integral};
use super::reading::own_samples;
use super::structure::rounded;
use super::survey::Link;
use crate::identify::AT_BOUND;
use crate::identify::align::lags;
use crate::identify::force_fit::{FORCES, WANDERING};

/// Margin of an input's limits beyond the record's range, as a share of it.
const LIMIT_ROOM: f64 = 0.1;
/// Correlation of an angle with the integral of its rate from which both show the same motion.
const SAME_MOTION: f64 = 0.7;
/// Rounding is written where its step is coarser than this share of the scatter: below, it is noise (Sheppard 1898).
const COARSE_STEP: f64 = 0.5;

/// Options of a draft.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Names {
    /// Signals chosen by the user.
    pub choice: Choice,
    /// Name of the time column of a CSV, as in `--map t=`.
    pub time: Option<String>,
    /// Time between two rows of a record that counts them, s.
    pub period_s: Option<f64>,
    /// Name of the vehicle; by default that of the log without its extension.
    pub vehicle: Option<String>,
    /// SHA-256 of each log, for the file's provenance; empty for none.
    pub sha256: Vec<String>,
}

/// Combines the axes and writes the text of the vehicle file.
///
/// # Errors
/// [`DraftError`], when the vehicle or its file does not hold together, which means a mistake in this room.
pub fn finish(
    (logs, names): (&[String], &Names),
    Flight { record, flown }: &Flight,
    (fitted, mixer): (&[(Link, Axis)], Option<&Mixer>),
    angles: &[Chosen],
    mut left_out: Vec<LeftOut>,
) -> Result<Draft, DraftError> {
    let axes: Vec<Axis> = fitted.iter().map(|(_, axis)| axis.clone()).collect();
    let name = model_name(logs.first().map_or("", String::as_str), names.vehicle.as_deref());
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
    vehicle.provenance = provenance(logs, names);
    let period_s = axes.first().map_or(0.0, |axis| axis.pair.period_s);
    if record.is_finer_than(period_s) {
        vehicle.provenance.push((FIT_PERIOD.into(), period_s.to_string()));
    }
    let mut draft = Draft {
        schema: DRAFT_SCHEMA.into(),
        log: logs.join(", "),
        vehicle: name,
        period_s,
        axes: answers(&vehicle, &origins, fitted),
        angles: angles.iter().map(|(c, _)| c.name.clone()).collect(),
        signals: used
            .iter()
            .map(|c| SignalAnswer { name: c.name.clone(), source: c.source.clone(), why: c.why.clone() })
            .collect(),
        left_out,
        missing_values: record
            .missing_marks()
            .iter()
            .map(ToString::to_string)
            .chain(record.left_out_rows().remarks())
            .collect(),
        flown: flown.first().filter(|_| logs.len() == 1).map(|flown| flown.part),
        flown_in: if logs.len() == 1 { Vec::new() } else { flown.clone() },
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
    let rates = || axes.iter().map(|a| &a.tried.fit.problem.vehicle.outputs[0].name);
    let mut found = Vec::new();
    for chosen in angles {
        let Some(signal) = record.get(&chosen.name) else { continue };
        let mut leave =
            |why: &str| left_out.push(LeftOut { output: chosen.name.clone(), why: why.to_string() });
        let Some(rate) = rates().find(|rate| is_integral(&chosen.name, rate)) else {
            leave("its rate is not an axis of the model");
            continue;
        };
        if signal.values.windows(2).any(|w| (w[1] - w[0]).abs() > std::f64::consts::PI) {
            leave("it wraps around, which a linear model cannot do");
        } else {
            let unit = signal.unit.parse().unwrap_or_default();
            found.push((chosen.clone(), Angle { name: chosen.name.clone(), unit, rate: rate.clone() }));
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
        let mut own = chosen.map_or_else(Vec::new, |c| own_samples(record, c));
        let scatter = white_noise_std(&own);
        own.sort_unstable_by(f64::total_cmp);
        let step = rounding_step(&own, COARSE_STEP * scatter).unwrap_or(0.0);
        let noise = scatter.hypot(step / 12f64.sqrt());
        let digits = |value: String| value.parse().unwrap_or(0.0);
        (output.noise, output.quantization) = (digits(format!("{noise:.2e}")), digits(format!("{step:.3e}")));
    }
}

fn provenance(logs: &[String], names: &Names) -> Vec<(String, String)> {
    let mut all = vec![
        ("program".to_string(), format!("whirlstand {}", env!("CARGO_PKG_VERSION"))),
        ("command".into(), "vehicle new".into()),
        ("method".into(), "pem".into()),
        ("noise".into(), "kalman".into()),
        (FORCES.into(), WANDERING.into()),
        (SENSOR_NOISE.into(), ESTIMATED_IN_MOTION.into()),
    ];
    for (k, log) in logs.iter().enumerate() {
        all.push((format!("log_{}", k + 1), log.clone()));
        all.extend(names.sha256.get(k).map(|sha256| (format!("log_{}_sha256", k + 1), sha256.clone())));
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
            let value = vehicle.free_value(&whole.target);
            // A lag or a delay at its lower end is none.
            let ends = [Some(own.upper), matches!(own.target, Target::Entry(..)).then_some(own.lower)];
            let edge = AT_BOUND * (own.upper - own.lower);
            ParameterAnswer {
                at_bound: ends
                    .into_iter()
                    .flatten()
                    .any(|end| (fit.problem.vehicle.free_value(&own.target) - end).abs() <= edge),
                name: vehicle.free_name(&whole.target),
                value,
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
