//! `whirlstand log info|export|diff`.

use std::path::Path;
use std::process::ExitCode;

use sha2::{Digest, Sha256};
use whirlstand_logs::shown::{counted, number};
use whirlstand_logs::{
    BenchInfo, Diff, Ending, IN_CHARGE, InCharge, Kind, LogInfo, Mapping, Record, SignalSummary, TopicInfo,
};
use whirlstand_msgs::units::clean;
use whirlstand_vehicle::Vehicle;

use super::{print_data, tell};
use crate::cli::{LogCommand, RecordArgs};
use crate::error::Failure;
use crate::style;

/// Runs the command.
pub(crate) fn log(command: &LogCommand) -> Result<ExitCode, Failure> {
    match command {
        LogCommand::Info { log, json } => {
            let info = whirlstand_logs::info(log).map_err(Failure::mend)?;
            tell(json, &info, || info_text(&info))?;
            Ok(ExitCode::SUCCESS)
        }
        LogCommand::Export { log, output, map } => {
            export(&read(log, map)?, output)?;
            Ok(ExitCode::SUCCESS)
        }
        LogCommand::Diff { a, b, json } => {
            let diff = whirlstand_logs::diff(a, b).map_err(Failure::mend)?;
            tell(json, &diff, || diff_text(&diff))?;
            Ok(if diff.identical { ExitCode::SUCCESS } else { ExitCode::from(1) })
        }
    }
}

/// Parses the mappings of `--map`.
///
/// # Errors
/// When one is not a mapping.
pub(crate) fn mappings(map: &[String]) -> Result<Vec<Mapping>, Failure> {
    map.iter().map(|text| text.parse().map_err(|e| Failure::Mend(format!("--map {text}: {e}")))).collect()
}

/// Reads a log of any known kind with the mappings of `--map`.
///
/// # Errors
/// What is wrong with the file or a mapping.
pub(crate) fn read(path: &Path, map: &[String]) -> Result<Record, Failure> {
    let record = whirlstand_logs::read(path, &mappings(map)?).map_err(Failure::mend)?;
    tell_missing(&record, |_| true);
    Ok(record)
}

/// Prints which rows were left out, and which numbers of these signals stood for missing values.
fn tell_missing(record: &Record, is_used: impl Fn(&str) -> bool) {
    for remark in record.left_out_rows().remarks() {
        style::say(&format!("{}: {remark}", record.origin));
    }
    for mark in record.missing_marks().iter().filter(|mark| is_used(&mark.name)) {
        style::say(&format!("{}: {mark}", record.origin));
    }
}

/// SHA-256 of a log: of the contents of all its files in order.
///
/// # Errors
/// When one cannot be read.
pub(crate) fn hash(path: &Path) -> Result<String, Failure> {
    let mut hash = Sha256::new();
    for file in whirlstand_logs::log_files(path).map_err(Failure::mend)? {
        let mut reader = std::fs::File::open(&file).map_err(|e| Failure::file("read", &file, &e))?;
        std::io::copy(&mut reader, &mut hash).map_err(|e| Failure::file("read", &file, &e))?;
    }
    Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect())
}

/// Reads a log of any known kind for a vehicle. The mappings of `--map` apply, and those of the vehicle's own
/// `map` for signals that `--map` does not name. An entry of `map` is ignored where the log lacks its signal but
/// has the vehicle's own name for it, as logs of benches have. Of a bench's log only the vehicle's own signals are
/// kept.
///
/// # Errors
/// What is wrong with the file or a mapping.
pub(crate) fn read_for(path: &Path, map: &[String], vehicle: &Vehicle) -> Result<Record, Failure> {
    let outputs = vehicle.outputs.iter().map(|output| output.name.as_str());
    let inputs = vehicle.inputs.iter().map(|input| input.name.as_str());
    let signals: Vec<&str> = outputs.chain(inputs).chain([IN_CHARGE]).collect();
    read_with(path, map, vehicle, Some(&signals))
}

/// The steps of `--period`; without it those to which the vehicle was fitted, where the record's are shorter: the vehicle's
/// noise is that of such steps, and of what happens within them it knows nothing.
pub(crate) fn period_of(part: &RecordArgs, vehicle: &Vehicle, record: &Record) -> Option<f64> {
    let inherited = || {
        let period = vehicle.fit_period().filter(|period| record.is_finer_than(*period))?;
        crate::style::say(&format!(
            "{}: steps of {} s, as vehicle '{}' was fitted; --period gives others",
            record.origin,
            number(period),
            vehicle.name
        ));
        Some(period)
    };
    part.period.or_else(inherited)
}

