//! Messages flow: completely, in order, to whom they belong.

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, Carried, RecvError, Transport, WaitStrategy};
use whirlstand_msgs::{
    Command, Disturbance, Estimate, Health, Imu, Message, Odometry, Outputs, Progress, Setpoint, Truth,
};

use crate::stage::{PATIENCE, Stage, at, bytes, next, until_heard};

/// A message whose every byte is different from its neighbour; only the sequence number is the bus's.
fn full<M: Message>(seq: u64) -> M {
    let image: Vec<u8> = (0..size_of::<M>()).map(|i| (i as u8).wrapping_mul(37).wrapping_add(11)).collect();
    let mut message: M = bytemuck::pod_read_unaligned(&image);
    message.head_mut().seq = seq;
    message
}

fn round_trip<M: Carried>(here: &Bus, there: &Bus) {
    let mut subscriber = there.subscriber::<M>(4).unwrap();
    let mut publisher = here.publisher::<M>().unwrap();
    until_heard(here, &mut publisher);
    for seq in 0..3 {
        publisher.send(&full::<M>(99)).unwrap();
        assert_eq!(bytes(&next(there, &mut subscriber)), bytes(&full::<M>(seq)), "{}", M::TYPE_NAME);
    }
    assert_eq!(subscriber.lost(), 0);
}

pub fn every_message_arrives_as_it_was_sent(transport: Transport) {
    let stage = Stage::new(transport, "round");
    let (here, there) = (stage.join("here"), stage.join("there"));
    round_trip::<Imu>(&here, &there);
    round_trip::<Odometry>(&here, &there);
    round_trip::<Outputs>(&here, &there);
    round_trip::<Estimate>(&here, &there);
    round_trip::<Command>(&here, &there);
    round_trip::<Setpoint>(&here, &there);
    round_trip::<Truth>(&here, &there);
    round_trip::<Disturbance>(&here, &there);
    round_trip::<Health>(&here, &there);
    round_trip::<Progress>(&here, &there);
}

pub fn messages_keep_their_order(transport: Transport) {
    const WINDOW: u64 = 64;
    const COUNT: u64 = 20_000;
    let mut stage = Stage::new(transport, "order");
    stage.wait = WaitStrategy::lockstep();
    let there = stage.join("there");
    let mut subscriber = there.subscriber::<Imu>(2 * WINDOW as usize).unwrap();
    let mut answers = there.publisher::<Progress>().unwrap();
    let config = stage.config("here");
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let here = Bus::open(&config).unwrap();
            let mut progress = here.subscriber::<Progress>(WINDOW as usize).unwrap();
            let mut publisher = here.publisher::<Imu>().unwrap();
            until_heard(&here, &mut publisher);
            let mut confirmed = 0;
            for step in 0..COUNT {
                while step >= confirmed + WINDOW {
                    confirmed = next(&here, &mut progress).written;
                }
                publisher.send(&at(step)).unwrap();
            }
            // Leaving would end a network session before everything is delivered.
            while confirmed < COUNT {
                confirmed = next(&here, &mut progress).written;
            }
        });
        until_heard(&there, &mut answers);
        for step in 0..COUNT {
            let imu = next(&there, &mut subscriber);
            assert_eq!((imu.head.step, imu.head.seq), (step, step));
            if (step + 1) % (WINDOW / 2) == 0 || step + 1 == COUNT {
                answers.send(&Progress { written: step + 1, ..at(step) }).unwrap();
            }
        }
    });
    assert_eq!(subscriber.lost(), 0);
}

pub fn several_publishers_share_a_topic(transport: Transport) {
    const PUBLISHERS: usize = 5;
    const COUNT: u64 = 100;
    const ROUNDS: u64 = 10;
    let stage = Stage::new(transport, "several");
    let there = stage.join("there");
    let mut subscriber = there.subscriber::<Health>(PUBLISHERS * COUNT as usize).unwrap();
    let nodes: Vec<Bus> = (0..PUBLISHERS).map(|i| stage.join(&format!("node-{i}"))).collect();
    let mut publishers: Vec<_> = nodes.iter().map(|n| n.publisher::<Health>().unwrap()).collect();
    for (node, publisher) in nodes.iter().zip(&mut publishers) {
        until_heard(node, publisher);
    }
    let mut expected = [0; PUBLISHERS];
    for step in 0..COUNT {
        for (pid, publisher) in publishers.iter_mut().enumerate() {
            publisher.send(&Health { pid: pid as u32, ..at(step) }).unwrap();
        }
        if (step + 1) % ROUNDS != 0 {
            continue;
        }
        // A link that the machine holds up may drop what is sent on and on.
        for _ in 0..PUBLISHERS as u64 * ROUNDS {
            let health = next(&there, &mut subscriber);
            let step = &mut expected[health.pid as usize];
            assert_eq!((health.head.step, health.head.seq), (*step, *step), "of publisher {}", health.pid);
            *step += 1;
        }
    }
    assert_eq!(expected, [COUNT; PUBLISHERS]);
    assert_eq!(subscriber.lost(), 0);
    assert!(subscriber.try_recv().unwrap().is_none());
}

