//! `whirlstand identify`: estimates the free parameters of a vehicle from records.

use std::path::Path;
use std::process::ExitCode;

use whirlstand_ident::identify::align::lags;
use whirlstand_ident::identify::{Log, Method, Noise, Nuisance, Options, Segment, Source, identify as run};
use whirlstand_logs::Record;
use whirlstand_msgs::units::clean;
use whirlstand_vehicle::{FIT_PERIOD, Vehicle};

use super::early_end::EarlyEnd;
use super::log::{hash, period_of, read_all_for};
use super::vehicles::find;
use super::{print, write, write_json};
use crate::cli::{IdentifyArgs, IdentifyMethod, IdentifyNoise};
use crate::error::Failure;

/// Runs the command. Ctrl-C and a budget of time end the search, and the results found by then are reported,
/// as in `diagnose`.
pub(crate) fn identify(args: &IdentifyArgs) -> Result<ExitCode, Failure> {
    check(args)?;
    let vehicle = find(&args.vehicle)?;
    let (search, watch) = EarlyEnd::new("identify", args.budget)?;
    let (mut fitted, mut control, mut closed_loop) = (Vec::new(), Vec::new(), args.closed_loop);
    let mut averaged = None;
    for path in &args.logs {
        let Opened { log, record, period, coarser } = open(path, args, &vehicle)?;
        closed_loop |= steered(&record);
        averaged = averaged.or(period.filter(|_| coarser));
        let (first, last) = (record.time.first().copied(), record.time.last().copied());
        let from = args.part.from.unwrap_or(f64::NEG_INFINITY).max(first.unwrap_or(0.0));
        let to = args.part.to.unwrap_or(f64::INFINITY).min(last.unwrap_or(0.0));
        // The data between two held-out parts may be too short for identification.
        let least = 16.0 * record.duration() / record.len().max(1) as f64;
        for (from, to) in rest((from, to), &args.hold_out, least) {
            for segment in parts(&record, &vehicle, period, (from, to))? {
                fitted.push(Source { log: log.clone(), segment });
            }
        }
        for &(a, b) in &args.hold_out {
            for segment in parts(&record, &vehicle, period, (a.max(from), b.min(to)))? {
                control.push(Source { log: log.clone(), segment });
            }
        }
    }
    for path in &args.validation {
        let Opened { log, record, period, .. } = open(path, args, &vehicle)?;
        for segment in parts(&record, &vehicle, period, (f64::NEG_INFINITY, f64::INFINITY))? {
            control.push(Source { log: log.clone(), segment });
        }
    }
    let answer = run(&vehicle, &fitted, &control, &options(args, closed_loop), &watch);
    let search = search.finish();
    let mut answer = answer.map_err(Failure::mend)?;
    if let (Some(fitted), Some(period)) = (&mut answer.fitted, averaged) {
        fitted.provenance.push((FIT_PERIOD.into(), period.to_string()));
    }
    if let (Some(path), Some(fitted)) = (&args.output, &answer.fitted) {
        write(path, &fitted.to_toml())?;
        answer.fitted_vehicle = Some(path.display().to_string());
    }
    if let Some(path) = &args.result.json.path {
        write_json(&answer, path)?;
    }
    let report = args.result.out.as_ref().map(|folder| folder.join("report.html"));
    if let Some(path) = &report {
        write(path, &whirlstand_report::identification_report(&answer).map_err(Failure::run)?)?;
    }
    if !args.result.json.is_printed() {
        let mut text = answer.text();
        for (what, path) in [("vehicle", args.output.as_ref()), ("report", report.as_ref())] {
            if let Some(path) = path {
                text.push_str(&format!("{what:7} {}\n", path.display()));
            }
        }
        print(&text)?;
    }
    Ok(search.exit_code(answer.partial))
}

fn check(args: &IdentifyArgs) -> Result<(), Failure> {
    if args.part.period.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
        return Err(Failure::Mend("--period: a time above 0 s is expected".into()));
    }
    if let (Some(from), Some(to)) = (args.part.from, args.part.to)
        && from >= to
    {
        return Err(Failure::Mend(format!("--from {from} is after --to {to}: nothing is left to fit")));
    }
    Ok(())
}

fn options(args: &IdentifyArgs, closed_loop: bool) -> Options {
    Options {
        method: match args.method {
            IdentifyMethod::Ga => Method::Ga,
            IdentifyMethod::Pem => Method::Pem,
            IdentifyMethod::GaPem => Method::GaPem,
        },
        noise: args.noise.map(|noise| match noise {
            IdentifyNoise::White => Noise::White,
            IdentifyNoise::Coloured => Noise::Coloured,
            IdentifyNoise::Kalman => Noise::Kalman,
        }),
        closed_loop,
        nuisance: Nuisance { initial_state: true, output_offsets: args.offsets },
        detrend: args.detrend,
        seed: args.seed,
        evaluations: args.evaluations,
        stagnation: args.stagnation,
    }
}

