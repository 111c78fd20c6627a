//! What killed processes leave in shared memory is removed, and nothing else.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::time::Duration;

use whirlstand_bus::{Residue, Transport, remove_residue, stale_benches};
use whirlstand_msgs::{Imu, Progress};

use crate::faults::{sensor, sleeper};
use crate::stage::{Stage, at, leftovers, next, until_heard};

pub fn nothing_is_left_of_killed_nodes() {
    let neighbour = Stage::new(Transport::Iceoryx2, "residue-n");
    let bus = neighbour.join("here");
    let mut publisher = bus.publisher::<Imu>().unwrap();
    let mut subscriber = bus.subscriber::<Imu>(4).unwrap();

    let stage = Stage::new(Transport::Iceoryx2, "residue");
    let mut peers = [stage.spawn("sensor", sensor), stage.spawn("sleeper", sleeper)];
    {
        // Both are there and at work.
        let here = stage.join("here");
        next(&here, &mut here.subscriber::<Imu>(4).unwrap());
        next(&here, &mut here.subscriber::<Progress>(4).unwrap());
    }
    for peer in &mut peers {
        peer.kill();
    }
    assert_ne!(leftovers(&stage.name), Vec::<String>::new(), "or this test shows nothing");
    let residue = remove_residue(&stage.name).unwrap();
    assert!(residue.removed > 0 && !residue.in_use, "{residue:?}");
    assert_eq!(leftovers(&stage.name), Vec::<String>::new());
    assert_eq!(remove_residue(&stage.name).unwrap(), Residue { removed: 1, in_use: false });

    until_heard(&bus, &mut publisher);
    publisher.send(&at(3)).unwrap();
    assert_eq!(next(&bus, &mut subscriber).head.step, 3);
}

pub fn what_is_in_use_stays() {
    let stage = Stage::new(Transport::Iceoryx2, "in-use");
    let bus = stage.join("here");
    let mut publisher = bus.publisher::<Imu>().unwrap();
    let mut subscriber = bus.subscriber::<Imu>(4).unwrap();
    let mut peer = stage.spawn("sleeper", sleeper);
    next(&bus, &mut bus.subscriber::<Progress>(4).unwrap());
    peer.kill();
    assert!(remove_residue(&stage.name).unwrap().in_use);
    publisher.send(&at(1)).unwrap();
    assert_eq!(next(&bus, &mut subscriber).head.step, 1);
    // Its name begins with that of the other bench, which is not the same.
    let longer = format!("{}-2", stage.name);
    remove_residue(&longer).unwrap();
    publisher.send(&at(2)).unwrap();
    assert_eq!(next(&bus, &mut subscriber).head.step, 2);
}

pub fn whoever_leaves_last_clears_up() {
    let stage = Stage::new(Transport::Iceoryx2, "last");
    let (first, last) = (stage.join("first"), stage.join("last"));
    let publisher = last.publisher::<Imu>().unwrap();
    drop(first);
    assert_ne!(leftovers(&stage.name), Vec::<String>::new());
    drop(last);
    assert_ne!(leftovers(&stage.name), Vec::<String>::new(), "the publisher still holds the bench");
    drop(publisher);
    assert_eq!(leftovers(&stage.name), Vec::<String>::new());
}

pub fn a_node_killed_while_it_joins_leaves_a_usable_bench() {
    let stage = Stage::new(Transport::Iceoryx2, "joining");
    for attempt in 0..20 {
        let mut peer = stage.spawn("sensor", sensor);
        // Not a wait for anything: the moment of death sweeps over the start of the process.
        std::thread::sleep(Duration::from_micros(500 * attempt));
        peer.kill();
        if attempt % 5 == 4 {
            let bus = stage.join("here");
            let mut publisher = bus.publisher::<Imu>().unwrap();
            let mut subscriber = bus.subscriber::<Imu>(4).unwrap();
            until_heard(&bus, &mut publisher);
            publisher.send(&at(attempt)).unwrap();
            assert_eq!(next(&bus, &mut subscriber).head.step, attempt);
        }
    }
    remove_residue(&stage.name).unwrap();
    assert_eq!(leftovers(&stage.name), Vec::<String>::new());
}

pub fn a_stale_bench_is_told_and_a_live_one_is_not() {
    let live = Stage::new(Transport::Iceoryx2, "live");
    let bus = live.join("here");
    let left = Stage::new(Transport::Iceoryx2, "left");
    let mut peer = left.spawn("sensor", sensor);
    {
        let here = left.join("here");
        next(&here, &mut here.subscriber::<Imu>(4).unwrap());
    }
    assert!(stale_benches().unwrap().iter().all(|b| b.bench != left.name), "its sensor is at work");
    peer.kill();
    let stale = stale_benches().unwrap();
    let found = stale.iter().find(|b| b.bench == left.name).unwrap_or_else(|| panic!("{stale:?}"));
    assert!(found.files > 3 && found.bytes > 100_000, "{found:?}");
    assert!(found.since.elapsed().unwrap() < Duration::from_secs(60), "{found:?}");
    assert!(!leftovers(&left.name).is_empty(), "a look changes nothing");
    remove_residue(&left.name).unwrap();
    let stale = stale_benches().unwrap();
    assert!(stale.iter().all(|b| b.bench != left.name && b.bench != live.name), "{stale:?}");
    drop(bus);
}

pub fn the_pages_of_a_segment_are_taken_when_it_is_made() {
    let stage = Stage::new(Transport::Iceoryx2, "pages");
    let bus = stage.join("here");
    let _publisher = bus.publisher::<Imu>().unwrap();
    let _subscriber = bus.subscriber::<Imu>(4).unwrap();
    let prefix = format!("whirlstand.{}~", stage.name);
    let files: Vec<_> = std::fs::read_dir("/dev/shm")
        .unwrap()
        .flatten()
        .filter(|e| e.file_name().to_string_lossy().starts_with(&prefix))
        .collect();
    let of_kind = |end: &str| files.iter().filter(|e| e.file_name().to_string_lossy().ends_with(end)).count();
    assert_eq!((of_kind(".data"), of_kind(".global_mgmt"), of_kind("park")), (1, 1, 1), "{files:?}");
    for file in files {
        let metadata = file.metadata().unwrap();
        assert!(metadata.blocks() * 512 >= metadata.len(), "{file:?}: not all pages are taken");
        assert_eq!(metadata.permissions().mode() & 0o777, 0o600, "{file:?}");
    }
    let root = std::fs::metadata(format!("/tmp/whirlstand.{}", stage.name)).unwrap();
    assert_eq!(root.permissions().mode() & 0o777, 0o700);
}
