//! `whirlstand log info|export|diff`.

use std::path::Path;
use std::process::ExitCode;

use whirlstand_logs::{Diff, Ending, LogInfo, Mapping, Record};

use super::{print, print_json};
use crate::cli::LogCommand;
use crate::error::Failure;
use crate::style;

/// Runs the command.
pub(crate) fn log(command: &LogCommand) -> Result<ExitCode, Failure> {
    match command {
        LogCommand::Info { log, json } => {
            let info = whirlstand_logs::info(log).map_err(Failure::mend)?;
            if *json {
                print_json(&info)?
            } else {
                print(&info_words(&info))?
            }
            Ok(ExitCode::SUCCESS)
        }
        LogCommand::Export { log, output, map } => {
            export(&read(log, map)?, output)?;
            Ok(ExitCode::SUCCESS)
        }
        LogCommand::Diff { a, b, json } => {
            let diff = whirlstand_logs::diff(a, b).map_err(Failure::mend)?;
            if *json {
                print_json(&diff)?
            } else {
                print(&diff_words(&diff))?
            }
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
    whirlstand_logs::read(path, &mappings(map)?).map_err(Failure::mend)
}

fn export(record: &Record, output: &Path) -> Result<(), Failure> {
    if output != Path::new("-") {
        return whirlstand_logs::write_csv(record, output).map_err(Failure::mend);
    }
    let mut text = Vec::new();
    whirlstand_logs::csv_file::format_csv(record, &mut text).map_err(Failure::run)?;
    print(&String::from_utf8_lossy(&text))
}

fn info_words(info: &LogInfo) -> String {
    let mut text = format!(
        "{}  {}, {:.3} s\n",
        style::strong(&info.path.display().to_string()),
        info.kind,
        info.duration
    );
    let mut row = |head: &str, body: String| text.push_str(&format!("  {head:<12}{body}\n"));
    if let Some(bench) = &info.bench {
        row(
            "bench",
            format!(
                "{} with {}, {} over {}, period {} ms, seed {}, whirlstand {}",
                bench.launch,
                bench.vehicle,
                bench.mode,
                bench.transport,
                bench.period_ns as f64 * 1e-6,
                bench.seed,
                bench.version
            ),
        );
    }
    for file in &info.files {
        let ending = match file.ending {
            Ending::Complete => "complete",
            Ending::Truncated => "cut off: its recorder was killed, or still writes",
        };
        row("file", format!("{}, {} bytes, {ending}", file.path.display(), file.bytes));
    }
    for (name, bytes) in &info.attached {
        row("inside", format!("{name}, {bytes} bytes"));
    }
    for topic in &info.topics {
        let rate = topic.rate_hz.map_or(String::new(), |r| format!(", {r:.1} Hz"));
        let lost = if topic.lost > 0 { style::bad(&format!(", {} lost", topic.lost)) } else { String::new() };
        let gaps = if topic.gaps > 0 { style::bad(&format!(", {} gaps", topic.gaps)) } else { String::new() };
        row(
            "topic",
            format!(
                "{:<16} {} messages of {}{rate}{lost}{gaps}",
                topic.name, topic.messages, topic.message_type
            ),
        );
    }
    for signal in &info.signals {
        let unit = if signal.unit.is_empty() { String::new() } else { format!(" [{}]", signal.unit) };
        let number = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.4}"));
        let missing =
            if signal.missing > 0 { format!(", {} missing", signal.missing) } else { String::new() };
        row(
            "signal",
            format!(
                "{:<36} {} to {}, mean {}, std {}, {} values{missing}",
                format!("{}{unit}", signal.name),
                number(signal.min),
                number(signal.max),
                number(signal.mean),
                number(signal.std),
                signal.values
            ),
        );
    }
    for damage in &info.damage {
        let words = format!("{} at byte {}: {}", damage.file.display(), damage.offset, damage.reason);
        row("damage", style::bad(&words));
    }
    for remark in &info.remarks {
        row("remark", remark.clone());
    }
    text
}

fn diff_words(diff: &Diff) -> String {
    let mut text = String::new();
    for topic in &diff.topics {
        let verdict = if topic.set_aside {
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
