//! What is asked for from outside is done by the node whose business it is, within limits, once, and answered.

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, BusConfig, Publisher, Subscriber, Transport};
use whirlstand_msgs::{
    Adjustment, AdjustmentKind, AdjustmentVerdict, Command, Disturbance, Imu, Message, Setpoint, Stick, flags,
};
use whirlstand_nodes::ADJUST_TOPIC;
use whirlstand_nodes::clock::Turn;
use whirlstand_nodes::config::{LawKind, NodeConfig};
use whirlstand_nodes::inproc::Bench;
use whirlstand_vehicle::{Effect, Kind, Window};

use crate::common;

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

/// The rule of a hand on the stick: taken over, heard within the limits and from nobody else, and given back when it is silent.
#[test]
fn a_hand_flies_for_as_long_as_it_is_heard_and_the_law_goes_on_from_there() {
    let config = open("stick");
    let mut flight = Flight::new(&config);
    let upper = whirlstand_vehicle::Vehicle::builtin("quadrotor").unwrap().inputs[0].upper;
    let mut commands = flight.bus.subscriber::<Command>(1024).unwrap();
    let mut setpoints = flight.bus.subscriber::<Setpoint>(1024).unwrap();
    let mut stick = flight.bus.publisher::<Stick>().unwrap();
    let mut say = |flight: &mut Flight, id: u64, u: f64| {
        let mut said = Stick { id, ..Stick::zeroed() };
        said.u[0] = u;
        stick.send(&said).unwrap();
        flight.fly(20);
    };
    say(&mut flight, 7, 0.5 * upper);
    let taken = flight.ask(7, AdjustmentKind::Stick, 0, 1.0, 0);
    assert_eq!(taken.verdict, DONE);
    let second = flight.ask(8, AdjustmentKind::Stick, 0, 1.0, 0);
    assert_eq!(second.verdict, AdjustmentVerdict::Busy as u32, "one hand at a time");
    assert_eq!(flight.ask(9, AdjustmentKind::Stick, 0, 2.0, 0).verdict, AdjustmentVerdict::Unusable as u32);
    let given = 0.02 * upper;
    say(&mut flight, 7, given);
    for nonsense in [(8, -given), (7, 1.1 * upper), (7, f64::NAN)] {
        say(&mut flight, nonsense.0, nonsense.1);
    }
    flight.fly(600);
    let mut flown: Vec<Command> = Vec::new();
    while let Some(command) = commands.try_recv().unwrap() {
        flown.push(command);
    }
    let is_by_hand = |c: &&Command| c.flags & flags::MANUAL != 0;
    let by_hand: Vec<_> = flown.iter().filter(is_by_hand).copied().collect();
    assert_eq!(by_hand[0].head.step, taken.head.step, "not before it was taken over");
    let last = by_hand.last().unwrap();
    assert_eq!(last.head.step - taken.head.step + 1, by_hand.len() as u64, "without a gap");
    // Until the hand says something it holds what was commanded last, and from then on what it said last.
    let before = flown.iter().find(|c| c.head.step + 1 == taken.head.step).unwrap();
    let heard = by_hand.iter().position(|c| c.u[0] == given).expect("it is obeyed");
    assert!(
        by_hand[..heard].iter().all(|c| c.u == before.u) && by_hand[heard..].iter().all(|c| c.u[0] == given)
    );
    // Half a second of silence are 100 steps of 5 ms; beyond the limits is no word.
    assert_eq!(last.head.step + 1 - by_hand[heard].head.step, 100);
    let told = std::iter::from_fn(|| flight.answers.try_recv().unwrap()).last().expect("it is told");
    assert_eq!((told.id, told.what, told.value), (7, AdjustmentKind::Stick as u32, 0.0));
    assert_eq!((told.head.step, told.verdict), (last.head.step + 1, DONE));
    let next = flown.iter().find(|c| c.head.step == last.head.step + 1).unwrap();
    // Beside what the noise of the sensors makes of the command from step to step anyhow.
    let settled: Vec<_> =
        flown.iter().filter(|c| c.head.step > last.head.step + 200).map(|c| c.u[0]).collect();
    let usual = settled.windows(2).map(|u| (u[1] - u[0]).abs()).fold(0.0, f64::max);
    let bump = (next.u[0] - given).abs();
    assert!(bump < usual + 0.005 * upper, "from {given} to {}, usually by {usual}", next.u[0]);
    // The setpoints, which are in the log, say where the stick was.
    while let Some(setpoint) = setpoints.try_recv().unwrap() {
        let command = by_hand.iter().find(|c| c.head.step == setpoint.head.step);
        assert_eq!(setpoint.stick[0], command.map_or(0.0, |c| c.u[0]), "step {}", setpoint.head.step);
    }
    // Anybody may give it back.
    assert_eq!(flight.ask(10, AdjustmentKind::Stick, 0, 1.0, 0).verdict, DONE);
    assert_eq!(flight.ask(11, AdjustmentKind::Stick, 0, 0.0, 0).verdict, DONE);
    flight.fly(5);
    let last = std::iter::from_fn(|| commands.try_recv().unwrap()).last().unwrap();
    assert_eq!(last.flags & flags::MANUAL, 0);
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