pub fn a_message_sent_again_keeps_its_number(transport: Transport) {
    let stage = Stage::new(transport, "again");
    let (here, there) = (stage.join("here"), stage.join("there"));
    let mut publisher = here.publisher::<Health>().unwrap();
    let mut subscriber = there.subscriber::<Health>(8).unwrap();
    until_heard(&here, &mut publisher);
    publisher.send(&at(0)).unwrap();
    publisher.send_again(&at(0)).unwrap();
    publisher.send(&at(1)).unwrap();
    let numbers = [(); 3].map(|()| next(&there, &mut subscriber).head.seq);
    assert_eq!(numbers, [0, 0, 1]);
    assert_eq!(subscriber.lost(), 0);
}

pub fn a_late_joiner_hears_nothing_from_before(transport: Transport) {
    let stage = Stage::new(transport, "late");
    let (here, early) = (stage.join("here"), stage.join("early"));
    let mut publisher = here.publisher::<Imu>().unwrap();
    let mut first = early.subscriber::<Imu>(64).unwrap();
    until_heard(&here, &mut publisher);
    for step in 0..5 {
        publisher.send(&at(step)).unwrap();
        assert_eq!(next(&early, &mut first).head.step, step);
    }
    let late = stage.join("late");
    let mut second = late.subscriber::<Imu>(64).unwrap();
    // Over a network it takes a while until the publisher knows of the newcomer.
    let (mut step, mut heard) = (5, false);
    let patience = Instant::now() + PATIENCE;
    while !heard {
        assert!(Instant::now() < patience, "nothing within {PATIENCE:?}");
        publisher.send(&at(step)).unwrap();
        step += 1;
        // A flood would hold up the link that is just being made.
        let soon = Instant::now() + Duration::from_millis(1);
        heard = late
            .wait_until(soon, || {
                second.try_recv().map(|m| {
                    m.inspect(|imu| assert!(imu.head.step >= 5, "heard step {}", imu.head.step)).is_some()
                })
            })
            .unwrap();
    }
    assert_eq!(second.lost(), 0, "what came before does not count as lost");
}

pub fn a_full_queue_loses_the_oldest_and_counts(transport: Transport) {
    const DEPTH: usize = 8;
    const COUNT: u64 = 20;
    let stage = Stage::new(transport, "overflow");
    let (here, there) = (stage.join("here"), stage.join("there"));
    let mut small = there.subscriber::<Command>(DEPTH).unwrap();
    let mut large = there.subscriber::<Command>(2 * COUNT as usize).unwrap();
    let mut publisher = here.publisher::<Command>().unwrap();
    until_heard(&here, &mut publisher);
    // Knocks until both are connected; over a network that takes a while.
    let (mut knocks, mut heard) = (0, [false; 2]);
    while heard != [true; 2] {
        publisher.send(&at(1000)).unwrap();
        knocks += 1;
        let soon = Instant::now() + Duration::from_millis(1);
        there
            .wait_until(soon, || {
                heard[0] |= small.try_recv()?.is_some();
                heard[1] |= large.try_recv()?.is_some();
                Ok::<_, RecvError>(heard == [true; 2])
            })
            .unwrap();
    }
    publisher.send(&at(1000)).unwrap();
    while next(&there, &mut small).head.seq < knocks {}
    while next(&there, &mut large).head.seq < knocks {}
    let before = [small.lost(), large.lost()];
    for step in 0..COUNT {
        publisher.send(&at(step)).unwrap();
    }
    while next(&there, &mut large).head.step + 1 != COUNT {}
    let kept: Vec<u64> = (0..DEPTH).map(|_| next(&there, &mut small).head.step).collect();
    assert_eq!(kept, (COUNT - DEPTH as u64..COUNT).collect::<Vec<_>>());
    assert!(small.try_recv().unwrap().is_none());
    assert_eq!([small.lost() - before[0], large.lost() - before[1]], [COUNT - DEPTH as u64, 0]);
}

