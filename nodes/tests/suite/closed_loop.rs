//! All nodes together, in one thread: the same bits whatever carries them, and recovery after restarts.

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, BusConfig, Carried, RecvError, Subscriber, Transport};
use whirlstand_msgs::{Command, Estimate, Imu, Message, Setpoint, Truth, flags};
use whirlstand_nodes::clock::{Clock, Turn};
use whirlstand_nodes::config::{EstimatorKind, LawKind, Mode, NodeConfig};
use whirlstand_nodes::controller::Controller;
use whirlstand_nodes::estimator::Estimator;
use whirlstand_nodes::follower::Follower;
use whirlstand_nodes::inproc::Bench;
use whirlstand_nodes::os::StopFlag;
use whirlstand_nodes::plant::Plant;
use whirlstand_nodes::setup::Setup;

use crate::common;

/// Everything that a run published on one topic, as bytes.
struct RecordedTopic<M: Message> {
    subscriber: Subscriber<M>,
    bytes: Vec<u8>,
}

impl<M: Carried> RecordedTopic<M> {
    fn new(bus: &Bus) -> Self {
        Self { subscriber: bus.subscriber(512).unwrap(), bytes: Vec::new() }
    }

    fn drain(&mut self) {
        while let Some(message) = self.subscriber.try_recv().unwrap() {
            self.bytes.extend_from_slice(bytemuck::bytes_of(&message));
        }
    }

    fn take(mut self, steps: u64) -> Vec<u8> {
        let limit = Instant::now() + Duration::from_secs(10);
        while self.bytes.len() < steps as usize * size_of::<M>() && Instant::now() < limit {
            self.drain();
        }
        assert_eq!(self.bytes.len(), steps as usize * size_of::<M>(), "{}", M::TYPE_NAME);
        self.bytes
    }
}

fn record(config: &NodeConfig) -> Vec<Vec<u8>> {
    let bus = Bus::open(&BusConfig::new(&config.bench, "tape", config.transport)).unwrap();
    let mut imu = RecordedTopic::<Imu>::new(&bus);
    let mut estimate = RecordedTopic::<Estimate>::new(&bus);
    let mut command = RecordedTopic::<Command>::new(&bus);
    let mut setpoint = RecordedTopic::<Setpoint>::new(&bus);
    let mut truth = RecordedTopic::<Truth>::new(&bus);
    let mut config = config.clone();
    if config.transport == Transport::Zenoh {
        config.zenoh.connect = bus.locators().to_vec();
    }
    let mut bench = Bench::open(&config).unwrap();
    let limit = Instant::now() + Duration::from_secs(60);
    while bench.round().unwrap() != Turn::Ended {
        assert!(Instant::now() < limit, "the bench hangs");
        imu.drain();
        estimate.drain();
        command.drain();
        setpoint.drain();
        truth.drain();
    }
    let n = config.steps;
    vec![imu.take(n), estimate.take(n), command.take(n), setpoint.take(n), truth.take(n)]
}

#[test]
fn the_same_seed_gives_the_same_bits_over_every_transport_and_twice() {
    let config = common::config("bits", 400);
    let reference = record(&config);
    for transport in Transport::ALL {
        let again = NodeConfig { transport, bench: common::unique("bits"), ..config.clone() };
        assert!(record(&again) == reference, "{transport} differs");
    }
    let other = NodeConfig { seed: 2, bench: common::unique("bits"), ..config };
    assert!(record(&other) != reference, "the seed matters");
}

#[test]
fn realtime_without_a_miss_gives_the_bits_of_lockstep() {
    let config = NodeConfig { period_ns: 2_000_000, ..common::config("bits-rt", 150) };
    let lockstep = record(&config);
    // A busy machine can cause misses; then this attempt says nothing, and the next one counts.
    for _ in 0..20 {
        let realtime =
            NodeConfig { mode: Mode::Realtime, bench: common::unique("bits-rt"), ..config.clone() };
        let bits = record(&realtime);
        let held = bits[4]
            .chunks(size_of::<Truth>())
            .any(|t| bytemuck::pod_read_unaligned::<Truth>(t).flags & flags::HELD != 0);
        if !held {
            assert!(bits == lockstep);
            return;
        }
    }
    panic!("no attempt was without a miss");
}

#[test]
fn every_law_and_filter_closes_the_loop_on_every_vehicle() {
    for vehicle in whirlstand_vehicle::builtin_names() {
        for law in [LawKind::Lqr, LawKind::Ppc, LawKind::Smc] {
            for kind in [EstimatorKind::Model, EstimatorKind::Kinematic] {
                let mut config = common::config("laws", 4000);
                config.vehicle.origin = vehicle.into();
                config.vehicle.text = whirlstand_vehicle::Vehicle::builtin(vehicle).unwrap().source_text;
                config.controller.law = law;
                config.estimator.kind = kind;
                let state = whirlstand_vehicle::Vehicle::builtin(vehicle).unwrap().states[0].name.clone();
                config.plant.initial = [(state, 0.05)].into();
                let bus = Bus::open(&BusConfig::new(&config.bench, "watch", Transport::Inproc)).unwrap();
                let mut truths = bus.subscriber::<Truth>(16).unwrap();
                let mut bench = Bench::open(&config).unwrap();
                let mut last = None;
                while bench.round().unwrap() != Turn::Ended {
                    last = truths.try_recv().unwrap().or(last);
                }
                let last = last.unwrap();
                let worst = last.x.iter().fold(0f64, |m, x| m.max(x.abs()));
                // 20 s after a start at 3 degrees every vehicle is back near rest.
                assert!(worst < 0.6, "{vehicle}, {law:?}, {kind:?}: {:?}", last.x);
            }
        }
    }
}

