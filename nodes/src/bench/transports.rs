//! What a transport costs: the same flight over each, in real time, by the figures of its run.

use std::process::{Command, Stdio};

use serde_json::Value;

use super::{BenchError, Figure, Options};

/// The launch file: steps of roll and pitch, then a gust.
const LAUNCH: &str = "quadrotor-lqr";

/// Rates of the loop, Hz.
const RATES: [u32; 2] = [200, 1000];

/// Each transport, and its name.
const TRANSPORTS: [(&str, &str); 3] =
    [("inproc", "in one process"), ("iceoryx2", "iceoryx2"), ("zenoh", "Zenoh, TCP on loopback")];

/// Outputs whose course is told.
const OUTPUTS: [&str; 2] = ["roll", "pitch"];

/// Flies it over every transport at every rate, beside lockstep, in which no command is late.
pub(super) fn transports(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let mut figures = Vec::new();
    for rate in RATES {
        figures
            .extend(told(&format!("lockstep, {rate} Hz"), &[flown(options, "inproc", "lockstep", rate)?])?);
        for (transport, name) in TRANSPORTS {
            let runs = (0..options.repeat).map(|_| flown(options, transport, "realtime", rate));
            let runs = runs.collect::<Result<Vec<_>, _>>()?;
            figures.extend(told(&format!("realtime {name}, {rate} Hz"), &runs)?);
        }
    }
    Ok(figures)
}

/// The figures of runs that are the same but for the clock.
fn told(name: &str, runs: &[Value]) -> Result<Vec<Figure>, BenchError> {
    let of = |path: &str| -> Result<Vec<f64>, BenchError> {
        let values = runs.iter().map(|run| run.pointer(path)?.as_f64()).collect::<Option<Vec<f64>>>();
        values.ok_or_else(|| BenchError::Member { who: name.into(), why: format!("its run has no {path}") })
    };
    let missed = format!("{name}: missed deadlines in {} steps", of("/timing/nodes/plant/steps")?[0]);
    let mut figures = vec![Figure::lowest(missed, "", of("/timing/deadline_misses")?, None)];
    // In lockstep nobody asks how late a command is.
    if runs.iter().all(|run| run["mode"] == "realtime") {
        for (quantile, key) in [("p50", "p50_us"), ("p99", "p99_us"), ("max", "max_us")] {
            let all = of(&format!("/timing/nodes/plant/latency/{key}"))?;
            figures.push(Figure::lowest(format!("  command latency, {quantile}"), "us", all, None));
        }
    }
    for output in OUTPUTS {
        for (key, name, unit) in
            [("iae", "integral of the error", "deg s"), ("peak", "peak after the gust", "deg")]
        {
            // A run whose log has gaps, which a network may leave, has not every figure.
            let path = format!("/outputs/{output}/{key}");
            let value = |run: &Value| run.pointer(&path).and_then(Value::as_f64).map(f64::to_degrees);
            let all: Vec<f64> = runs.iter().filter_map(value).collect();
            if !all.is_empty() {
                figures.push(Figure::lowest(format!("  {output}: {name}"), unit, all, None));
            }
        }
    }
    Ok(figures)
}

/// One run, as its JSON tells it.
fn flown(options: &Options, transport: &str, mode: &str, rate: u32) -> Result<Value, BenchError> {
    let who = || format!("the run of {LAUNCH} over {transport} at {rate} Hz");
    let (program, arguments) = options
        .run
        .split_first()
        .ok_or_else(|| BenchError::Member { who: who(), why: "no program was given that flies".into() })?;
    let out = std::env::temp_dir()
        .join(format!("whirlstand-bench-{}-{transport}-{mode}-{rate}", std::process::id()));
    let mut call = Command::new(program);
    call.args(arguments).args([LAUNCH, "--json", "--mode", mode, "--transport", transport]);
    call.args(["--set", &format!("rate_hz={rate}"), "--out"]).arg(&out);
    let answer = call.stdin(Stdio::null()).stderr(Stdio::piped()).output();
    // The log is only a means here.
    let _ = std::fs::remove_dir_all(&out);
    let answer =
        answer.map_err(|source| BenchError::Process { what: format!("cannot start {}", who()), source })?;
    let run = serde_json::from_slice(&answer.stdout).ok().and_then(|mut told: Value| {
        told.pointer_mut("/runs/0").map(Value::take).filter(|run| run["ended"]["how"] == "complete")
    });
    run.ok_or_else(|| BenchError::Member {
        who: who(),
        why: String::from_utf8_lossy(&answer.stderr).trim().to_string(),
    })
}
