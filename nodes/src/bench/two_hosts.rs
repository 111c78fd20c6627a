//! Two hosts emulated on one machine by network namespaces with a virtual cable. Requires iproute2 and root.

use std::process::Command;

/// Two connected network namespaces with an address each, removed on drop.
pub(super) struct TwoHosts {
    names: [String; 2],
}

/// Addresses of the hosts, from the block reserved for documentation.
const ADDRESSES: [&str; 2] = ["192.0.2.1", "192.0.2.2"];

impl TwoHosts {
    /// Creates the two namespaces.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn new() -> Result<Self, String> {
        let id = std::process::id();
        let hosts = Self { names: ["a", "b"].map(|end| format!("whirlbench{id}{end}")) };
        let [a, b] = &hosts.names;
        let cables = ["a", "b"].map(|end| format!("wb{id}{end}"));
        ip(&["netns", "add", a])?;
        ip(&["netns", "add", b])?;
        let [at_a, at_b] = &cables;
        ip(&["link", "add", at_a, "netns", a, "type", "veth", "peer", "name", at_b, "netns", b])?;
        for ((name, cable), address) in hosts.names.iter().zip(&cables).zip(ADDRESSES) {
            ip(&["-n", name, "addr", "add", &format!("{address}/24"), "dev", cable])?;
            ip(&["-n", name, "link", "set", cable, "up"])?;
            ip(&["-n", name, "link", "set", "lo", "up"])?;
        }
        Ok(hosts)
    }

    /// A program on one of the hosts.
    pub fn on(&self, host: usize, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[host], program]);
        command
    }

    /// Endpoint of a host over TCP.
    pub fn endpoint(host: usize) -> String {
        format!("tcp/{}:7447", ADDRESSES[host])
    }
}

impl Drop for TwoHosts {
    fn drop(&mut self) {
        for name in &self.names {
            // Namespaces that were not created cannot be removed.
            let _ = Command::new("ip").args(["netns", "del", name]).output();
        }
    }
}

fn ip(arguments: &[&str]) -> Result<(), String> {
    let done = Command::new("ip").args(arguments).output().map_err(|e| format!("no ip (iproute2): {e}"))?;
    if done.status.success() {
        return Ok(());
    }
    Err(format!("ip {}: {}", arguments.join(" "), String::from_utf8_lossy(&done.stderr).trim()))
}
