//! The mirror beside the loop: it finds what is hidden, is not heard by the loop, and withholds commands where it is asked to.

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, BusConfig, Subscriber};
use whirlstand_msgs::{Command, Estimate, Finding, FindingStage, Imu, Message, Truth, flags, text_of};
use whirlstand_nodes::clock::Turn;
use whirlstand_nodes::config::{LawKind, MirrorConfig, NodeConfig, OnFinding, SignalChange};
use whirlstand_nodes::inproc::Bench;
use whirlstand_vehicle::{Effect, Kind, Window};

use crate::common;

/// What a run said on the topics of the loop, as bytes, and what the mirror found.
struct Said {
    bits: [Vec<u8>; 4],
    findings: Vec<Finding>,
    failsafe: Vec<u64>,
}

fn drain<M: Message>(subscriber: &mut Subscriber<M>, mut hear: impl FnMut(&M)) {
    while let Some(message) = subscriber.try_recv().unwrap() {
        hear(&message);
    }
}

fn run(config: &NodeConfig) -> Said {
    let bus = Bus::open(&BusConfig::new(&config.bench, "tape", config.transport)).unwrap();
    let (mut imus, mut estimates) =
        (bus.subscriber::<Imu>(512).unwrap(), bus.subscriber::<Estimate>(512).unwrap());
    let (mut commands, mut truths) =
        (bus.subscriber::<Command>(512).unwrap(), bus.subscriber::<Truth>(512).unwrap());
    let mut findings = bus.subscriber::<Finding>(512).unwrap();
    let mut said = Said { bits: Default::default(), findings: Vec::new(), failsafe: Vec::new() };
    let mut bench = Bench::open(config).unwrap();
    let limit = Instant::now() + Duration::from_secs(120);
    loop {
        let turn = bench.round().unwrap();
        assert!(Instant::now() < limit, "the bench hangs");
        let [imu, estimate, command, truth] = &mut said.bits;
        drain(&mut imus, |m| imu.extend_from_slice(bytemuck::bytes_of(m)));
        drain(&mut estimates, |m| estimate.extend_from_slice(bytemuck::bytes_of(m)));
        drain(&mut commands, |m| command.extend_from_slice(bytemuck::bytes_of(m)));
        drain(&mut truths, |m| {
            truth.extend_from_slice(bytemuck::bytes_of(m));
            if m.flags & flags::FAILSAFE != 0 {
                said.failsafe.push(m.head.step);
            }
        });
        drain(&mut findings, |m| said.findings.push(*m));
        if turn == Turn::Ended {
            return said;
        }
    }
}

/// A flight with steps of the setpoint and a gust that the launch file declares.
fn flight(name: &str, seconds: u64) -> NodeConfig {
    let mut config = common::config(name, 200 * seconds);
    let change = |k: u64| SignalChange {
        at_s: 1.5 * k as f64,
        values: [("roll", 0.09 * (1.0 - (k % 3) as f64)), ("pitch", 0.09 * ((k % 4) as f64 - 1.5))]
            .map(|(name, value)| (name.to_string(), value))
            .into(),
    };
    config.setpoint = (1..seconds * 2 / 3).map(change).collect();
    let gust = [("at_s", 4.0), ("duration_s", 0.2), ("magnitude", 1.0)];
    config.effects.push(Effect::new(Kind::PulseDisturbance, "roll_rate", &gust).unwrap());
    config.mirror = Some(MirrorConfig::default());
    config
}

/// The same with roll alone moved, every two seconds, in turbulence.
fn restless(name: &str, seconds: u64) -> NodeConfig {
    let mut config = flight(name, seconds);
    let change = |k: u64| SignalChange {
        at_s: 2.0 * k as f64,
        values: [("roll".to_string(), [0.0, 0.087, -0.087][k as usize % 3])].into(),
    };
    config.setpoint = (1..seconds / 2).map(change).collect();
    let turbulence = [("std", 0.07), ("bandwidth_hz", 1.0)];
    config.effects.push(Effect::new(Kind::Turbulence, "roll_rate", &turbulence).unwrap());
    config
}

/// The roll input loses a third of its effect after 8 s.
fn weakened(mut config: NodeConfig) -> NodeConfig {
    let late = Window { from_s: Some(8.0), until_s: None };
    let gain = Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.67)]).unwrap();
    config.effects.push(gain.during(late).unwrap());
    config
}

