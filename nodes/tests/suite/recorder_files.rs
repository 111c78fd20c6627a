//! How many files a recorder begins, whoever publishes.

use std::time::Instant;

use whirlstand_bus::{Bus, BusConfig, Transport};
use whirlstand_msgs::{Message, Truth};
use whirlstand_nodes::config::RecorderConfig;
use whirlstand_nodes::recorder::Recorder;
use whirlstand_nodes::setup::Setup;

use crate::common;

#[test]
fn truth_that_goes_back_begins_no_more_files_than_the_plant_has_starts() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = common::config("forged-truth", 100);
    config.recorder = Some(RecorderConfig {
        path: folder.path().join("log.mcap").to_string_lossy().into_owned(),
        most_runs: 3,
        ..RecorderConfig::default()
    });
    let setup = Setup::new(&config).unwrap();
    let bus = Bus::open(&BusConfig::new(&config.bench, "rig", Transport::Inproc)).unwrap();
    let mut recorder = Recorder::open(&bus, &config, &setup).unwrap();
    let mut forger = bus.publisher::<Truth>().unwrap();
    for _ in 0..260 {
        for step in [5, 0] {
            let mut truth = <Truth as Message>::zeroed();
            truth.head.step = step;
            forger.send(&truth).unwrap();
        }
        recorder.turn(Instant::now()).unwrap();
    }
    assert_eq!(recorder.paths().len(), 3);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    // 260 went back; two of them began a file.
    assert_eq!(recorder.health().rejected, 258);
}
