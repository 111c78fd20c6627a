//! Notifies the launcher that the ports are open, as systemd services do (`sd_notify(3)`).

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Sends `READY=1` to the datagram socket in `NOTIFY_SOCKET`, with one `X_LOCATOR=...` line for each address
/// on which peers can reach this node. Without `NOTIFY_SOCKET` nothing happens.
///
/// # Errors
/// The socket named by `NOTIFY_SOCKET` cannot be reached.
pub fn notify_ready(locators: &[String]) -> std::io::Result<()> {
    let Some(path) = std::env::var_os("NOTIFY_SOCKET") else { return Ok(()) };
    let mut text = String::from("READY=1\n");
    for locator in locators {
        text.push_str("X_LOCATOR=");
        text.push_str(locator);
        text.push('\n');
    }
    send(path.as_encoded_bytes(), text.as_bytes())
}

/// Sends this node's status to the socket in `NOTIFY_SOCKET` (`STATUS=`); an empty text clears it. False
/// without such a socket.
pub fn notify_status(text: &str) -> bool {
    let Some(path) = std::env::var_os("NOTIFY_SOCKET") else { return false };
    send(path.as_encoded_bytes(), format!("STATUS={text}\n").as_bytes()).is_ok()
}

fn send(path: &[u8], bytes: &[u8]) -> std::io::Result<()> {
    use std::os::unix::ffi::OsStrExt;
    // A leading @ stands for the abstract namespace, which has no file.
    let address = match path.strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name)?,
        None => SocketAddr::from_pathname(std::ffi::OsStr::from_bytes(path))?,
    };
    UnixDatagram::unbound()?.send_to_addr(bytes, &address).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_of_socket_hear_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let file = UnixDatagram::bind(&path).unwrap();
        send(path.as_os_str().as_encoded_bytes(), b"READY=1\n").unwrap();
        let name = format!("whirlstand-notify-test-{}", std::process::id());
        let hidden =
            UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(name.as_bytes()).unwrap()).unwrap();
        send(format!("@{name}").as_bytes(), b"READY=1\n").unwrap();
        for socket in [file, hidden] {
            let mut buffer = [0; 64];
            let n = socket.recv(&mut buffer).unwrap();
            assert_eq!(&buffer[..n], b"READY=1\n");
        }
        assert!(send(b"/nowhere/at/all", b"x").is_err());
    }
}