/// The three nodes apart, so that each can be dropped and opened again.
struct Loop {
    config: NodeConfig,
    setup: Setup,
    bus: Bus,
    plant: Option<Plant>,
    estimator: Option<Estimator>,
    controller: Option<Controller>,
    truths: Subscriber<Truth>,
    clock: Clock,
}

impl Loop {
    fn new(config: NodeConfig) -> Self {
        let setup = Setup::new(&config).unwrap();
        let bus = Bus::open(&BusConfig::new(&config.bench, "loop", Transport::Inproc)).unwrap();
        Self {
            estimator: Some(Estimator::open(&bus, &config, &setup).unwrap()),
            controller: Some(Controller::open(&bus, &config, &setup).unwrap()),
            plant: Some(Plant::open(&bus, &config, &setup).unwrap()),
            truths: bus.subscriber(512).unwrap(),
            clock: Clock::exact(),
            config,
            setup,
            bus,
        }
    }

    /// Turns until `done` says so about a new truth.
    fn until(&mut self, mut done: impl FnMut(&Truth) -> bool) -> Truth {
        let limit = Instant::now() + Duration::from_secs(20);
        loop {
            assert!(Instant::now() < limit, "the loop hangs");
            if let Some(plant) = &mut self.plant {
                assert_ne!(plant.turn(&mut self.clock).unwrap(), Turn::Ended);
            }
            let now = Instant::now();
            if let Some(estimator) = &mut self.estimator {
                estimator.turn(&mut self.clock).unwrap();
                estimator.housekeeping(now).unwrap();
            }
            if let Some(controller) = &mut self.controller {
                controller.turn(&mut self.clock).unwrap();
                controller.housekeeping(now).unwrap();
            }
            while let Some(truth) = self.truths.try_recv().unwrap() {
                if done(&truth) {
                    return truth;
                }
            }
        }
    }
}

#[test]
fn each_node_can_leave_and_come_back() {
    let mut config = common::config("restarts", 1_000_000);
    config.plant.answer_timeout_s = Some(0.01);
    let mut bench = Loop::new(config);
    let flying = |t: &Truth| t.flags == 0;
    bench.until(|t| t.head.step == 50);

    bench.estimator = None;
    bench.until(|t| t.flags & flags::FAILSAFE != 0);
    bench.estimator = Some(Estimator::open(&bench.bus, &bench.config, &bench.setup).unwrap());
    let back = bench.until(flying);
    assert!(back.head.step > 50);

    bench.controller = None;
    bench.until(|t| t.flags & flags::FAILSAFE != 0);
    bench.controller = Some(Controller::open(&bench.bus, &bench.config, &bench.setup).unwrap());
    let back = bench.until(flying);

    // A new plant begins a new run, and the others follow it.
    bench.plant = None;
    bench.plant = Some(Plant::open(&bench.bus, &bench.config, &bench.setup).unwrap());
    let first = bench.until(|t| t.head.step < back.head.step);
    assert_eq!(first.head.step, 0);
    let flying = bench.until(|t| t.head.step == 100);
    assert_eq!(flying.flags, 0);
    assert!(flying.x[..4].iter().all(|x| x.abs() < 0.2), "{:?}", flying.x);
}

#[test]
fn a_stop_ends_in_order() {
    let config = common::config("stop", u64::MAX);
    let bus = Bus::open(&BusConfig::new(&config.bench, "observer", Transport::Inproc)).unwrap();
    let mut truths = bus.subscriber::<Truth>(16).unwrap();
    let stop = StopFlag::default();
    let flag = stop.clone();
    let handle = std::thread::spawn(move || whirlstand_nodes::run_inproc(&config, &flag).unwrap());
    let flown = || Ok::<_, RecvError>(truths.try_recv()?.is_some_and(|t| t.head.step >= 100));
    assert!(bus.wait_until(Instant::now() + Duration::from_secs(60), flown).unwrap());
    stop.set();
    let ended = handle.join().unwrap();
    assert!(ended.steps > 0);
    let stopping = whirlstand_msgs::NodeState::Stopping as u32;
    assert!(ended.reports.iter().all(|(_, health)| health.state == stopping));
    let steps = ended.reports.iter().map(|(_, h)| h.steps).collect::<Vec<_>>();
    assert_eq!(steps, [ended.steps; 3], "the last step is complete");
}
