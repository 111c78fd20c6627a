//! Address of a link.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

/// Address of the other end of a link.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// A serial port.
    Serial {
        /// Path of the device.
        path: PathBuf,
        /// Baud rate; any rate that the port supports.
        baud: u32,
        /// True for 8E2, as for SBUS; otherwise 8N1.
        even_two: bool,
    },
    /// UDP socket bound to this address; the first sender of something valid is the peer.
    UdpIn(SocketAddr),
    /// UDP to this address; answers come from there.
    UdpOut(SocketAddr),
    /// TCP server for one client at a time.
    TcpIn(SocketAddr),
    /// TCP client of this address.
    TcpOut(SocketAddr),
}

/// The text is not a valid address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{text}' is not a link address: {reason}; serial:///dev/ttyACM0:921600, serial:///dev/ttyUSB0:100000:8E2, \
     udpin://0.0.0.0:14550, udpout://192.0.2.7:14550, tcpin://127.0.0.1:5760 or tcpout://127.0.0.1:5760 is expected"
)]
pub struct AddressError {
    text: String,
    reason: String,
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let fail = |reason: String| AddressError { text: text.into(), reason };
        let (scheme, rest) = text.split_once("://").ok_or_else(|| fail("it has no ://".into()))?;
        if scheme == "serial" {
            return serial(rest).map_err(fail);
        }
        let socket = |rest: &str| {
            rest.parse().map_err(|_| fail(format!("'{rest}' is not a numeric address with a port")))
        };
        match scheme {
            "udpin" => socket(rest).map(Self::UdpIn),
            "udpout" => socket(rest).map(Self::UdpOut),
            "tcpin" => socket(rest).map(Self::TcpIn),
            "tcpout" => socket(rest).map(Self::TcpOut),
            other => Err(fail(format!("there is no '{other}'"))),
        }
    }
}

fn serial(rest: &str) -> Result<Address, String> {
    let (rest, even_two) = match rest.strip_suffix(":8E2") {
        Some(rest) => (rest, true),
        None => (rest.strip_suffix(":8N1").unwrap_or(rest), false),
    };
    let (path, baud) = rest.rsplit_once(':').ok_or_else(|| "it has no baud rate".to_string())?;
    let baud = baud.parse().ok().filter(|b| *b > 0).ok_or_else(|| format!("'{baud}' is not a baud rate"))?;
    if !path.starts_with('/') {
        return Err(format!("'{path}' is not an absolute path"));
    }
    Ok(Address::Serial { path: path.into(), baud, even_two })
}

impl Address {
    /// True when anybody can connect, so that a peer may be pinned.
    pub fn is_open(&self) -> bool {
        matches!(self, Self::UdpIn(_) | Self::TcpIn(_))
    }

    /// Text of the endpoint on which the peer is awaited: `tcp 4560`, `udp 192.0.2.7:14550`, `/dev/ttyACM0`.
    pub fn place(&self) -> String {
        match self {
            Self::Serial { path, .. } => path.display().to_string(),
            Self::UdpIn(at) => format!("udp {}", at.port()),
            Self::TcpIn(at) => format!("tcp {}", at.port()),
            Self::UdpOut(at) => format!("udp {at}"),
            Self::TcpOut(at) => format!("tcp {at}"),
        }
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Serial { path, baud, even_two } => {
                write!(f, "serial://{}:{baud}{}", path.display(), if *even_two { ":8E2" } else { "" })
            }
            Self::UdpIn(at) => write!(f, "udpin://{at}"),
            Self::UdpOut(at) => write!(f, "udpout://{at}"),
            Self::TcpIn(at) => write!(f, "tcpin://{at}"),
            Self::TcpOut(at) => write!(f, "tcpout://{at}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_written() {
        for text in [
            "serial:///dev/ttyACM0:921600",
            "serial:///dev/ttyUSB0:100000:8E2",
            "udpin://0.0.0.0:14550",
            "udpout://127.0.0.1:14550",
            "tcpin://127.0.0.1:5760",
            "tcpout://[::1]:5760",
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn a_place_says_where_to_come_or_where_it_is() {
        let place = |text: &str| text.parse::<Address>().unwrap().place();
        assert_eq!(place("tcpin://0.0.0.0:4560"), "tcp 4560");
        assert_eq!(place("udpout://192.0.2.7:14550"), "udp 192.0.2.7:14550");
        assert_eq!(place("serial:///dev/ttyACM0:921600"), "/dev/ttyACM0");
    }

    #[test]
    fn mistakes_are_told_with_what_is_expected() {
        for (text, word) in [
            ("/dev/ttyACM0", "://"),
            ("serial:///dev/ttyACM0", "baud"),
            ("serial:///dev/ttyACM0:fast", "'fast'"),
            ("serial://ttyACM0:57600", "absolute"),
            ("udpin://localhost:14550", "numeric"),
            ("udp://0.0.0.0:14550", "'udp'"),
        ] {
            let error = text.parse::<Address>().unwrap_err().to_string();
            assert!(error.contains(word) && error.contains("udpin://0.0.0.0:14550"), "{error}");
        }
    }
}
