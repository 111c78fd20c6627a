//! `whirlstand echo`: prints the messages of a running bench as they arrive.

use std::fs::File;
use std::io::{ErrorKind, Write};
use std::ops::ControlFlow;
use std::process::ExitCode;

use crate::cli::EchoArgs;
use crate::error::Failure;
use crate::live::{BenchCard, follow};

/// Runs the command.
pub(crate) fn echo(args: &EchoArgs) -> Result<ExitCode, Failure> {
    let card = BenchCard::find(&args.bench)?;
    let vehicle = card.vehicle()?;
    let mut out: Box<dyn Write> = match &args.json.path {
        Some(path) if !args.json.is_printed() => {
            Box::new(File::create(path).map_err(|e| Failure::file("write", path, &e))?)
        }
        _ => Box::new(anstream::stdout()),
    };
    let mut left = args.count.map(u64::from);
    let ended = follow(&card, &args.topic, |message| {
        let line = match args.json.path {
            Some(_) => message.json().to_string(),
            None => message.line(&vehicle),
        };
        match writeln!(out, "{line}").and_then(|()| out.flush()) {
            // A reader that has closed the pipe (`| head`) has seen enough.
            Err(e) if e.kind() == ErrorKind::BrokenPipe => return Ok(ControlFlow::Break(())),
            Err(e) => return Err(Failure::Run(format!("cannot write the messages: {e}"))),
            Ok(()) => {}
        }
        left = left.map(|left| left - 1);
        Ok(if left == Some(0) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    })?;
    if ended.lost > 0 {
        tracing::warn!("{} messages came faster than they could be printed and were dropped", ended.lost);
    }
    if left.is_some_and(|left| left > 0) && ended.signal.is_none() {
        return Err(Failure::Run(format!(
            "bench '{}' ended after {} messages on {}",
            args.bench.name, ended.shown, args.topic
        )));
    }
    Ok(ExitCode::SUCCESS)
}
