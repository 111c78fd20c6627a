//! Zenoh's own configuration file reaches Zenoh, and its faults are told.

use std::io::Write;
use std::path::PathBuf;

use whirlstand_bus::{Bus, BusConfig, OpenError, Transport};
use whirlstand_msgs::{Command, Imu};

use crate::stage::{Stage, at, next, until_heard};

/// A configuration file that is gone at the end.
struct ConfigFile(PathBuf);

impl ConfigFile {
    fn new(name: &str, content: &str) -> Self {
        let path = std::env::temp_dir().join(format!("ws-{name}-{}.json5", std::process::id()));
        std::fs::File::create(&path).unwrap().write_all(content.as_bytes()).unwrap();
        Self(path)
    }
}

impl Drop for ConfigFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

pub fn access_control_of_the_configuration_file_is_obeyed() {
    let file = ConfigFile::new(
        "access",
        r#"{
            // Nobody may send commands to this node.
            access_control: {
                enabled: true,
                default_permission: "allow",
                rules: [{
                    id: "no commands", permission: "deny", messages: ["put"], flows: ["ingress"],
                    key_exprs: ["whirlstand/*/command"],
                }],
                subjects: [{ id: "anybody" }],
                policies: [{ rules: ["no commands"], subjects: ["anybody"] }],
            },
        }"#,
    );
    let stage = Stage::new(Transport::Zenoh, "access");
    let there = stage.join("there");
    let mut config = stage.config("guarded");
    config.zenoh.config = Some(file.0.clone());
    let guarded = Bus::open(&config).unwrap();
    assert!(guarded.locators()[0].starts_with("tcp/127.0.0.1:"), "the file does not replace the defaults");

    let mut commands = guarded.subscriber::<Command>(8).unwrap();
    let mut imus = guarded.subscriber::<Imu>(8).unwrap();
    let mut forbidden = there.publisher::<Command>().unwrap();
    let mut allowed = there.publisher::<Imu>().unwrap();
    until_heard(&there, &mut forbidden);
    until_heard(&there, &mut allowed);
    for step in 0..3 {
        forbidden.send(&at(step)).unwrap();
        allowed.send(&at(step)).unwrap();
        // One link, one order: a command would have come first.
        assert_eq!(next(&guarded, &mut imus).head.step, step);
        assert!(commands.try_recv().unwrap().is_none());
    }
}

pub fn endpoints_are_told_and_faults_are_named() {
    let mut config = BusConfig::new("settings", "here", Transport::Zenoh);
    config.zenoh.listen = vec!["tcp/127.0.0.1:0".into(), "tcp/[::1]:0#so_sndbuf=65000".into()];
    match Bus::open(&config) {
        Ok(bus) => {
            assert_eq!(bus.locators().len(), 2);
            assert!(bus.locators()[1].ends_with("#so_sndbuf=65000"), "{:?}", bus.locators());
            assert!(bus.locators().iter().all(|l| !l.contains(":0")), "{:?}", bus.locators());
        }
        // A machine without IPv6 cannot listen on it, and must say so.
        Err(error) => assert!(error.to_string().contains("settings"), "{error}"),
    }

    let broken = ConfigFile::new("broken", "{ transport: ");
    let unknown = ConfigFile::new("unknown", r#"{ transport: { "no such key": 1 } }"#);
    let list = ConfigFile::new("list", "[1, 2]");
    for file in [&broken, &unknown, &list] {
        let mut config = BusConfig::new("settings", "here", Transport::Zenoh);
        config.zenoh.config = Some(file.0.clone());
        let error = Bus::open(&config).err().unwrap();
        assert!(matches!(error, OpenError::ZenohConfig { .. }), "{error}");
        assert!(error.to_string().contains(&file.0.display().to_string()), "{error}");
    }
    let mut config = BusConfig::new("settings", "here", Transport::Zenoh);
    config.zenoh.config = Some("/no/such/file.json5".into());
    let error = Bus::open(&config).err().unwrap();
    assert!(
        matches!(error, OpenError::File { .. }) && error.to_string().contains("/no/such/file"),
        "{error}"
    );
}

pub fn a_bench_has_one_launcher_at_a_time() {
    let stage = Stage::new(Transport::Zenoh, "launchers");
    let (first, second) = (stage.join("launcher"), stage.join("launcher"));
    let token = first.announce_launcher().unwrap();
    let error = second.announce_launcher().unwrap_err();
    let process = format!("process {} on host ", std::process::id());
    assert!(matches!(&error, OpenError::Taken { holder, .. } if holder.starts_with(&process)), "{error}");
    assert!(error.to_string().contains(&stage.name), "{error}");

    let other = stage.neighbour("launchers").join("launcher");
    let _elsewhere = other.announce_launcher().unwrap();
    drop(token);
    let _token = second.announce_launcher().unwrap();
}
