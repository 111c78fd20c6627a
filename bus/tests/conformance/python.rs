//! The Python examples read `Estimate` and answer with `Command`, with the public packages of the two transports.

use std::io::Read;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Child, Command as Process, Stdio};

use whirlstand_bus::Transport;
use whirlstand_msgs::{Command, Estimate};
use whirlstand_test_harness::{Outcome, python_with};

use crate::stage::{PATIENCE, Stage, at, next, until_heard};

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts an example as the launcher would, and plays plant and estimator to it.
fn plays_the_controller(transport: Transport, package: &str, script: &str) -> Outcome {
    let python = python_with(package)?;
    let stage = Stage::new(transport, "python");
    let bus = stage.join("here");
    let mut commands = bus.subscriber::<Command>(64).unwrap();
    let mut estimates = bus.publisher::<Estimate>().unwrap();

    let notify = std::env::temp_dir().join(format!("{}.notify", stage.name));
    let ready = UnixDatagram::bind(&notify).unwrap();
    ready.set_read_timeout(Some(PATIENCE)).unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/python");
    let child = Process::new(python)
        .arg(folder.join(script))
        .args(["--control", "--every", "1"])
        .env("WHIRLSTAND_BENCH", &stage.name)
        .env("WHIRLSTAND_NODE", "controller")
        .env("WHIRLSTAND_TRANSPORT", transport.to_string())
        .env("WHIRLSTAND_ZENOH_CONNECT", bus.locators().join(","))
        .env("NOTIFY_SOCKET", &notify)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut child = Killed(child);
    let mut datagram = [0; 64];
    let length = ready.recv(&mut datagram).expect("READY=1 on the notification socket");
    std::fs::remove_file(&notify).unwrap();
    assert!(datagram[..length].starts_with(b"READY=1"));

    until_heard(&bus, &mut estimates);
    for step in 10..60 {
        let mut estimate: Estimate = at(step);
        estimate.head.stamp_ns = step * 5_000_000;
        estimate.count = 4;
        estimate.x[..4].copy_from_slice(&[0.001 * step as f64, -0.002, 0.003, 0.1]);
        estimates.send(&estimate).unwrap();
        let command = next(&bus, &mut commands);
        assert_eq!((command.head.step, command.head.stamp_ns, command.count), (step, step * 5_000_000, 2));
        assert_eq!(command.head.seq, step - 10);
        let x = &estimate.x;
        let u = -(-300.0 * x[0] - 202.0 * x[1] - 90.0 * x[2] - 15.0 * x[3]);
        assert!((command.u[0] - u.clamp(-20.0, 20.0)).abs() < 1e-9, "{} is not {u}", command.u[0]);
    }
    assert_eq!(commands.lost(), 0);

    // SAFETY: the child is ours and not yet reaped, so the number is its own.
    unsafe { libc::kill(child.0.id() as libc::pid_t, libc::SIGTERM) };
    let mut output = String::new();
    child.0.stdout.take().unwrap().read_to_string(&mut output).unwrap();
    assert!(child.0.wait().unwrap().success());
    assert!(output.contains("step 59  t 0.295 s  x +0.05900"), "{output}");
    Ok(())
}

pub fn over_zenoh() -> Outcome {
    plays_the_controller(Transport::Zenoh, "zenoh", "estimate_zenoh.py")
}

pub fn over_iceoryx2() -> Outcome {
    plays_the_controller(Transport::Iceoryx2, "iceoryx2", "estimate_iceoryx2.py")
}
