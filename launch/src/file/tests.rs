//! The built-in launch files, the examples of the manual, and what overrides and variants make of a file.

use std::time::Duration;

use whirlstand_bridge::arming::Mode;
use whirlstand_bridge::channels::Mapping;
use whirlstand_bridge::turning::inputs_of;
use whirlstand_bus::Transport;
use whirlstand_nodes::config::{LawKind, Mode as LoopMode, Role};

use super::builtin::{BUILTIN, DEFAULT, FoundFile};
use super::document::{Document, LaunchError};
use super::jobs::{Jobs, jobs, jobs_of};
use super::security::Security;
use crate::cli::{ModeArg, OverrideArgs, TransportArg};

fn read(text: &str, overrides: &OverrideArgs) -> Result<Jobs, LaunchError> {
    let document = Document::parse("a.toml", text)?;
    jobs_of(&FoundFile { document, name: "a".into(), folder: ".".into() }, overrides, false)
}

fn plain(text: &str) -> Result<Jobs, LaunchError> {
    read(text, &OverrideArgs::default())
}

const SMALL: &str = "vehicle = 'quadrotor'\ncontroller.law = 'smc'\n";

#[test]
fn every_built_in_file_reads_and_is_disturbed_at_6_s() {
    for (name, _) in BUILTIN {
        let jobs = jobs(name, &OverrideArgs::default(), false).unwrap_or_else(|e| panic!("{e}"));
        assert!(!jobs.description.is_empty(), "{name}");
        for job in &jobs.runs {
            let onset = job.plan.config.effects.iter().filter_map(|e| e.parameter("at_s"));
            let is_real = job.plan.config.bridge.as_ref().is_some_and(|b| b.kind.is_vehicle());
            assert!(is_real || onset.into_iter().any(|t| t == 6.0), "{name}");
            assert_eq!(job.plan.config.mode, LoopMode::Realtime);
            assert!(!job.plan.expect.is_empty() || job.variant.as_deref() == Some("manual"), "{name}");
        }
    }
    let default = jobs(DEFAULT, &OverrideArgs::default(), false).unwrap();
    assert_eq!(default.runs[0].plan.config.controller.law, LawKind::Smc);
}

#[test]
fn one_line_swaps_hardware_and_simulation() {
    let mut bridged = 0;
    for (name, text) in BUILTIN {
        let Some(config) = plain(text).unwrap().runs.swap_remove(0).plan.config.bridge else { continue };
        bridged += 1;
        let (lines, taken): (Vec<_>, Vec<_>) = text.lines().partition(|line| !line.starts_with("bridge = "));
        assert_eq!(taken.len(), 1, "{name}");
        let ours = plain(&lines.join("\n")).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(ours.runs[0].plan.config.bridge, None, "{name}");
        let nodes: Vec<_> = ours.runs[0].plan.nodes.iter().filter_map(|n| n.role).collect();
        assert_eq!(nodes.len(), 4, "{name}: {nodes:?}");
        assert!(taken[0].contains(config.kind.name()), "{name}");
    }
    assert_eq!(bridged, 4, "Betaflight has its example, with a vehicle of its own");
}

/// A vehicle that rolls right on stick right, pitches up on stick back and turns right on stick right must be accelerated by each
/// channel as its file says that the input accelerates it: the other sign is positive feedback.
#[test]
fn every_channel_of_a_built_in_bridge_turns_the_vehicle_as_its_input_does() {
    let mut judged = 0;
    for (name, text) in BUILTIN {
        let Some(bridge) = plain(text).unwrap().runs.swap_remove(0).plan.config.bridge else { continue };
        if !bridge.kind.is_vehicle() {
            continue;
        }
        let vehicle = whirlstand_vehicle::Vehicle::builtin("quadrotor").unwrap();
        let inputs = inputs_of(&vehicle);
        for (i, axis) in ["roll", "pitch"].into_iter().enumerate() {
            let mut u = [0.0; 2];
            u[i] = 1.0;
            let channels = &bridge.options.channels;
            let mut mapping = Mapping::new(channels, &inputs, bridge.options.pilot.is_some()).unwrap();
            // A channel with a rate takes its time.
            mapping.apply(Mode::Automatic, &u, None, Duration::from_secs(1));
            let us = *mapping.apply(Mode::Automatic, &u, None, Duration::from_secs(2));
            let sticks = [us[0] - 1500.0, us[1] - 1500.0];
            let rate = vehicle.state_index(&format!("{axis}_rate")).unwrap();
            let ours = vehicle.b[(rate, i)];
            assert!(
                sticks[i] * ours > 0.0 && sticks[1 - i] == 0.0,
                "{name}, {axis}: {sticks:?} us for {ours}"
            );
            judged += 1;
        }
    }
    assert_eq!(judged, 4);
}