#[test]
fn a_hidden_loss_of_effectiveness_is_told_and_named_and_the_loop_does_not_notice() {
    let config = weakened(flight("mirror-gain", 20));
    let with = run(&config);
    let first = with.findings.first().expect("a finding");
    let period = config.period_ns;
    assert_eq!(first.stage, FindingStage::Wrong as u32);
    let (told, since) = (first.head.stamp_ns as f64 * 1e-9, first.since_ns as f64 * 1e-9);
    assert!((8.0..9.5).contains(&told) && (7.9..9.4).contains(&since), "told at {told} s, since {since} s");
    let last = with.findings.iter().rev().find(|f| f.count > 0).expect("a name");
    assert_eq!(
        (text_of(&last.effect), text_of(&last.place)),
        ("input_gain", "u_roll"),
        "{:?}",
        with.findings
    );
    assert!((last.value[0] - 0.67).abs() < 0.03 && last.low[0] < 0.69 && last.high[0] > 0.65, "{last:?}");
    assert_eq!(last.head.stamp_ns, last.head.step * period);
    let without = run(&NodeConfig { mirror: None, bench: common::unique("no-mirror"), ..config });
    assert!(with.bits == without.bits, "the loop is another with a mirror beside it");
    assert!(without.findings.is_empty());
}

#[test]
fn transients_and_what_the_launch_file_declares_are_no_finding() {
    let mut config = flight("mirror-clean", 60);
    config.plant.initial = [("roll".to_string(), 0.3), ("pitch_rate".to_string(), -1.0)].into();
    // Far beyond what the inputs can do: they stand at their limits for a while.
    config.setpoint[8].values = [("roll".to_string(), 1.2)].into();
    config.setpoint[9].values = [("roll".to_string(), -1.2)].into();
    for (kind, parameters) in [
        (Kind::StepDisturbance, vec![("at_s", 20.0), ("magnitude", 0.5)]),
        (Kind::PeriodicDisturbance, vec![("frequency_hz", 0.8), ("amplitude", 0.5)]),
        (Kind::Turbulence, vec![("std", 0.5), ("bandwidth_hz", 1.0)]),
    ] {
        config.effects.push(Effect::new(kind, "pitch_rate", &parameters).unwrap());
    }
    let said = run(&config);
    assert!(said.findings.is_empty(), "{:?}", said.findings);
}

#[test]
fn commands_are_withheld_from_the_first_word_on_where_the_launch_file_says_so() {
    let mut config = weakened(flight("mirror-failsafe", 12));
    config.mirror = Some(MirrorConfig { on_finding: OnFinding::Failsafe });
    let said = run(&config);
    let first = said.findings.first().expect("a finding").head.step;
    let failsafe = *said.failsafe.first().expect("a failsafe");
    // In one thread the mirror takes its turn every 128 rounds.
    assert!((first..first + 300).contains(&failsafe), "found at {first}, failsafe from {failsafe}");
    config.mirror = Some(MirrorConfig::default());
    config.bench = common::unique("mirror-tell");
    assert!(run(&config).failsafe.is_empty());
}

fn messages<M: Message>(bytes: &[u8]) -> Vec<M> {
    bytes.chunks_exact(size_of::<M>()).map(bytemuck::pod_read_unaligned).collect()
}

/// Mean square of roll's error from a step on, in parts of 2 deg, and of the input that turns it, in parts of what it can do.
fn cost(said: &Said, config: &NodeConfig, from: u64) -> f64 {
    let mut wanted = 0.0;
    let mut sum = 0.0;
    let truths = messages::<Truth>(&said.bits[3]);
    for truth in truths.iter() {
        let at_s = truth.head.stamp_ns as f64 * 1e-9;
        wanted = config.setpoint.iter().rfind(|c| c.at_s <= at_s + 1e-9).map_or(wanted, |c| c.values["roll"]);
        if truth.head.step >= from {
            sum += ((truth.x[0] - wanted) / 0.035).powi(2) + (truth.u[0] / 20.0).powi(2);
        }
    }
    sum / (truths.len() as u64 - from) as f64
}

