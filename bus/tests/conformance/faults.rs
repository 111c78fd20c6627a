//! Nodes are killed, stopped and started again.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, BusConfig, RecvError, Transport, WaitStrategy};
use whirlstand_msgs::{Command, Imu, Progress};

use crate::stage::{PATIENCE, Stage, at, next, until_heard};

/// Publishes `Imu` as fast as somebody takes them, until it dies.
pub fn sensor(config: &BusConfig, stop: &AtomicBool) {
    let bus = Bus::open(config).unwrap();
    let mut publisher = bus.publisher::<Imu>().unwrap();
    let mut step = 0;
    while !stop.load(Ordering::Relaxed) {
        publisher.send(&at(step)).unwrap();
        step += 1;
        std::thread::sleep(Duration::from_micros(200));
    }
}

/// Subscribes to `Command`, says so, and never takes one.
pub fn sleeper(config: &BusConfig, stop: &AtomicBool) {
    let bus = Bus::open(config).unwrap();
    let _subscriber = bus.subscriber::<Command>(8).unwrap();
    let mut publisher = bus.publisher::<Progress>().unwrap();
    while !stop.load(Ordering::Relaxed) {
        publisher.send(&at(0)).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// What this program does as a peer.
pub fn run_peer(role: &str) {
    let config = serde_json::from_str(&std::env::var("WHIRLSTAND_TEST_CONFIG").unwrap()).unwrap();
    let never = AtomicBool::new(false);
    match role {
        "sensor" => sensor(&config, &never),
        "sleeper" => sleeper(&config, &never),
        other => panic!("no peer is called {other}"),
    }
}

pub fn a_killed_publisher_can_be_started_again(transport: Transport) {
    let stage = Stage::new(transport, "restart");
    let bus = stage.join("here");
    let mut subscriber = bus.subscriber::<Imu>(1024).unwrap();
    for life in 0..5 {
        let mut peer = stage.spawn("sensor", sensor);
        // A new life begins again at sequence number 0, or a little later when the connection took a while.
        let mut previous = None;
        for _ in 0..50 * (life + 1) {
            let imu = next(&bus, &mut subscriber);
            if let Some(previous) = previous {
                assert_eq!(imu.head.seq, previous + 1, "in life {life}");
            }
            previous = Some(imu.head.seq);
        }
        peer.kill();
        // What was sent before the death may still arrive; then there is silence.
        let silence = Duration::from_millis(100);
        let mut last = Instant::now();
        while last.elapsed() < silence {
            let quiet = Instant::now() + silence;
            let mut came = false;
            bus.wait_until(quiet, || {
                came = subscriber.try_recv()?.is_some();
                Ok::<_, RecvError>(came)
            })
            .unwrap();
            if came {
                last = Instant::now();
            }
        }
    }
    assert_eq!(subscriber.lost(), 0);
}

pub fn a_killed_subscriber_disturbs_nobody(transport: Transport) {
    let stage = Stage::new(transport, "deaf");
    let bus = stage.join("here");
    let listener = stage.join("listener");
    let mut ready = bus.subscriber::<Progress>(8).unwrap();
    let mut commands = listener.subscriber::<Command>(1024).unwrap();
    let mut publisher = bus.publisher::<Command>().unwrap();
    until_heard(&bus, &mut publisher);
    let mut step = 0;
    for _ in 0..4 {
        let mut peer = stage.spawn("sleeper", sleeper);
        next(&bus, &mut ready);
        for send in 0..200 {
            if send == 100 {
                peer.kill();
            }
            publisher.send(&at(step)).unwrap();
            assert_eq!(next(&listener, &mut commands).head.step, step);
            step += 1;
        }
        while ready.try_recv().unwrap().is_some() {}
    }
    assert_eq!(commands.lost(), 0);
}

pub fn a_stopped_subscriber_does_not_block_the_sender(transport: Transport) {
    const COUNT: u64 = 100_000;
    let mut stage = Stage::new(transport, "stopped");
    stage.wait = WaitStrategy::realtime();
    let bus = stage.join("here");
    let mut ready = bus.subscriber::<Progress>(8).unwrap();
    let mut publisher = bus.publisher::<Command>().unwrap();
    let mut peer = stage.spawn("sleeper", sleeper);
    next(&bus, &mut ready);
    until_heard(&bus, &mut publisher);
    peer.signal(libc::SIGSTOP);
    let start = Instant::now();
    for step in 0..COUNT {
        publisher.send(&at(step)).unwrap();
    }
    let elapsed = start.elapsed();
    peer.signal(libc::SIGCONT);
    peer.kill();
    // A sender that waits for the stopped one would never end, or wait 1 ms for each message.
    assert!(elapsed < PATIENCE.min(Duration::from_millis(COUNT / 4)), "{elapsed:?}");
}