#[test]
fn the_examples_of_the_manual_are_valid() {
    let manual = include_str!("../../../docs/launch-file.md");
    let blocks: Vec<&str> = manual.split("```toml\n").skip(1).filter_map(|b| b.split("```").next()).collect();
    assert!(blocks.len() >= 6);
    for block in blocks {
        plain(block).unwrap_or_else(|e| panic!("{e}\n{block}"));
    }
}

#[test]
fn quantities_arrive_in_si() {
    let text = format!(
        "{SMALL}plant.initial = {{ roll = '5 deg' }}\n[[setpoint]]\nat_s = '500 ms'\npitch = '-3 deg'\n"
    );
    let jobs = plain(&text).unwrap();
    let config = &jobs.runs[0].plan.config;
    assert_eq!(config.plant.initial["roll"], 5f64.to_radians());
    assert_eq!((config.setpoint[0].at_s, config.setpoint[0].values["pitch"]), (0.5, -3f64.to_radians()));
    assert_eq!((config.period_ns, config.steps), (5_000_000, 2400));
}

#[test]
fn a_number_without_a_unit_is_refused_where_it_could_be_meant_in_two() {
    for (text, line, words) in [
        (
            "[[setpoint]]\nat_s = 1\nroll = 5\n",
            "line 5",
            "roll is 5 without a unit: 5 rad = 286 deg, or 5 deg",
        ),
        ("[plant]\ninitial = { roll_rate = 0.1 }\n", "line 4", "0.1 rad/s = 5.73 deg/s, or 0.1 deg/s"),
        (
            "[[effects]]\neffect = 'pulse_disturbance'\nwhere = 'roll_rate'\nat_s = 1\nduration_s = 0.2\nmagnitude = 60\n",
            "line 8",
            "magnitude is 60 without a unit: 60 rad/s^2 = 3438 deg/s^2, or 60 deg/s^2",
        ),
    ] {
        let error = plain(&format!("{SMALL}{text}")).unwrap_err();
        assert!(error.place.ends_with(line) && error.message.contains(words), "{text}: {error}");
        assert!(error.message.contains("write the unit"), "{error}");
    }
    let set = |assignment: &str| {
        let overrides = OverrideArgs { set: vec![assignment.into()], ..OverrideArgs::default() };
        read(SMALL, &overrides).map(|jobs| jobs.runs[0].plan.config.plant.initial["roll"])
    };
    let error = set("plant.initial.roll=10").unwrap_err().to_string();
    let words = "--set plant.initial.roll=10: roll is 10 without a unit: 10 rad = 573 deg, or 10 deg";
    assert!(error.starts_with(words), "{error}");
    assert_eq!(set("plant.initial.roll=0").unwrap(), 0.0);
    assert_eq!(set("plant.initial.roll=0.1 rad").unwrap(), 0.1);
    // Declared in SI, or without a unit: there is one reading.
    let hover = "vehicle = 'helicopter-hover'\ncontroller.law = 'lqr'\n[[setpoint]]\nat_s = 1\nlateral_speed = 0.5\n\
                 [[stick]]\nat_s = 1\nu_roll = 0.1\n";
    assert_eq!(plain(hover).unwrap().runs[0].plan.config.setpoint[0].values["lateral_speed"], 0.5);
}

