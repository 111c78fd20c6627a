//! Measures the loop at 1 kHz twice: with witnesses that detect standstills of the machine, for its misses, and with
//! the kernel's own timing beside it, for its latency. The witnesses wake ten times in a period at the loop's priority,
//! which takes their turns out of the loop's time, and keeps the machine from idling.

use std::time::Duration;

use whirlstand_bus::{Transport, remove_residue};

use super::cyclictest::Cyclictest;
use super::fleet::Fleet;
use super::measured_bench::config;
use super::member::MemberReport;
use super::throughput::ring;
use super::witness::{self, Standstill, Witnesses, stood_still};
use super::{BenchError, Figure, Member, Options};
use crate::config::{Mode, NodeConfig, RealtimeOptions, Role};
use crate::os::available_cpus;

/// Steps per second.
const RATE: f64 = 1000.0;

/// Time beyond the measurement within which the plant must have ended.
const START: Duration = Duration::from_secs(10);

/// Measures the loop in real time, twice for the time asked for; in the second flight `cyclictest` runs concurrently at
/// the same priority where it is installed.
pub(super) fn realtime(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let steps = (options.realtime_seconds * RATE) as u64 + 1;
    let mut config = config("realtime", Transport::Iceoryx2, Mode::Realtime, steps)?;
    if let Some(priority) = options.priority {
        // The nodes of a step take turns. On one CPU a turn passes by switching threads, on several by waking a CPU
        // that has nothing else to do, which takes longer.
        let shared = available_cpus().last().copied();
        let roles = [Role::Plant, Role::Estimator, Role::Controller].into_iter().enumerate();
        let asked = |(place, role)| {
            let cpus = options.cpus.get(place).copied().or(shared).into_iter().collect();
            (role, RealtimeOptions { priority: Some(priority), cpus, lock_memory: true })
        };
        config.realtime = roles.map(asked).collect();
    }
    let lap_us = ring(options, Transport::Iceoryx2, true)? * 1e6;
    let witnesses = Witnesses::start(options.priority);
    let watched = flown(options, &config)?;
    let standstills = witnesses.finish()?;
    let cyclictest = Cyclictest::start(options.realtime_seconds, options.priority)?;
    let plant = flown(options, &config)?;
    let class = options.priority.map_or("ordinary priority".into(), |p| format!("SCHED_FIFO {p}"));
    let us = |ns: u64| vec![ns as f64 * 1e-3];
    let [p50, p99, p999, max] = plant.latency_ns;
    let name = format!("realtime at 1 kHz, {class}: missed deadlines in {} steps", watched.count);
    let mut figures = vec![Figure::lowest(name, "", vec![watched.misses as f64], None)];
    figures.extend(witnessed(options, &watched, &standstills));
    figures.extend([
        Figure::lowest("  without witnesses: missed deadlines", "", vec![plant.misses as f64], None),
        Figure::lowest("  command latency, p50", "us", us(p50), None),
        Figure::lowest("  command latency, p99", "us", us(p99), None),
        Figure::lowest("  command latency, p99.9", "us", us(p999), None),
        Figure::lowest("  command latency, max", "us", us(max), None),
    ]);
    if let Some(wakes) = cyclictest.map(Cyclictest::finish).transpose()? {
        let beyond = wakes.beyond(Duration::from_secs_f64(1.0 / RATE));
        figures.extend([
            Figure::lowest(
                "  cyclictest beside it: wakes later than a period",
                "",
                vec![beyond as f64],
                None,
            ),
            Figure::lowest("  cyclictest, p50", "us", vec![wakes.quantile(0.5)], None),
            Figure::lowest("  cyclictest, p99", "us", vec![wakes.quantile(0.99)], None),
            Figure::lowest("  cyclictest, p99.9", "us", vec![wakes.quantile(0.999)], None),
            Figure::lowest("  cyclictest, max", "us", vec![wakes.max_us], None),
            Figure::lowest("  bare iceoryx2 ring, three processes: a lap", "us", vec![lap_us], None),
            Figure::lowest(
                "  command latency, p99 / (cyclictest's and a bare lap)",
                "",
                vec![p99 as f64 * 1e-3 / (wakes.quantile(0.99) + lap_us)],
                Some(1.5),
            ),
        ]);
    }
    Ok(figures)
}

/// Flies the bench once; the plant's report.
fn flown(options: &Options, config: &NodeConfig) -> Result<MemberReport, BenchError> {
    let roles = [Role::Estimator, Role::Controller, Role::Plant];
    let members =
        roles.map(|role| (role.to_string(), Member::Node { role, config: Box::new(config.clone()) }));
    let mut fleet = Fleet::start(options, members)?;
    let longest = Duration::from_secs_f64(options.realtime_seconds) + START;
    let plant = fleet.finish_within(Role::Plant.name(), longest)?;
    for role in [Role::Controller, Role::Estimator] {
        fleet.stop(role.name());
        fleet.finish(role.name())?;
    }
    if let Err(e) = remove_residue(&config.bench) {
        tracing::warn!("{e}");
    }
    Ok(plant)
}

/// Number of missed deadlines explained by standstills. Without interference the loop takes its median time,
/// and it meets its deadline as long as standstills take less than the rest of the period.
fn witnessed(options: &Options, plant: &MemberReport, standstills: &[Standstill]) -> [Figure; 2] {
    let period_ns = (1e9 / RATE) as u64;
    let spare_ns = period_ns.saturating_sub(plant.latency_ns[0] + witness::PERIOD_NS);
    let explained = plant.missed_ns.iter();
    let explained =
        explained.filter(|began| stood_still(standstills, (**began, **began + period_ns)) >= spare_ns);
    let left = plant.misses.saturating_sub(explained.count() as u64) as f64;
    let longest = standstills.iter().map(|(due, woke)| woke - due).max().unwrap_or(0) as f64;
    let name = "  of these without a witness that the machine stood still";
    [
        Figure::lowest(name, "", vec![left], options.priority.map(|_| 0.0)),
        Figure::lowest("  witnesses: longest standstill", "us", vec![1e-3 * longest], None),
    ]
}
