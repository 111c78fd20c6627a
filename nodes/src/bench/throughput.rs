//! Throughput in steps per second: in one process, over shared memory, with the recorder, over the network.

use std::hint::black_box;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use whirlstand_bus::ring::POSITIONS;
use whirlstand_bus::{BusConfig, Transport, WaitStrategy, remove_residue};
use whirlstand_vehicle::{Simulator, Vehicle};

use super::fleet::Fleet;
use super::measured_bench::config;
use super::member::MemberReport;
use super::{BenchError, Figure, Member, Options};
use crate::config::{Mode, NodeConfig, RealtimeOptions, RecorderConfig, Role};
use crate::flight::{LANES, Pilot};
use crate::os::{StopFlag, thread_time};

/// Steps between two readings of the clock.
const BATCH: u32 = 100_000;

/// Laps of a ring per second of measurement, over shared memory and over the network.
const LAPS_PER_SECOND: f64 = 100_000.0;
const ZENOH_LAPS_PER_SECOND: f64 = 5_000.0;

/// Measures the plant alone, with eight states.
pub(super) fn plant(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let broken = |e: &dyn std::fmt::Display| BenchError::Member {
        who: "the built-in helicopter-hover".into(),
        why: e.to_string(),
    };
    let vehicle = Vehicle::builtin("helicopter-hover").map_err(|e| broken(&e))?;
    let mut rates = Vec::new();
    for _ in 0..options.repeat {
        let mut simulator = Simulator::new(&vehicle, 0.005, 1).map_err(|e| broken(&e))?;
        let mut u = vec![0.0; vehicle.inputs.len()];
        let (start, mut steps) = (Instant::now(), 0u64);
        while start.elapsed().as_secs_f64() < options.seconds {
            for i in 0..BATCH {
                u[0] = f64::from(i & 1) * 1e-3;
                simulator.step(black_box(&u));
            }
            steps += u64::from(BATCH);
        }
        rates.push(steps as f64 / start.elapsed().as_secs_f64());
        black_box(simulator.state());
    }
    let name = format!("plant alone, {} states", vehicle.states.len());
    Ok(vec![Figure::highest(name, "steps/s", rates, Some(20e6))])
}

/// Measures the closed loop in one thread.
pub(super) fn inproc(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let mut rates = Vec::new();
    for _ in 0..options.repeat {
        let steps = (options.seconds * 1.5e6) as u64 + 1000;
        let config = config("inproc", Transport::Inproc, Mode::Lockstep, steps)?;
        let ended = crate::run_inproc(&config, &StopFlag::default())?;
        rates.push(ended.steps as f64 / ended.wall.as_secs_f64());
    }
    Ok(vec![Figure::highest("closed loop in one process", "steps/s", rates, Some(2e6))])
}

/// Measures the closed loop without a bus, as in a campaign: every step is observed.
pub(super) fn flight(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let config = config("flight", Transport::Inproc, Mode::Lockstep, u64::from(BATCH))?;
    let pilot = Pilot::new(&config)?;
    let (mut rates, mut own) = (Vec::new(), Vec::new());
    for _ in 0..options.repeat {
        let (start, began, mut steps) = (Instant::now(), thread_time(), 0u64);
        while start.elapsed().as_secs_f64() < options.seconds {
            steps += pilot
                .fly(&config, |step| {
                    black_box(step.x);
                })?
                .steps;
        }
        rates.push(steps as f64 / start.elapsed().as_secs_f64());
        own.push(steps as f64 / (thread_time() - began).as_secs_f64());
    }
    Ok(vec![
        Figure::highest("one flight without a bus, sensors and noise", "steps/s", rates, Some(3e6)),
        Figure::highest("  in the processor's time for it", "steps/s", own, None),
        together(options, &config, &pilot)?,
    ])
}

