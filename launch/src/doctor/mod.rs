//! `whirlstand doctor`: checks whether this machine is fit for real time, and advises what to change.

mod check;
mod checks;
mod wake;

use std::process::ExitCode;

use serde::Serialize;

use crate::cli::DoctorArgs;
use crate::error::Failure;
use crate::style;
use check::{Check, Grade};

#[derive(Debug, Serialize)]
struct Report {
    schema: &'static str,
    fit: bool,
    checks: Vec<Check>,
    wake_up: Vec<wake::WakeUp>,
}

/// Examines the machine and prints the result.
pub(crate) fn doctor(args: &DoctorArgs) -> Result<ExitCode, Failure> {
    let checks = checks::all();
    let wake_up = wake::sample()?;
    let fit = checks.iter().all(|c| c.grade != Grade::Warn);
    let report = Report { schema: "whirlstand.doctor.v1", fit, checks, wake_up };
    crate::command::tell(&args.json, &report, || text(&report))?;
    Ok(ExitCode::SUCCESS)
}

fn text(report: &Report) -> String {
    let Report { checks, wake_up, .. } = report;
    let mut text = String::new();
    for check in checks {
        let mark = match check.grade {
            Grade::Ok => style::good("ok  "),
            Grade::Warn => style::bad("warn"),
            Grade::Unknown => style::dim("?   "),
        };
        text.push_str(&format!("{mark}  {:<18} {}\n", check.name, check.found));
        if let Some(advice) = &check.advice {
            text.push_str(&format!("      {:<18} {} {advice}\n", "", style::dim("->")));
        }
    }
    text.push_str("\nWake-up latency, 1 kHz absolute deadlines, one second each (us):\n");
    for w in wake_up {
        text.push_str(&format!(
            "      {:<18} p50 {:>7.1}   p99 {:>7.1}   p99.9 {:>7.1}   max {:>7.1}   over 1 ms: {} of {}\n",
            w.scheduling, w.p50_us, w.p99_us, w.p999_us, w.max_us, w.missed, w.wakes
        ));
    }
    let warned = checks.iter().filter(|c| c.grade == Grade::Warn).count();
    text.push_str(&format!(
        "\n{}\n",
        match warned {
            0 => style::good("This machine is fit for real time."),
            1 => style::bad("1 thing to change before trusting real-time runs on this machine."),
            n => style::bad(&format!("{n} things to change before trusting real-time runs on this machine.")),
        }
    ));
    text
}
