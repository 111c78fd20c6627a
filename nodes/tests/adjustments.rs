//! What is asked for from outside is done by the node whose business it is, within limits, once, and answered.

mod common;

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, BusConfig, Publisher, Subscriber, Transport};
use whirlstand_msgs::{
    Adjustment, AdjustmentKind, AdjustmentVerdict, Command, Disturbance, Imu, Message, Setpoint,
};
use whirlstand_nodes::ADJUST_TOPIC;
use whirlstand_nodes::clock::Turn;
use whirlstand_nodes::config::{LawKind, NodeConfig};
use whirlstand_nodes::inproc::Bench;
use whirlstand_vehicle::{Effect, Kind, Window};

/// A bench with somebody outside who asks.
struct Flight {
    bench: Bench,
    ask: Publisher<Adjustment>,
    answers: Subscriber<Adjustment>,
    bus: Bus,
}

impl Flight {
    fn new(config: &NodeConfig) -> Self {
        let bench = Bench::open(config).unwrap();
        let bus = Bus::open(&BusConfig::new(&config.bench, "guest", Transport::Inproc)).unwrap();
        let (ask, answers) = (bus.publisher_on(ADJUST_TOPIC).unwrap(), bus.subscriber(64).unwrap());
        let mut flight = Self { bench, ask, answers, bus };
        flight.fly(50);
        flight
    }

    fn fly(&mut self, rounds: u32) {
        for _ in 0..rounds {
            self.bench.round().unwrap();
        }
    }

    /// Asks, and returns the answer.
    fn ask(&mut self, id: u64, kind: AdjustmentKind, index: u32, value: f64, length_ns: u64) -> Adjustment {
        let request = Adjustment { id, what: kind as u32, index, value, length_ns, ..Adjustment::zeroed() };
        self.ask.send(&request).unwrap();
        // A bench that is closed looks when its health is due, by the wall clock.
        let until = Instant::now() + Duration::from_secs(20);
        while Instant::now() < until {
            self.fly(1);
            if let Some(answer) = self.answers.try_recv().unwrap() {
                assert_eq!(answer.id, id);
                return answer;
            }
        }
        panic!("no answer to {request:?}");
    }
}

fn open(name: &str) -> NodeConfig {
    let mut config = common::config(name, u64::MAX);
    (config.plant.inject, config.controller.pilot) = (true, true);
    config
}

const DONE: u32 = AdjustmentVerdict::Done as u32;

#[test]
fn a_gust_blows_for_its_length_and_once() {
    let mut flight = Flight::new(&open("gust"));
    let mut pushes: Subscriber<Disturbance> = flight.bus.subscriber(64).unwrap();
    // 50 ms are 10 steps of 5 ms.
    let answer = flight.ask(7, AdjustmentKind::Gust, 1, 2.0, 50_000_000);
    assert_eq!(answer.verdict, DONE);
    assert_eq!(answer.head.stamp_ns, answer.head.step * 5_000_000);
    flight.fly(100);
    let again = flight.ask(7, AdjustmentKind::Gust, 1, 2.0, 50_000_000);
    assert_eq!((again.head.step, again.verdict), (answer.head.step, DONE), "the same answer once more");
    flight.fly(100);
    let mut seen = Vec::new();
    while let Some(push) = pushes.try_recv().unwrap() {
        seen.push((push.head.step, push.dx[1]));
    }
    assert_eq!(seen, [(answer.head.step, 2.0), (answer.head.step + 10, 0.0)]);
}

#[test]
fn gusts_on_one_state_add_up() {
    let mut flight = Flight::new(&open("gusts"));
    let mut pushes: Subscriber<Disturbance> = flight.bus.subscriber(64).unwrap();
    for id in 1..=2 {
        assert_eq!(flight.ask(id, AdjustmentKind::Gust, 0, 0.5, 1_000_000_000).verdict, DONE);
    }
    let mut last = 0.0;
    while let Some(push) = pushes.try_recv().unwrap() {
        last = push.dx[0];
    }
    assert_eq!(last, 1.0);
}

#[test]
fn setpoints_and_the_gain_reach_the_law() {
    let mut flight = Flight::new(&open("setpoint"));
    let mut setpoints: Subscriber<Setpoint> = flight.bus.subscriber(1024).unwrap();
    let answer = flight.ask(1, AdjustmentKind::Setpoint, 0, 0.1, 0);
    assert_eq!(answer.verdict, DONE);
    flight.fly(20);
    while let Some(s) = setpoints.try_recv().unwrap() {
        let wanted = if s.head.step < answer.head.step { (0.0, 0) } else { (0.1, 1) };
        assert_eq!((s.x[0], s.tracked), wanted, "step {}", s.head.step);
    }
}