/// Measures many flights together, as in a campaign; processor time of other processes does not count.
fn together(options: &Options, config: &NodeConfig, pilot: &Pilot) -> Result<Figure, BenchError> {
    let seeded: Vec<_> = (0..LANES as u64).map(|seed| NodeConfig { seed, ..config.clone() }).collect();
    let configs: [&NodeConfig; LANES] = std::array::from_fn(|l| &seeded[l]);
    let mut rates = Vec::new();
    for _ in 0..options.repeat {
        let (start, began, mut steps) = (Instant::now(), thread_time(), 0u64);
        while start.elapsed().as_secs_f64() < options.seconds {
            let flown = pilot.fly_together(&configs, &mut |step| {
                black_box(step.x);
            });
            // A flight that has to be repeated alone was not flown here, and does not count.
            steps += flown.iter().flatten().map(|counts| counts.steps).sum::<u64>();
        }
        rates.push(steps as f64 / (thread_time() - began).as_secs_f64());
    }
    let name = format!("  {LANES} flights side by side, in the processor's time");
    Ok(Figure::highest(name, "steps/s", rates, Some(15e6)))
}

/// Measures three processes over shared memory, compared with the bare ring.
pub(super) fn lockstep(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let (mut steps, mut laps, mut bus_laps) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..options.repeat {
        let mut config = config("lockstep", Transport::Iceoryx2, Mode::Lockstep, u64::MAX)?;
        place(options, &mut config);
        laps.push(ring(options, Transport::Iceoryx2, true)? * 1e6);
        let (plant, _) = fly(options, &config, &[])?;
        steps.push(plant.seconds * 1e6 / plant.count as f64);
        bus_laps.push(ring(options, Transport::Iceoryx2, false)? * 1e6);
    }
    let rates = steps.iter().map(|s| 1e6 / s).collect();
    // Each measurement is compared with the ring just before it, because a machine's speed changes within
    // minutes.
    let ratios = steps.iter().zip(&laps).map(|(step, lap)| step / lap).collect();
    Ok(vec![
        Figure::highest("lockstep over iceoryx2, three processes", "steps/s", rates, Some(100e3)),
        Figure::lowest("  its step", "us", steps, None),
        Figure::lowest("  bare iceoryx2 ring, three processes: a lap", "us", laps, None),
        Figure::lowest("  the same ring over the bus: a lap", "us", bus_laps, None),
        Figure::lowest("  step / bare lap", "", ratios, Some(1.25)),
    ])
}

/// Measures with the recorder writing every message.
pub(super) fn recorded(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let (mut rates, mut lost) = (Vec::new(), 0);
    for _ in 0..options.repeat {
        let folder = std::env::temp_dir().join(format!("whirlstand-bench-{}", std::process::id()));
        let made = std::fs::create_dir_all(&folder);
        made.map_err(|source| BenchError::Process { what: format!("{}", folder.display()), source })?;
        let mut config = config("recorded", Transport::Iceoryx2, Mode::Lockstep, u64::MAX)?;
        config.telemetry = true;
        config.recorder = Some(RecorderConfig {
            path: folder.join("log.mcap").to_string_lossy().into_owned(),
            most_runs: 1,
            version: env!("CARGO_PKG_VERSION").into(),
            ..RecorderConfig::default()
        });
        let flown = fly(options, &config, &[]);
        // The log is not needed any more; a failed removal only leaves it behind.
        let _ = std::fs::remove_dir_all(&folder);
        let (plant, recorder) = flown?;
        rates.push(plant.count as f64 / plant.seconds);
        // Truth, Imu, Estimate, Command and Setpoint of every step; missing ones count as lost as well.
        lost += recorder.lost.max((5 * plant.count).saturating_sub(recorder.count));
    }
    Ok(vec![
        Figure::highest("lockstep with every message recorded", "steps/s", rates, Some(100e3)),
        Figure::lowest("  messages lost", "", vec![lost as f64], Some(0.0)),
    ])
}

/// Measures three processes over Zenoh, TCP on loopback.
pub(super) fn zenoh(options: &Options) -> Result<Vec<Figure>, BenchError> {
    let (mut steps, mut laps) = (Vec::new(), Vec::new());
    for _ in 0..options.repeat {
        let config = config("zenoh", Transport::Zenoh, Mode::Lockstep, u64::MAX)?;
        let (plant, _) = fly(options, &config, &free_endpoints()?)?;
        steps.push(plant.seconds * 1e6 / plant.count as f64);
        laps.push(ring(options, Transport::Zenoh, false)? * 1e6);
    }
    Ok(vec![
        Figure::lowest("lockstep over Zenoh (TCP), three processes: step", "us", steps, None),
        Figure::lowest("  ring over Zenoh (TCP), three processes", "us", laps, None),
    ])
}

