//! What the plant does with commands that it should not trust, and without any.

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, BusConfig, Publisher, Subscriber, Transport};
use whirlstand_msgs::{Command, Health, Imu, Message, NodeState, Truth, flags};
use whirlstand_nodes::clock::{Clock, Turn};
use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::plant::Plant;
use whirlstand_nodes::setup::Setup;

use crate::common;

/// A plant alone on a bench, and what a controller and a spectator hold of it.
struct Rig {
    plant: Plant,
    clock: Clock,
    commands: Publisher<Command>,
    imus: Subscriber<Imu>,
    truths: Subscriber<Truth>,
    healths: Subscriber<Health>,
}

impl Rig {
    fn new(config: &NodeConfig) -> Self {
        let bus = Bus::open(&BusConfig::new(&config.bench, "rig", Transport::Inproc)).unwrap();
        let setup = Setup::new(config).unwrap();
        let (imus, truths, healths) =
            (bus.subscriber(64).unwrap(), bus.subscriber(64).unwrap(), bus.subscriber(64).unwrap());
        let plant = Plant::open(&bus, config, &setup).unwrap();
        let commands = bus.publisher().unwrap();
        Self { plant, clock: Clock::exact(), commands, imus, truths, healths }
    }

    /// Turns until the plant has published the next step.
    fn next(&mut self) -> (Truth, Imu) {
        let limit = Instant::now() + Duration::from_secs(20);
        loop {
            assert!(Instant::now() < limit, "the plant hangs");
            let turn = self.plant.turn(&mut self.clock).unwrap();
            let truth = self.truths.try_recv().unwrap();
            if let Some(truth) = truth {
                return (truth, self.imus.try_recv().unwrap().expect("a measurement goes with every truth"));
            }
            assert_ne!(turn, Turn::Ended, "the run is over");
        }
    }

    fn send(&mut self, step: u64, u: [f64; 2]) {
        let mut command = Command { count: 2, ..Command::zeroed() };
        command.head.step = step;
        command.u[..2].copy_from_slice(&u);
        self.commands.send(&command).unwrap();
    }

    /// Every state that was reported.
    fn states(&mut self) -> Vec<u32> {
        let mut states = Vec::new();
        while let Some(health) = self.healths.try_recv().unwrap() {
            states.push(health.state);
        }
        states
    }
}

/// A plant that waits for nobody before it starts and does not wait long for a command.
fn config(name: &str) -> NodeConfig {
    let mut config = common::config(name, 1000);
    config.peers.clear();
    config.plant.answer_timeout_s = Some(0.02);
    config
}

#[test]
fn no_bad_command_reaches_the_actuators() {
    let mut rig = Rig::new(&config("bad-commands"));
    let (truth, imu) = rig.next();
    assert_eq!((truth.head.step, imu.head.step, truth.u[0], truth.flags), (0, 0, 0.0, 0));
    rig.send(0, [0.1, -0.1]);
    assert_eq!(rig.next().0.u[..2], [0.1, -0.1]);

    let bad: [(u64, [f64; 2]); 5] = [
        (1, [f64::NAN, 0.0]),
        (1, [0.0, f64::INFINITY]),
        (0, [0.2, 0.2]),
        (7, [0.3, 0.3]),
        (1, [f64::NEG_INFINITY, 0.0]),
    ];
    for (step, u) in bad {
        rig.send(step, u);
    }
    let (truth, _) = rig.next();
    assert_eq!(truth.flags & flags::FAILSAFE, flags::FAILSAFE, "in lockstep a timeout is a failsafe");
    assert_eq!(truth.u[..2], [0.0, 0.0]);
    assert_eq!(rig.plant.health().rejected, 4, "an answer to step 0 may come twice");
    assert_eq!(rig.plant.health().deadline_misses, 1);

    // Good at last, then repeated with other content: the first one counts.
    rig.send(2, [0.1, 0.1]);
    rig.send(2, [-0.9, -0.9]);
    let (truth, _) = rig.next();
    assert_eq!((truth.u[0], truth.u[1], truth.flags), (0.1, 0.1, 0));

    rig.send(3, [1e9, -1e9]);
    let (truth, _) = rig.next();
    let vehicle = whirlstand_vehicle::Vehicle::builtin("quadrotor").unwrap();
    assert_eq!(truth.u[..2], [vehicle.inputs[0].upper, vehicle.inputs[1].lower]);
    assert_eq!(truth.flags, flags::SATURATED);
    assert_eq!(rig.plant.health().rejected, 6);
}

