//! Cost of a transport: the same flight over each transport in real time, compared by the figures of the run.

use std::process::{Child, Command, Stdio};

use serde_json::Value;

use super::two_hosts::TwoHosts;
use super::{BenchError, Figure, Options};

/// Launch file of the flight: steps of roll and pitch, then a gust.
const LAUNCH: &str = "quadrotor-lqr";

/// Rates of the loop, Hz.
const RATES: [u32; 3] = [200, 1000, 4000];

/// Each transport, and its name.
const TRANSPORTS: [(&str, &str); 3] =
    [("inproc", "in one process"), ("iceoryx2", "iceoryx2"), ("zenoh", "Zenoh, TCP on loopback")];

/// Outputs whose figures are reported.
const OUTPUTS: [&str; 2] = ["roll", "pitch"];

/// Flies over every transport at every rate, and in lockstep, in which no command is late; and, where two
/// network namespaces can be created, with the controller on another host.
pub(super) fn transports(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let mut figures = Vec::new();
    let hosts = TwoHosts::new();
    if let Err(why) = &hosts {
        tracing::warn!("no flight over two hosts: {why}");
    }
    for rate in RATES {
        let alone = |transport, mode| Run { options, transport, mode, rate, hosts: None };
        let runs = [alone("inproc", "lockstep").flown()?];
        figures.extend(told(&format!("lockstep, {rate} Hz"), &runs)?);
        let mut all: Vec<(Run<'_>, &str)> =
            TRANSPORTS.iter().map(|(transport, name)| (alone(*transport, "realtime"), *name)).collect();
        if let Ok(hosts) = &hosts {
            all.push((
                Run { hosts: Some(hosts), ..alone("zenoh", "realtime") },
                "Zenoh, TCP between two hosts",
            ));
        }
        for (run, name) in all {
            let runs = (0..options.repeat).map(|_| run.flown()).collect::<Result<Vec<_>, _>>()?;
            figures.extend(told(&format!("realtime {name}, {rate} Hz"), &runs)?);
        }
    }
    Ok(figures)
}

/// Figures of runs that differ only in the clock.
fn told(name: &str, runs: &[Value]) -> Result<Vec<Figure>, BenchError> {
    let of = |path: &str| -> Result<Vec<f64>, BenchError> {
        let values = runs.iter().map(|run| run.pointer(path)?.as_f64()).collect::<Option<Vec<f64>>>();
        values.ok_or_else(|| BenchError::Member { who: name.into(), why: format!("its run has no {path}") })
    };
    let missed = format!("{name}: missed deadlines in {} steps", of("/timing/nodes/plant/steps")?[0]);
    let mut figures = vec![Figure::lowest(missed, "", of("/timing/deadline_misses")?, None)];
    // In lockstep commands have no deadline.
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
            // A run whose log has gaps, as a network may cause, lacks some figures.
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

/// One run.
struct Run<'a> {
    options: &'a Options,
    transport: &'a str,
    mode: &'a str,
    rate: u32,
    /// Hosts for the controller (second) and everything else (first), if two are used.
    hosts: Option<&'a TwoHosts>,
}

/// A process that is killed when this is dropped.
struct Other(Child);

impl Drop for Other {
    fn drop(&mut self) {
        // It may have ended by itself already; it is gone afterwards in any case.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Run<'_> {
    fn name(&self) -> String {
        format!("the run of {LAUNCH} over {} at {} Hz", self.transport, self.rate)
    }

    fn failed(&self, why: impl Into<String>) -> BenchError {
        BenchError::Member { who: self.name(), why: why.into() }
    }

    /// Result of the run, as JSON.
    fn flown(&self) -> Result<Value, BenchError> {
        let Self { options, transport, mode, rate, hosts } = self;
        let (program, arguments) =
            options.run.split_first().ok_or_else(|| self.failed("no program was given that flies"))?;
        let cannot = |source| BenchError::Process { what: format!("cannot start {}", self.name()), source };
        let bench = format!("bench-{}-{transport}-{mode}-{rate}", std::process::id());
        let out = std::env::temp_dir().join(format!("whirlstand-{bench}"));
        let mut same = vec!["--mode".to_string(), (*mode).into(), "--transport".into(), (*transport).into()];
        same.extend(["--set".into(), format!("rate_hz={rate}")]);
        let (mut call, mut controller) = (Command::new(program), None);
        if let Some(hosts) = hosts {
            same.extend(["--bench".into(), bench, "--set".into(), "security.mode=open".into()]);
            let mut there = hosts.on(1, program);
            there.args(["node", "controller", "--launch", LAUNCH, "--listen", &TwoHosts::endpoint(1)]);
            there.args(&same).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
            controller = Some(Other(there.spawn().map_err(cannot)?));
            call = hosts.on(0, program);
        }
        call.args(arguments).args([LAUNCH, "--json"]).args(&same).arg("--out").arg(&out);
        if hosts.is_some() {
            call.args(["--set", "nodes.controller.external=true"]);
            for node in ["plant", "estimator", "recorder"] {
                call.args(["--set", &format!("nodes.{node}.connect=[\"{}\"]", TwoHosts::endpoint(1))]);
            }
        }
        let answer = call.stdin(Stdio::null()).stderr(Stdio::piped()).output();
        drop(controller);
        // The log is not needed any more.
        let _ = std::fs::remove_dir_all(&out);
        let answer = answer.map_err(cannot)?;
        let run = serde_json::from_slice(&answer.stdout).ok().and_then(|mut told: Value| {
            told.pointer_mut("/runs/0").map(Value::take).filter(|run| run["ended"]["how"] == "complete")
        });
        run.ok_or_else(|| self.failed(String::from_utf8_lossy(&answer.stderr).trim()))
    }
}