/// Flies a quadrotor that changes after 8 s, with and without a law that follows what is found: finding and command of the change, and
/// the costs from 2 s after it on.
fn succeeded(name: &str, effect: &Effect, law: LawKind) -> (Said, u64, [f64; 2]) {
    let mut config = restless(name, 40);
    config.controller.law = law;
    let late = Window { from_s: Some(8.0), until_s: None };
    config.effects.push(effect.clone().during(late).unwrap());
    config.mirror = Some(MirrorConfig { on_finding: OnFinding::Law });
    let with = run(&config);
    let change = with.findings.iter().find(|f| f.stage == FindingStage::Law as u32);
    let change = change.unwrap_or_else(|| panic!("{name}: no law: {:?}", with.findings));
    assert!(change.evidence > 0.0 && change.evidence < 1.0, "its cost on draws: {change:?}");
    let commands = messages::<Command>(&with.bits[2]);
    let is_other = |c: &&Command| c.flags & flags::SUCCEEDED != 0;
    let from = commands.iter().find(is_other).expect("another law is in charge").head.step;
    let said = change.head.step;
    assert!((said + 96..said + 400).contains(&from), "asked for at {said}, in charge from {from}");
    let again = run(&NodeConfig { bench: common::unique(name), ..config.clone() });
    assert!(again.bits == with.bits, "a run in lockstep repeats itself");
    let tell = MirrorConfig { on_finding: OnFinding::Tell };
    let told = run(&NodeConfig { mirror: Some(tell), bench: common::unique(name), ..config.clone() });
    assert!(told.findings.iter().all(|f| f.stage != FindingStage::Law as u32));
    assert!(messages::<Command>(&told.bits[2]).iter().all(|c| c.flags & flags::SUCCEEDED == 0));
    // No bump: the command changes at the first step of the new law as at those around it, with no step of the setpoint there.
    let change_at = |step: u64| {
        let pair = [step - 1, step].map(|k| commands.iter().find(|c| c.head.step == k).expect("a command"));
        (pair[1].u[0] - pair[0].u[0]).abs()
    };
    let usual = (from - 20..from).chain(from + 1..from + 20).map(change_at).fold(0.0, f64::max);
    assert!(change_at(from) < 2.0 * usual + 0.01, "{name}: {} after {usual}", change_at(from));
    let costs = [&told, &with].map(|said| cost(said, &config, from + 400));
    println!(
        "{name}: asked for at {said}, in charge from {from}, cost on draws {:.3}, flown {costs:.4?}",
        change.evidence
    );
    (with, from, costs)
}

fn late() -> Effect {
    Effect::new(Kind::InputDelay, "u_roll", &[("delay_s", 0.2)]).unwrap()
}

#[test]
fn the_law_for_a_late_input_takes_over_without_a_bump_and_flies_better() {
    let (said, from, [tell, law]) = succeeded("law-delay", &late(), LawKind::Lqr);
    assert!(law < 0.97 * tell, "cost {tell} without, {law} with");
    assert!(from < 8 * 200 + 12 * 200, "in charge from {from}");
    let laws = said.findings.iter().filter(|f| f.stage >= FindingStage::Law as u32).count();
    assert!(laws <= 2, "it does not go to and fro: {:?}", said.findings);
}

#[test]
fn the_first_law_comes_back_when_the_vehicle_is_itself_again() {
    let mut config = restless("law-back", 60);
    config.effects.push(late().during(Window { from_s: Some(8.0), until_s: Some(22.0) }).unwrap());
    config.mirror = Some(MirrorConfig { on_finding: OnFinding::Law });
    let said = run(&config);
    let stages: Vec<u32> =
        said.findings.iter().map(|f| f.stage).filter(|s| *s >= FindingStage::Law as u32).collect();
    assert_eq!(stages.first(), Some(&(FindingStage::Law as u32)), "{:?}", said.findings);
    assert_eq!(stages.last(), Some(&(FindingStage::FirstLaw as u32)), "{:?}", said.findings);
    let commands = messages::<Command>(&said.bits[2]);
    assert_eq!(commands.last().expect("commands").flags & flags::SUCCEEDED, 0);
    assert!(commands.iter().any(|c| c.flags & flags::SUCCEEDED != 0));
}

/// Half the effect of an input is known, and its law costs no less on draws: the inputs are at their limits as it is.
#[test]
fn a_law_that_is_not_certainly_better_does_not_fly() {
    let mut config = flight("law-refused", 30);
    let half = Effect::new(Kind::InputGain, "u_roll", &[("factor", 0.5)]).unwrap();
    config.effects.push(half.during(Window { from_s: Some(8.0), until_s: None }).unwrap());
    config.mirror = Some(MirrorConfig { on_finding: OnFinding::Law });
    let said = run(&config);
    assert!(said.findings.iter().any(|f| text_of(&f.effect) == "input_gain"), "{:?}", said.findings);
    assert!(said.findings.iter().all(|f| f.stage < FindingStage::Law as u32), "{:?}", said.findings);
    assert!(messages::<Command>(&said.bits[2]).iter().all(|c| c.flags & flags::SUCCEEDED == 0));
}