#[test]
fn a_lost_controller_means_failsafe_and_a_new_one_ends_it() {
    let mut rig = Rig::new(&config("failsafe"));
    rig.next();
    rig.send(0, [0.2, 0.2]);
    rig.next();
    for _ in 0..3 {
        let (truth, _) = rig.next();
        assert_eq!(truth.u[..2], [0.0, 0.0]);
        assert_eq!(truth.flags, flags::HELD | flags::FAILSAFE);
    }
    rig.plant.turn(&mut rig.clock).unwrap();
    assert!(rig.states().contains(&(NodeState::Failsafe as u32)), "the failsafe is announced");
    // A restarted controller answers the newest measurement.
    rig.send(4, [0.3, 0.3]);
    let (truth, _) = rig.next();
    assert_eq!((truth.head.step, truth.u[0], truth.flags), (5, 0.3, 0));
    rig.plant.turn(&mut rig.clock).unwrap();
    assert_eq!(rig.states().last(), Some(&(NodeState::Running as u32)));
    assert_eq!(rig.plant.health().deadline_misses, 3);
}

#[test]
fn realtime_holds_the_last_command_before_it_gives_up() {
    let mut config = config("held");
    config.mode = whirlstand_nodes::config::Mode::Realtime;
    config.plant.misses_to_failsafe = 3;
    config.period_ns = 2_000_000;
    let mut rig = Rig::new(&config);
    rig.next();
    rig.send(0, [0.2, 0.2]);
    while rig.plant.deadline().is_none() {
        rig.plant.turn(&mut rig.clock).unwrap();
    }
    let mut applied = Vec::new();
    for step in 1..8u64 {
        // Deadlines that pass while the test itself is not scheduled only add to the misses.
        whirlstand_nodes::os::sleep_until(rig.plant.deadline().unwrap(), || false);
        rig.plant.tick(&mut rig.clock).unwrap();
        let truth = rig.truths.try_recv().unwrap().unwrap();
        applied.push((truth.u[0], truth.flags));
        if step == 5 {
            rig.send(5, [0.4, 0.4]);
        }
        // Too late for its step: never applied.
        rig.send(step - 1, [0.9, 0.9]);
    }
    let (held, failsafe) = (flags::HELD, flags::HELD | flags::FAILSAFE);
    let expected =
        [(0.2, 0), (0.2, held), (0.2, held), (0.0, failsafe), (0.0, failsafe), (0.4, 0), (0.4, held)];
    assert_eq!(applied, expected);
    assert!(rig.plant.health().deadline_misses >= 5);
}

#[test]
fn an_unanswered_step_0_is_repeated_and_then_given_up() {
    let mut config = config("unanswered");
    config.start_timeout_s = 0.5;
    let mut rig = Rig::new(&config);
    rig.next();
    let error = loop {
        match rig.plant.turn(&mut rig.clock) {
            Ok(_) => std::thread::yield_now(),
            Err(e) => break e.to_string(),
        }
    };
    assert!(error.contains("step 0") && error.contains("0.5 s"), "{error}");
    let repeated = rig.imus.try_recv().unwrap().expect("the measurement was repeated");
    assert_eq!((repeated.head.step, repeated.head.seq), (0, 0), "the same message, also by its number");
}

#[test]
fn peers_that_never_come_are_named() {
    let mut config = common::config("absent", 10);
    config.start_timeout_s = 0.05;
    let mut rig = Rig::new(&config);
    let error = loop {
        if let Err(e) = rig.plant.turn(&mut rig.clock) {
            break e.to_string();
        }
    };
    assert!(error.contains("estimator and controller"), "{error}");
}
