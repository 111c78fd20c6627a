//! `whirlstand bench`: measures this machine and compares it with the lower bound that the bare system
//! reaches.

use std::process::ExitCode;

use whirlstand_nodes::bench::{Figure, Member, Options, run, run_member};

use super::bench_mirror::bench_mirror;
use super::bench_tune::bench_tune;
use super::{print, print_data, write_json};
use crate::cli::{BenchArgs, BenchCommand};
use crate::error::Failure;
use crate::style;

/// Runs the measurements; exit code 1 when a goal is missed.
pub(crate) fn bench(args: &BenchArgs) -> Result<ExitCode, Failure> {
    match &args.command {
        Some(BenchCommand::Mirror(args)) => return bench_mirror(args),
        Some(BenchCommand::Tune(args)) => return bench_tune(args),
        None => {}
    }
    if args.member {
        return member();
    }
    for (option, value) in [("--seconds", args.seconds), ("--realtime-seconds", args.realtime_seconds)] {
        if !(value > 0.0 && value <= 86_400.0) {
            return Err(Failure::Mend(format!("{option} {value}: a time between 0 and 86400 s is expected")));
        }
    }
    let program = std::env::current_exe()
        .map_err(|e| Failure::Run(format!("the path of this executable is unknown: {e}")))?;
    let mut what = args.what.clone();
    if args.bridge {
        what.extend(["vehicles".into(), "autopilots".into()]);
    }
    let options = Options {
        what,
        seconds: args.seconds,
        repeat: args.repeat,
        realtime_seconds: args.realtime_seconds,
        priority: args.priority,
        cpus: args.cpus.clone(),
        member: vec![program.to_string_lossy().into_owned(), "bench".into(), "--member".into()],
        run: vec![program.to_string_lossy().into_owned(), "run".into()],
    };
    let quiet = args.json.is_printed();
    let report = run(&options, |figure| {
        if !quiet {
            // A reader that has closed the pipe does not stop the measurement; the closing lines report what could
            // not be written.
            let _ = print(&line(figure));
        }
    })
    .map_err(Failure::mend)?;
    if let Some(path) = &args.json.path {
        write_json(&report, path)?;
    }
    let missed = report.figures.iter().filter(|f| f.goal.is_some_and(|g| !g.met)).count();
    if missed > 0 && !quiet {
        let goals = if missed == 1 { "one goal is".into() } else { format!("{missed} goals are") };
        print(&format!("{}\n", style::bad(&format!("{goals} not met"))))?;
    }
    Ok(ExitCode::from(u8::from(missed > 0)))
}

/// Runs one process of a measurement: its task is read from standard input, its report is written to standard
/// output.
fn member() -> Result<ExitCode, Failure> {
    let member: Member = serde_json::from_reader(std::io::stdin())
        .map_err(|e| Failure::Mend(format!("--member is for the program itself: {e}")))?;
    let text = run_member(&member).map_err(Failure::run)?;
    print_data(&(text + "\n"))?;
    Ok(ExitCode::SUCCESS)
}

fn line(f: &Figure) -> String {
    let number = |v: f64| match v.abs() {
        v if v >= 1e6 => format!("{:.2} M", v * 1e-6),
        v if v >= 1e3 => format!("{:.1} k", v * 1e-3),
        v if v == v.trunc() => format!("{v}"),
        v => format!("{v:.2}"),
    };
    let with = |v: f64| match (f.unit, number(v).trim_end().ends_with(['M', 'k'])) {
        (unit, true) => format!("{}{unit}", number(v)),
        (unit, false) => format!("{} {unit}", number(v)).trim_end().to_string(),
    };
    let range = match f.all.len() {
        0 | 1 => String::new(),
        n => {
            let least = f.all.iter().copied().fold(f64::INFINITY, f64::min);
            let most = f.all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            style::dim(&format!("  {} to {}, {n} runs", number(least), number(most)))
        }
    };
    let goal = f.goal.map_or(String::new(), |g| {
        let text = format!("goal {} {}", if g.at_least { "at least" } else { "at most" }, with(g.limit));
        format!("  {}", if g.met { style::good(&text) } else { style::bad(&format!("{text}: not met")) })
    });
    format!("{:<62} {:>16}{goal}{range}\n", f.name, with(f.value))
}