/// Mean time of a lap, s, while no process sleeps.
pub(super) fn ring(options: &Options, transport: Transport, bare: bool) -> Result<f64, BenchError> {
    let bench = config("ring", transport, Mode::Lockstep, 1)?.bench;
    let zenoh = transport == Transport::Zenoh;
    let endpoints = if zenoh { free_endpoints()? } else { Vec::new() };
    let per_second = if zenoh { ZENOH_LAPS_PER_SECOND } else { LAPS_PER_SECOND };
    let laps = (options.seconds * per_second) as u64 + 100;
    // Position 0 starts last: it sends until the others are running.
    let members = (0..POSITIONS).rev().map(|position| {
        let mut bus = BusConfig::new(&bench, format!("ring-{position}"), transport);
        bus.wait = WaitStrategy::lockstep();
        if zenoh {
            bus.zenoh.listen = vec![endpoints[position].clone()];
            bus.zenoh.connect = endpoints[..position].to_vec();
        }
        let cpus = options.cpus.get(position).copied().into_iter().collect();
        (name(position), Member::Ring { position, bus: Box::new(bus), bare, laps, cpus })
    });
    let mut fleet = Fleet::start(options, members)?;
    let lead = fleet.finish(&name(0))?;
    for position in 1..POSITIONS {
        fleet.finish(&name(position))?;
    }
    sweep(&bench);
    Ok(lead.seconds / lead.count as f64)
}

fn name(position: usize) -> String {
    format!("ring position {position}")
}

/// Runs a bench for the requested time; returns the reports of plant and recorder.
fn fly(
    options: &Options,
    config: &NodeConfig,
    endpoints: &[String],
) -> Result<(MemberReport, MemberReport), BenchError> {
    let mut roles = vec![Role::Estimator, Role::Controller, Role::Plant];
    if config.recorder.is_some() {
        roles.insert(0, Role::Recorder);
    }
    let members = roles.iter().enumerate().map(|(i, &role)| {
        let mut config = config.clone();
        if let Some(own) = endpoints.get(i) {
            config.zenoh.listen = vec![own.clone()];
            config.zenoh.connect = endpoints[..i].to_vec();
        }
        (role.to_string(), Member::Node { role, config: Box::new(config) })
    });
    let mut fleet = Fleet::start(options, members)?;
    fleet.watch(Duration::from_secs_f64(options.seconds))?;
    fleet.stop(Role::Plant.name());
    let plant = fleet.finish(Role::Plant.name())?;
    for role in [Role::Controller, Role::Estimator] {
        fleet.stop(role.name());
        fleet.finish(role.name())?;
    }
    let recorder = if config.recorder.is_some() {
        fleet.stop(Role::Recorder.name());
        fleet.finish(Role::Recorder.name())?
    } else {
        MemberReport::default()
    };
    sweep(&config.bench);
    Ok((plant, recorder))
}

/// Assigns the nodes of the loop to the CPUs of the ring's positions.
fn place(options: &Options, config: &mut NodeConfig) {
    let loop_order = [Role::Plant, Role::Estimator, Role::Controller];
    config.realtime = loop_order
        .into_iter()
        .zip(&options.cpus)
        .map(|(role, &cpu)| (role, RealtimeOptions { cpus: vec![cpu], ..RealtimeOptions::default() }))
        .collect();
}

/// One free loopback endpoint per position.
fn free_endpoints() -> Result<Vec<String>, BenchError> {
    let free = || Ok(format!("tcp/{}", TcpListener::bind("127.0.0.1:0")?.local_addr()?));
    (0..POSITIONS)
        .map(|_| free())
        .collect::<std::io::Result<_>>()
        .map_err(|source| BenchError::Process { what: "cannot find a free port".into(), source })
}

/// Members that ended normally leave no files; a killed one might.
fn sweep(bench: &str) {
    if let Err(e) = remove_residue(bench) {
        tracing::warn!("{e}");
    }
}
