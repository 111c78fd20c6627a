//! The vehicle side of a MAVLink link, and the launch file of the bridge to it.

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::Running;
use super::bridged::Bridged;

/// Rate of these links, Hz. At 250 Hz the autopilot, which is a program in Python, takes most of a slow processor, and what
/// is seen is its lateness.
pub const RATE_HZ: u32 = 100;

/// A UDP port that no process uses.
pub fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

pub fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge").join(name)
}

/// The autopilot alone, talking to the bridge at `port`.
pub fn autopilot(python: &Path, port: u16, report: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(python);
    command.arg(script("autopilot.py")).args(["--link", &format!("udpout:127.0.0.1:{port}")]);
    command.arg("--report").arg(report).args(more);
    command
}

/// A launch file with the bridge in the plant's place.
pub fn launch(dir: &Path, port: u16, more: &str) -> PathBuf {
    let bridged = Bridged {
        bridge: "mavlink",
        vehicle: "quadrotor",
        rate_hz: RATE_HZ,
        duration_s: 6,
        safety: "arm = \"autopilot\"",
        link: format!("udpin://127.0.0.1:{port}"),
        more,
    };
    bridged.write(dir)
}

/// The autopilot writes its report when it is asked to end.
pub fn end(running: Running) {
    running.signal(libc::SIGTERM);
    running.finish().success();
}
