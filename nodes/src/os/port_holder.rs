//! Finds the process that holds a port, from the kernel's tables (proc_net(5), proc_pid_fd(5)).

use std::fs;
use std::io;
use std::net::SocketAddr;

/// Tables of the sockets of a protocol, over IPv4 and IPv6.
const TCP: [&str; 2] = ["/proc/net/tcp", "/proc/net/tcp6"];
const UDP: [&str; 2] = ["/proc/net/udp", "/proc/net/udp6"];

/// State of a TCP socket that listens.
const LISTENS: &str = "0A";

/// The error of a bind, with the process that holds the port where that is the reason and the process is of
/// this user.
pub(crate) fn with_holder(error: io::Error, at: SocketAddr, is_tcp: bool) -> io::Error {
    if error.kind() != io::ErrorKind::AddrInUse {
        return error;
    }
    let (port, tables) = (at.port(), if is_tcp { TCP } else { UDP });
    let sockets: Vec<String> = tables
        .iter()
        .flat_map(|table| fs::read_to_string(table).map(|t| sockets_on(&t, port, is_tcp)).unwrap_or_default())
        .collect();
    let who = match holder(&sockets) {
        Some((pid, name)) => format!("port {port} is held by process {pid} ({name})"),
        None => format!("port {port} is held by a process of another user"),
    };
    io::Error::new(io::ErrorKind::AddrInUse, format!("{who}: end it, or choose another port"))
}

/// Inode numbers of the sockets on a local port, from a table with a line for each socket: number, local
/// address as `HEX:PORT`, remote address, state, queues, timers, retransmissions, user, timeout, inode.
fn sockets_on(table: &str, port: u16, is_tcp: bool) -> Vec<String> {
    let inode = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let (_, local) = fields.get(1)?.rsplit_once(':')?;
        let is_it = u16::from_str_radix(local, 16).ok()? == port;
        let listens = !is_tcp || *fields.get(3)? == LISTENS;
        (is_it && listens).then(|| fields.get(9).map(ToString::to_string))?
    };
    table.lines().skip(1).filter_map(inode).collect()
}

/// Number and name of the process that has one of the sockets open.
fn holder(sockets: &[String]) -> Option<(u32, String)> {
    let targets: Vec<String> = sockets.iter().map(|inode| format!("socket:[{inode}]")).collect();
    let pids =
        fs::read_dir("/proc").ok()?.flatten().filter_map(|e| e.file_name().to_str()?.parse::<u32>().ok());
    let has_it = |pid: &u32| {
        // Processes of other users cannot be inspected.
        let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        open.filter_map(|fd| fs::read_link(fd.path()).ok())
            .any(|target| targets.iter().any(|socket| target.as_os_str() == socket.as_str()))
    };
    let pid = pids.into_iter().find(has_it)?;
    let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    Some((pid, name.trim().to_string()))
}

#[cfg(test)]
mod tests {
    use std::net::{TcpListener, UdpSocket};

    use super::*;

    #[test]
    fn who_holds_a_port_is_named() {
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        let tcp = TcpListener::bind("127.0.0.1:0").unwrap();
        let own = format!("process {} (", std::process::id());
        for (at, is_tcp) in [(udp.local_addr().unwrap(), false), (tcp.local_addr().unwrap(), true)] {
            let error = with_holder(io::ErrorKind::AddrInUse.into(), at, is_tcp).to_string();
            assert!(error.contains(&own) && error.contains(&at.port().to_string()), "{error}");
            let other = with_holder(io::ErrorKind::PermissionDenied.into(), at, is_tcp);
            assert_eq!(other.kind(), io::ErrorKind::PermissionDenied);
        }
    }

    #[test]
    fn only_the_local_port_and_only_who_listens_count() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n\
                     0: 0100007F:38D6 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1000 0 4711 1\n\
                     1: 0100007F:38D6 0100007F:9C40 01 00000000:00000000 00:00000000 00000000  1000 0 4712 1\n\
                     2: 0100007F:9C40 0100007F:38D6 01 00000000:00000000 00:00000000 00000000  1000 0 4713 1\n\
                     3: damaged\n";
        assert_eq!(sockets_on(table, 14550, true), ["4711"]);
        assert_eq!(sockets_on(table, 14550, false), ["4711", "4712"]);
    }
}
