//! Whoever speaks another version is refused, and told why.

use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use whirlstand_bus::{Bus, Carried, MAX_DEPTH, OpenError, RecvError, Transport};
use whirlstand_msgs::{Field, Head, Imu, Message};

use crate::stage::{PATIENCE, Stage, at, next, until_heard};

/// The inertial measurement of another time: same topic, same name, same size, other meaning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Pod, Zeroable)]
#[repr(C)]
struct OldImu {
    head: Head,
    angles_in_degrees: [f64; 6],
    valid: u32,
    reserved: u32,
}

/// One more of another size.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Pod, Zeroable)]
#[repr(C)]
struct SmallImu {
    head: Head,
    roll: f64,
}

macro_rules! imu_of_another_time {
    ($type:ident, $schema:literal) => {
        impl Message for $type {
            const TOPIC: &'static str = Imu::TOPIC;
            const TYPE_NAME: &'static str = Imu::TYPE_NAME;
            const SCHEMA: &'static str = $schema;
            const FIELDS: &'static [Field] = &[];

            fn head(&self) -> &Head {
                &self.head
            }

            fn head_mut(&mut self) -> &mut Head {
                &mut self.head
            }
        }

        whirlstand_bus::carried!($type);
    };
}

imu_of_another_time!(OldImu, "Head head\nfloat64[6] angles_in_degrees\nuint32 valid\nuint32 reserved\n");
imu_of_another_time!(SmallImu, "Head head\nfloat64 roll\n");

fn is_clear<M: Message>(error: &str) {
    for part in [
        "topic \"imu\"",
        &format!("{:#018x}", M::SCHEMA_HASH),
        &format!("{:#018x}", Imu::SCHEMA_HASH),
        "same message version",
    ] {
        assert!(error.replace("topic imu", "topic \"imu\"").contains(part), "{part:?} is not in: {error}");
    }
}

pub fn another_version_of_a_message_is_refused(transport: Transport) {
    assert_eq!(size_of::<OldImu>(), size_of::<Imu>());
    let stage = Stage::new(transport, "version");
    let (here, there) = (stage.join("here"), stage.join("there"));
    let mut subscriber = here.subscriber::<Imu>(8).unwrap();
    if transport == Transport::Zenoh {
        refused_on_arrival::<OldImu>(&here, &there, &mut subscriber);
        refused_on_arrival::<SmallImu>(&here, &there, &mut subscriber);
    } else {
        refused_on_opening::<OldImu>(&there);
        refused_on_opening::<SmallImu>(&there);
    }
    // The right version goes on.
    let mut publisher = there.publisher::<Imu>().unwrap();
    until_heard(&there, &mut publisher);
    publisher.send(&at(5)).unwrap();
    assert_eq!(next(&here, &mut subscriber).head.step, 5);
}

fn refused_on_opening<M: Carried>(there: &Bus) {
    for error in [there.publisher::<M>().err(), there.subscriber::<M>(8).err()] {
        let error = error.unwrap();
        assert!(matches!(error, OpenError::Schema { .. }), "{error}");
        is_clear::<M>(&error.to_string());
    }
}

fn refused_on_arrival<M: Carried>(here: &Bus, there: &Bus, subscriber: &mut whirlstand_bus::Subscriber<Imu>) {
    let mut publisher = there.publisher::<M>().unwrap();
    until_heard(there, &mut publisher);
    publisher.send(&at(5)).unwrap();
    let error = here
        .wait_until(Instant::now() + PATIENCE, || subscriber.try_recv().map(|m| m.is_some()))
        .unwrap_err();
    assert!(matches!(error, RecvError::Refused { .. }), "{error}");
    is_clear::<M>(&error.to_string());
}

pub fn impossible_names_and_depths_are_refused(transport: Transport) {
    let stage = Stage::new(transport, "names");
    let mut config = stage.config("here");
    config.bench = "a/b".into();
    assert!(matches!(Bus::open(&config), Err(OpenError::Name { what: "bench", .. })));
    let config = stage.config("no such * node");
    assert!(matches!(Bus::open(&config), Err(OpenError::Name { what: "node", .. })));
    let bus = stage.join("here");
    for depth in [0, MAX_DEPTH + 1] {
        let error = bus.subscriber::<Imu>(depth).err().unwrap();
        assert!(matches!(error, OpenError::Depth { .. }), "{error}");
        assert!(error.to_string().contains(&depth.to_string()), "{error}");
    }
    assert!(matches!(bus.subscriber_on::<Imu>("a/*", 1), Err(OpenError::Name { what: "topic", .. })));
    assert!(matches!(bus.publisher_on::<Imu>("",), Err(OpenError::Name { what: "topic", .. })));
    bus.subscriber::<Imu>(MAX_DEPTH).unwrap();
}