/// As [`read_for`], but with every signal of the log, including the controller's inputs and answers.
///
/// # Errors
/// As [`read_for`].
pub(crate) fn read_all_for(path: &Path, map: &[String], vehicle: &Vehicle) -> Result<Record, Failure> {
    read_with(path, map, vehicle, None)
}

/// Reads these signals of a bench's log, or all of them.
fn read_with(
    path: &Path,
    map: &[String],
    vehicle: &Vehicle,
    signals: Option<&[&str]>,
) -> Result<Record, Failure> {
    let given = mappings(map)?;
    let wrong = |e| Failure::Mend(format!("map of vehicle '{}': {e}", vehicle.name));
    let own = vehicle.map.iter().filter(|(name, _)| !given.iter().any(|m| m.name == *name));
    let own = own.map(|(name, source)| format!("{name}={source}").parse::<Mapping>());
    let mut own = own.collect::<Result<Vec<_>, _>>().map_err(wrong)?;
    loop {
        let all: Vec<Mapping> = given.iter().chain(&own).cloned().collect();
        let read = match signals {
            Some(signals) => whirlstand_logs::read_signals(path, &all, signals),
            None => whirlstand_logs::read(path, &all),
        };
        match read {
            Ok(record) => {
                let is_own = |name: &str| {
                    vehicle.output_index(name).is_some() || vehicle.inputs.iter().any(|i| i.name == name)
                };
                tell_missing(&record, is_own);
                let record = in_units_of(vehicle, flown_by_the_controller(record)?, &given)?;
                return Ok(between_samples(record, path, vehicle));
            }
            Err(error) => {
                let missing = error.missing_source().map(|missing| missing.name.clone());
                match own.iter().position(|m| missing.as_ref() == Some(&m.name)) {
                    Some(at) => drop(own.remove(at)),
                    None => return Err(Failure::mend(error)),
                }
            }
        }
    }
}

/// The record with what the vehicle's inputs did between its samples. In a log of a bench they were held, whatever the vehicle
/// was drafted from.
fn between_samples(record: Record, path: &Path, vehicle: &Vehicle) -> Record {
    let of_bench = || {
        let is_mcap = whirlstand_logs::kind(path).is_ok_and(|kind| kind == Kind::Mcap);
        is_mcap && whirlstand_logs::Log::open(path).is_ok_and(|log| log.info().is_some())
    };
    let straight: Vec<&str> =
        vehicle.inputs.iter().filter(|i| i.is_straight()).map(|i| i.name.as_str()).collect();
    if straight.is_empty() || of_bench() {
        return record;
    }
    record.with_means_over_steps(|name| straight.contains(&name))
}

/// For a vehicle behind a bridge: the part of the record in which the controller had control, which is also
/// printed. Any other record is returned unchanged.
fn flown_by_the_controller(record: Record) -> Result<Record, Failure> {
    let Some(charge) = InCharge::of(&record).filter(|charge| !charge.is_whole()) else { return Ok(record) };
    if charge.is_never() {
        let why = "the controller never had control, so nothing can be learned from it";
        return Err(Failure::Mend(format!("{}: {why}", record.origin)));
    }
    style::say(&format!("{}: {}", record.origin, charge.text()));
    Ok(charge.part_of(&record))
}

/// The record, in which a signal whose unit does not fit the vehicle's signal of that name is unreadable. Such a
/// signal is an error at once where `--map` names it.
fn in_units_of(vehicle: &Vehicle, record: Record, given: &[Mapping]) -> Result<Record, Failure> {
    let inputs = vehicle.inputs.iter().map(|u| (u.name.as_str(), u.unit.unit()));
    let outputs = vehicle.outputs.iter().map(|y| (y.name.as_str(), y.unit.unit()));
    let record = record.expecting(inputs.chain(outputs));
    match record.unreadable().iter().find(|u| given.iter().any(|m| m.name == u.name)) {
        Some(wrong) => Err(Failure::mend(wrong)),
        None => check_delays(vehicle, &record).map(|()| record),
    }
}

/// Refuses a vehicle whose delay is longer than the record can show.
///
/// # Errors
/// Names the delay in two units.
pub(crate) fn check_delays(vehicle: &Vehicle, record: &Record) -> Result<(), Failure> {
    if record.time_unit == "samples" {
        return Ok(());
    }
    let span = format!("the record {}", record.origin);
    let mut checked = vehicle.effects.iter().map(|e| e.check_delay(record.duration(), &span));
    checked
        .find_map(Result::err)
        .map_or(Ok(()), |e| Err(Failure::Mend(format!("vehicle '{}': {e}", vehicle.name))))
}