#[test]
fn the_gain_multiplies_the_feedback() {
    let flight = || {
        let flight = Flight::new(&open("gain"));
        let commands: Subscriber<Command> = flight.bus.subscriber(1024).unwrap();
        (flight, commands)
    };
    let command_at = |commands: &mut Subscriber<Command>, step| {
        while let Some(command) = commands.try_recv().unwrap() {
            if command.head.step == step {
                return command.u[0];
            }
        }
        panic!("no command for step {step}");
    };
    let (mut adjusted, mut commands) = flight();
    let answer = adjusted.ask(1, AdjustmentKind::Gain, 0, 2.0, 0);
    assert_eq!(answer.verdict, DONE);
    adjusted.fly(10);
    let doubled = command_at(&mut commands, answer.head.step);
    let (mut plain, mut commands) = flight();
    plain.fly(200);
    let plain = command_at(&mut commands, answer.head.step);
    assert!(plain != 0.0 && (doubled - 2.0 * plain).abs() < 1e-12, "{plain} {doubled}");
}

#[test]
fn an_effect_with_a_window_is_switched_by_hand() {
    let mut config = open("effect");
    let late = Window { from_s: Some(1e6), until_s: None };
    let bias = Effect::new(Kind::SensorBias, "roll", &[("offset", 1.0)]).unwrap();
    config.effects.push(bias.during(late).unwrap());
    let mut flight = Flight::new(&config);
    let mut measured = flight.bus.subscriber::<Imu>(64).unwrap();
    let mut greatest = |flight: &mut Flight| {
        flight.fly(20);
        let mut greatest: f64 = 0.0;
        while let Some(imu) = measured.try_recv().unwrap() {
            greatest = greatest.max(imu.roll);
        }
        greatest
    };
    let before = greatest(&mut flight);
    assert_eq!(flight.ask(1, AdjustmentKind::Effect, 0, 1.0, 0).verdict, DONE);
    let after = greatest(&mut flight);
    assert!(after > before + 0.8, "{before} {after}");
}

#[test]
fn a_run_ends_in_order_when_it_is_asked_to() {
    let mut flight = Flight::new(&open("stop"));
    let mut measured = flight.bus.subscriber::<Imu>(64).unwrap();
    let refused = flight.ask(1, AdjustmentKind::Stop, 0, 1.0, 0);
    assert_eq!(refused.verdict, AdjustmentVerdict::Unusable as u32);
    let answer = flight.ask(2, AdjustmentKind::Stop, 0, 0.0, 0);
    assert_eq!(answer.verdict, DONE);
    let ended = (0..10_000).any(|_| flight.bench.round().unwrap() == Turn::Ended);
    let mut last = None;
    while let Some(imu) = measured.try_recv().unwrap() {
        last = Some(imu.head.step);
    }
    assert_eq!((ended, last), (true, Some(answer.head.step)));
}

#[test]
fn what_cannot_be_is_refused_with_its_reason() {
    let mut flight = Flight::new(&open("refused"));
    let mut verdict = |id, kind, index, value, length| {
        AdjustmentVerdict::from_u32(flight.ask(id, kind, index, value, length).verdict).unwrap()
    };
    use AdjustmentKind::{Effect, Engine, Gain, Gust, Setpoint};
    use AdjustmentVerdict::{Busy, Done, NoSuchEffect, NoSuchState, OutOfRange, Unusable};
    assert_eq!(verdict(8, Effect, 7, 1.0, 0), NoSuchEffect);
    assert_eq!(verdict(9, Effect, 0, 2.0, 0), Unusable);
    assert_eq!(verdict(1, Gust, 40, 1.0, 1_000_000), NoSuchState);
    assert_eq!(verdict(2, Gust, 0, f64::NAN, 1_000_000), Unusable);
    assert_eq!(verdict(3, Gust, 0, 1e300, 1_000_000), OutOfRange);
    assert_eq!(verdict(4, Setpoint, 40, 0.1, 0), NoSuchState);
    assert_eq!(verdict(5, Setpoint, 0, f64::INFINITY, 0), Unusable);
    assert_eq!(verdict(6, Gain, 0, 50.0, 0), OutOfRange);
    assert_eq!(verdict(7, Engine, 0, 3.0, 0), Unusable);
    for id in 10..26 {
        assert_eq!(verdict(id, Gust, 0, 1e-6, 1_000_000_000_000), Done);
    }
    assert_eq!(verdict(30, Gust, 0, 1e-6, 1_000_000), Busy);
}

#[test]
fn a_bench_that_is_closed_answers_so_and_a_law_without_feedback_has_no_gain() {
    let mut flight = Flight::new(&common::config("closed", u64::MAX));
    for (id, kind) in [(1, AdjustmentKind::Engine), (2, AdjustmentKind::Gain)] {
        let answer = flight.ask(id, kind, 0, 1.0, 0);
        assert_eq!(answer.verdict, AdjustmentVerdict::Closed as u32);
    }
    let mut config = open("manual");
    config.controller.law = LawKind::Manual;
    let answer = Flight::new(&config).ask(1, AdjustmentKind::Gain, 0, 2.0, 0);
    assert_eq!(answer.verdict, AdjustmentVerdict::NotOfThisLaw as u32);
}