pub fn other_topics_of_the_same_type_are_apart(transport: Transport) {
    let stage = Stage::new(transport, "topics");
    let (here, there) = (stage.join("here"), stage.join("there"));
    let mut own = there.subscriber::<Disturbance>(8).unwrap();
    let mut inject = there.subscriber_on::<Disturbance>("inject", 8).unwrap();
    let mut publisher = here.publisher_on::<Disturbance>("inject").unwrap();
    until_heard(&here, &mut publisher);
    publisher.send(&at(7)).unwrap();
    assert_eq!(next(&there, &mut inject).head.step, 7);
    assert!(own.try_recv().unwrap().is_none());
}

pub fn two_benches_do_not_meet(transport: Transport) {
    let stage = Stage::new(transport, "one");
    let (here, there) = (stage.join("here"), stage.join("there"));
    let other = stage.neighbour("two");
    let (other_here, other_there) = (other.join("here"), other.join("there"));
    let mut subscriber = there.subscriber::<Imu>(256).unwrap();
    let mut other_subscriber = other_there.subscriber::<Imu>(256).unwrap();
    let mut publisher = here.publisher::<Imu>().unwrap();
    let mut other_publisher = other_here.publisher::<Imu>().unwrap();
    until_heard(&here, &mut publisher);
    until_heard(&other_here, &mut other_publisher);
    for step in 0..100 {
        publisher.send(&at(step)).unwrap();
        other_publisher.send(&at(1000 + step)).unwrap();
    }
    for step in 0..100 {
        assert_eq!(next(&there, &mut subscriber).head.step, step);
        assert_eq!(next(&other_there, &mut other_subscriber).head.step, 1000 + step);
    }
    if transport == Transport::Iceoryx2 {
        drop((subscriber, publisher, here, there));
        drop(stage);
        // The one is gone without a trace, the other goes on.
        other_publisher.send(&at(2000)).unwrap();
        assert_eq!(next(&other_there, &mut other_subscriber).head.step, 2000);
    }
}

pub fn waiting_ends_with_a_message_or_at_the_deadline(transport: Transport) {
    let stage = Stage::new(transport, "wait");
    let there = stage.join("there");
    let mut subscriber = there.subscriber::<Imu>(8).unwrap();

    let start = Instant::now();
    let wait = Duration::from_millis(30);
    let nothing = there.wait_until(start + wait, || subscriber.try_recv().map(|m| m.is_some())).unwrap();
    assert!(!nothing && start.elapsed() >= wait);
    assert!(there.wait_until(start, || Ok::<_, ()>(true)).unwrap(), "it looks once even after the deadline");
    assert_eq!(there.wait_until(start + PATIENCE, || Err::<bool, _>("broken")), Err("broken"));

    let config = stage.config("here");
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let here = Bus::open(&config).unwrap();
            let mut publisher = here.publisher::<Imu>().unwrap();
            let mut again = here.subscriber::<Progress>(8).unwrap();
            until_heard(&here, &mut publisher);
            for step in 0..200 {
                publisher.send(&at(step)).unwrap();
                while next(&here, &mut again).head.step != step {}
            }
        });
        let mut answers = there.publisher::<Progress>().unwrap();
        until_heard(&there, &mut answers);
        for step in 0..200 {
            assert_eq!(next(&there, &mut subscriber).head.step, step);
            answers.send(&at(step)).unwrap();
        }
    });
}

pub fn a_subscriber_that_left_is_not_missed(transport: Transport) {
    let stage = Stage::new(transport, "leave");
    let (here, there) = (stage.join("here"), stage.join("there"));
    let mut publisher = here.publisher::<Truth>().unwrap();
    for _ in 0..3 {
        let mut subscriber = there.subscriber::<Truth>(8).unwrap();
        until_heard(&here, &mut publisher);
        publisher.send(&at(1)).unwrap();
        assert_eq!(next(&there, &mut subscriber).head.step, 1);
        drop(subscriber);
        let gone = here
            .wait_until(Instant::now() + PATIENCE, || publisher.has_subscribers().map(|heard| !heard))
            .unwrap();
        assert!(gone);
        publisher.send(&at(2)).unwrap();
    }
}