fn export(record: &Record, output: &Path) -> Result<(), Failure> {
    for left_out in record.unreadable() {
        crate::style::say(&format!("left out: {left_out}"));
    }
    if output != Path::new("-") {
        return whirlstand_logs::write_csv(record, output).map_err(Failure::mend);
    }
    let mut text = Vec::new();
    whirlstand_logs::csv_file::format_csv(record, &mut text).map_err(Failure::run)?;
    print_data(&String::from_utf8_lossy(&text))
}

fn info_text(info: &LogInfo) -> String {
    let mut text = format!(
        "{}  {}, {:.3} s\n",
        style::strong(&info.path.display().to_string()),
        info.kind,
        info.duration
    );
    let mut row = |head: &str, body: String| text.push_str(&format!("  {head:<12}{body}\n"));
    if let Some(bench) = &info.bench {
        row("bench", bench_text(bench));
    }
    for file in &info.files {
        let ending = match file.ending {
            Ending::Complete => "complete",
            Ending::Truncated => "truncated: its recorder was killed or is still writing",
        };
        row("file", format!("{}, {} bytes, {ending}", file.path.display(), file.bytes));
    }
    for (name, bytes) in &info.attached {
        row("inside", format!("{name}, {bytes} bytes"));
    }
    info.topics.iter().for_each(|topic| row("topic", topic_text(topic)));
    info.signals.iter().for_each(|signal| row("signal", signal_text(signal)));
    for damage in &info.damage {
        let text = format!("{} at byte {}: {}", damage.file.display(), damage.offset, damage.reason);
        row("damage", style::bad(&text));
    }
    for remark in &info.remarks {
        row("remark", remark.clone());
    }
    text
}

fn bench_text(bench: &BenchInfo) -> String {
    format!(
        "{} with {}, {} over {}, period {} ms, seed {}, whirlstand {}",
        bench.launch,
        bench.vehicle,
        bench.mode,
        bench.transport,
        clean(bench.period_ns as f64 * 1e-6),
        bench.seed,
        bench.version
    )
}

fn topic_text(topic: &TopicInfo) -> String {
    let rate = topic.rate_hz.map_or(String::new(), |r| format!(", {r:.1} Hz"));
    let lost = if topic.lost > 0 { style::bad(&format!(", {} lost", topic.lost)) } else { String::new() };
    let gaps =
        if topic.gaps > 0 { style::bad(&format!(", {}", counted(topic.gaps, "gap"))) } else { String::new() };
    let of = if topic.message_type.is_empty() { "" } else { " of " };
    format!("{:<16} {} messages{of}{}{rate}{lost}{gaps}", topic.name, topic.messages, topic.message_type)
}

fn signal_text(signal: &SignalSummary) -> String {
    let unit = if signal.unit.is_empty() { String::new() } else { format!(" [{}]", signal.unit) };
    let number = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.4}"));
    let missing = if signal.missing > 0 { format!(", {} missing", signal.missing) } else { String::new() };
    format!(
        "{:<36} {} to {}, mean {}, std {}, {} values{missing}",
        format!("{}{unit}", signal.name),
        number(signal.min),
        number(signal.max),
        number(signal.mean),
        number(signal.std),
        signal.values
    )
}

fn diff_text(diff: &Diff) -> String {
    let mut text = String::new();
    for topic in &diff.topics {
        let verdict = if topic.is_made_of_others {
            style::dim("derived from the others, not compared")
        } else if topic.set_aside {
            style::dim("wall-clock, not compared")
        } else if topic.first.is_none() {
            style::good("same")
        } else {
            style::bad("different")
        };
        text.push_str(&format!(
            "  {:<16} {:>8} and {:>8} messages, {:>8} equal  {verdict}\n",
            topic.topic, topic.messages_a, topic.messages_b, topic.equal
        ));
    }
    for bench in &diff.benches {
        text.push_str(&style::dim(&format!("  {} is {} in A and {} in B\n", bench.key, bench.a, bench.b)));
    }
    for remark in &diff.remarks {
        text.push_str(&format!("  {remark}\n"));
    }
    let end = match &diff.first {
        Some(first) => style::bad(&format!("The logs differ, first at {first}.")),
        None if diff.identical => style::good("The logs are the same, bit for bit."),
        None => style::bad("The logs differ."),
    };
    text + &end + "\n"
}