#[test]
fn implausible_values_are_refused_and_read_back_in_two_units() {
    for (text, line, words) in [
        (
            "plant.initial.roll = '120 deg'\n",
            "line 3",
            "roll is 120 deg = 2.09 rad: a linear model is not valid for attitudes beyond 90 deg",
        ),
        ("[[setpoint]]\nat_s = 1\npitch = '-10 rad'\n", "line 5", "pitch is -573 deg = -10.0 rad"),
        (
            "[[effects]]\neffect = 'input_delay'\nwhere = 'u_roll'\ndelay_s = 60\n",
            "line 6",
            "delay_s is 60 s = 60000 ms, but the run lasts 12 s",
        ),
    ] {
        let error = plain(&format!("{SMALL}{text}")).unwrap_err();
        assert!(error.place.ends_with(line) && error.message.contains(words), "{text}: {error}");
    }
    assert!(plain(&format!("{SMALL}plant.initial.roll = '90 deg'\n")).is_ok());
}

#[test]
fn the_command_line_is_stronger_than_a_variant_and_a_variant_than_the_file() {
    let text = format!(
        "{SMALL}seed = 1\n[[variants]]\nname = 'one'\nset = {{ 'controller.law' = 'lqr', seed = 2 }}\n\
         [[variants]]\nname = 'two'\n[variants.set.controller]\nlaw = 'ppc'\n"
    );
    let overrides = OverrideArgs {
        mode: Some(ModeArg::Lockstep),
        transport: Some(TransportArg::Zenoh),
        answer_timeout: None,
        duration: Some(3.0),
        seed: Some(9),
        set: vec!["plant.engine=off".into()],
    };
    let runs = read(&text, &overrides).unwrap().runs;
    let found: Vec<_> = runs
        .iter()
        .map(|r| {
            (
                r.variant.as_deref().unwrap(),
                r.plan.config.controller.law,
                r.plan.config.seed,
                r.plan.config.steps,
            )
        })
        .collect();
    assert_eq!(found, [("one", LawKind::Lqr, 9, 600), ("two", LawKind::Ppc, 9, 600)]);
    let config = &runs[0].plan.config;
    assert_eq!((config.mode, config.transport), (LoopMode::Lockstep, Transport::Zenoh));
    let kept = &config.recorder.as_ref().unwrap().launch_text;
    assert!(kept.contains("# overridden: --seed 9") && kept.contains("--set plant.engine=off"), "{kept}");
    let file_alone = plain(&text).unwrap().runs;
    assert_eq!(file_alone.iter().map(|r| r.plan.config.seed).collect::<Vec<_>>(), [2, 1]);
}

#[test]
fn mistakes_in_variants_are_told_with_line_and_variant() {
    let text = format!("{SMALL}[[variants]]\nname = 'one'\nset = {{ 'controller.lwa' = 'lqr' }}\n");
    let error = plain(&text).unwrap_err().to_string();
    assert!(error.contains("line 5") && error.contains("variant one") && error.contains("'law'"), "{error}");
    let twice = format!("{SMALL}[[variants]]\nname = 'one'\n[[variants]]\nname = 'one'\n");
    assert!(plain(&twice).unwrap_err().to_string().contains("line 6"), "{:?}", plain(&twice));
    let folder = format!("{SMALL}[[variants]]\nname = '../x'\n");
    assert!(plain(&folder).unwrap_err().to_string().contains("names a folder"));
}