/// A log that has been read.
struct Opened {
    /// The file and its hash.
    log: Log,
    /// The record, on the clock of the fit.
    record: Record,
    /// Steps of the fit if they are not the record's own, s.
    period: Option<f64>,
    /// True when the record was averaged to longer steps.
    coarser: bool,
}

/// Reads a log and resamples it to the clock of the fit.
fn open(path: &Path, args: &IdentifyArgs, vehicle: &Vehicle) -> Result<Opened, Failure> {
    let mut record = aligned(read_all_for(path, &args.part.map, vehicle)?, args, vehicle)?;
    let period = period_of(&args.part, vehicle, &record);
    let coarser = period.is_some_and(|period| record.is_finer_than(period));
    if let Some(period) = period {
        if record.time_unit == "samples" {
            record = record.with_sample_period(period);
        } else if coarser {
            // A coarser clock: the signal passes through the anti-aliasing filter.
            let held = |name: &str| vehicle.input_index(name).is_some();
            record = record.resampled(period, held).map_err(Failure::mend)?;
        }
    }
    Ok(Opened { log: Log { file: path.display().to_string(), sha256: hash(path)? }, record, period, coarser })
}

/// True when a log of this program shows that a controller was in the loop: a reference was tracked, or the
/// command differs from the stick.
fn steered(record: &Record) -> bool {
    record.signals().iter().any(|s| {
        let tracked = s.name.starts_with("setpoint.")
            && !s.name.starts_with("setpoint.stick.")
            && s.values.iter().any(|v| v.is_finite());
        let stick = s.name.strip_prefix("command.").and_then(|u| record.get(&format!("setpoint.stick.{u}")));
        let steered = stick.is_some_and(|stick| {
            s.values.iter().zip(&stick.values).any(|(u, v)| u.is_finite() && v.is_finite() && u != v)
        });
        tracked || steered
    })
}

fn parts(
    record: &Record,
    vehicle: &Vehicle,
    period: Option<f64>,
    (from, to): (f64, f64),
) -> Result<Vec<Segment>, Failure> {
    let some = |v: f64| v.is_finite().then_some(v);
    Segment::unbroken(record, vehicle, period, (some(from), some(to))).map_err(Failure::mend)
}

/// Shifts the signals whose delay is given. Without any given delay, reports the signals that lag.
fn aligned(record: Record, args: &IdentifyArgs, vehicle: &Vehicle) -> Result<Record, Failure> {
    for (name, delay) in &args.delay {
        record.signal(name).map_err(|e| Failure::Mend(format!("--delay {name}: {e}")))?;
        if delay.abs() >= record.duration() {
            return Err(Failure::Mend(format!(
                "--delay {name}={delay}: {delay} s = {} ms, but {} lasts {} s: nothing would be left of {name}",
                clean(1e3 * delay),
                record.origin,
                clean(record.duration())
            )));
        }
    }
    let mut delays = args.delay.clone();
    let given = |name: &str| args.delay.iter().any(|(n, _)| n == name);
    for lag in lags(&record, vehicle).into_iter().filter(|l| !given(&l.output)) {
        let shift = format!(
            "{} lags {}, its derivative, by {:.1} ms (correlation {:.3})",
            lag.output,
            lag.rate,
            1e3 * lag.lag_s,
            lag.correlation
        );
        let period = record.duration() / record.len().max(2) as f64;
        match (args.align, lag.certain) {
            (true, true) => {
                crate::style::say(&format!("{}: {shift}: shifted", record.origin));
                delays.push((lag.output, lag.lag_s));
            }
            (true, false) => {
                crate::style::say(&format!("{}: {shift}: not certain, so not shifted", record.origin))
            }
            (false, true) if lag.lag_s.abs() > 1.5 * period.max(0.01) => {
                crate::style::say(&format!("{}: {shift}: use --align to shift it", record.origin));
            }
            _ => {}
        }
    }
    Ok(if delays.is_empty() { record } else { record.without_delays(&delays) })
}

/// The parts of an interval that remain without the intervals `without`, as far as they are longer than
/// `least`.
fn rest(whole: (f64, f64), without: &[(f64, f64)], least: f64) -> Vec<(f64, f64)> {
    let mut sorted = without.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut left = Vec::new();
    let mut from = whole.0;
    for (a, b) in sorted {
        if a > from && from < whole.1 {
            left.push((from, a.min(whole.1)));
        }
        from = from.max(b);
    }
    if from < whole.1 {
        left.push((from, whole.1));
    }
    if left.len() > 1 {
        left.retain(|(a, b)| b - a > least);
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_held_out_is_not_fitted() {
        assert_eq!(rest((3.0, 84.0), &[(60.0, 84.0)], 0.1), [(3.0, 60.0)]);
        let two = [(6.0, 7.0), (2.0, 3.0)];
        assert_eq!(rest((0.0, 10.0), &two, 0.1), [(0.0, 2.0), (3.0, 6.0), (7.0, 10.0)]);
        assert_eq!(rest((0.0, 10.0), &[(9.95, 10.0)], 0.1), [(0.0, 9.95)]);
        assert!(rest((0.0, 1.0), &[(-1.0, 2.0)], 0.1).is_empty());
    }
}