#[test]
fn nodes_are_replaced_added_and_refused() {
    let text =
        format!("{SMALL}[nodes.controller]\nexec = ['python3', 'c.py']\n[nodes.viewer]\nexec = ['v']\n");
    let plan = plain(&text).unwrap().runs.remove(0).plan;
    let names: Vec<_> = plan.nodes.iter().map(|n| n.name.as_str()).collect();
    assert_eq!(
        names,
        ["recorder", "estimator", "plant", "controller", "viewer"],
        "foreign programs come last"
    );
    assert_eq!(plan.config.peers, [Role::Estimator, Role::Recorder]);
    for (section, word) in [
        ("[nodes.controler]\npriority = 1\n", "'controller'"),
        ("[nodes.viewer]\nready = 'start'\n", "exec"),
        ("[nodes.plant]\npriority = 100\n", "from 1 to 99, is expected, not 100"),
        ("[nodes.plant]\npriority = -1\n", "from 1 to 99, is expected, not -1"),
        ("[nodes.plant]\npriority = 300\n", "from 1 to 99, is expected, not 300"),
        ("[nodes.plant]\nexternal = true\n", "started here"),
        ("[nodes.controller]\nexec = ['x']\nlock_memory = true\n", "mlockall"),
        ("[nodes.controller]\nexec = []\n", "program"),
        ("[nodes.controller]\nlisten = ['tcp/127.0.0.1:1']\n", "zenoh"),
        ("[zenoh]\nlisten = ['tcp/127.0.0.1:7447']\n", ":0"),
        ("[nodes.'a b']\nexec = ['x']\n", "cannot be used"),
    ] {
        let error = plain(&format!("{SMALL}{section}")).unwrap_err();
        assert!(error.place.contains("line") && error.message.contains(word), "{section}: {error}");
    }
}

#[test]
fn no_log_leaves_the_recorder_out() {
    let jobs = jobs(DEFAULT, &OverrideArgs::default(), true).unwrap();
    let plan = &jobs.runs[0].plan;
    assert!(plan.config.recorder.is_none() && !plan.config.telemetry);
    assert!(plan.nodes.iter().all(|n| n.role != Some(Role::Recorder)));
}

#[test]
fn a_bench_over_zenoh_is_protected_unless_it_asks_not_to_be() {
    let security = |text: &str| {
        let text = format!("{SMALL}transport = 'zenoh'\n{text}");
        plain(&text).map(|mut jobs| jobs.runs.remove(0).plan.security)
    };
    assert_eq!(security("").unwrap(), Security::Secret);
    assert_eq!(security("[zenoh]\nlisten = ['tcp/127.0.0.1:0']\n").unwrap(), Security::Secret);
    assert_eq!(security("[security]\nmode = 'open'\n").unwrap(), Security::Open);
    let remote = "[zenoh]\nlisten = ['tcp/192.0.2.1:0']\n";
    assert_eq!(security(&format!("{remote}[security]\nmode = 'open'\n")).unwrap(), Security::Open);
    let keys = format!("{remote}[security]\nmode = 'tls'\nkeys = 'lab'\n");
    assert!(matches!(security(&keys).unwrap(), Security::Tls(_)));
    for (text, word) in [
        (remote, "tcp/192.0.2.1:0"),
        ("[nodes.plant]\nconnect = ['udp/127.0.0.1:7447']\n", "udp/127.0.0.1:7447"),
        ("[security]\nmode = 'tls'\n", "keys new"),
        ("[security]\nkeys = 'lab'\n", "mode"),
        ("[security]\nmode = 'closed'\n", "line"),
        ("[zenoh]\nconfig = 'no-such.json5'\n", "no-such.json5"),
    ] {
        let error = security(text).unwrap_err().to_string();
        assert!(error.contains(word), "{text}: {error}");
    }
    let shared_memory = plain(SMALL).unwrap().runs.remove(0).plan.security;
    assert_eq!(shared_memory, Security::Open, "its files are the user's own");
}

/// Found by the search of `fuzz.rs`: an infinite rate reached the bridge as none.
#[test]
fn a_number_that_is_infinite_or_none_is_refused_with_its_place() {
    for line in [
        "plant.initial = { roll = inf }",
        "bridge.channels = [{ channel = 1, rate_us_per_s = -inf }]",
        "seed = nan",
        "rate_hz = 1e999",
    ] {
        let error = plain(&format!("{SMALL}{line}\n")).unwrap_err().to_string();
        assert_eq!(error, "a.toml, line 3: a finite number is expected", "{line}");
    }
}
