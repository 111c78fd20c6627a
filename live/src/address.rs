//! The address of the page, and its token.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use rand::RngExt;

/// The port that is tried first where the address states none.
pub const DEFAULT_PORT: u16 = 8480;

/// Characters of a token: 22 characters of 64 kinds are 132 bits.
const TOKEN_LENGTH: usize = 22;
const TOKEN_LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";

/// The reason why an address is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not an address: write a port, IP, IP:PORT or [IP]:PORT, such as 8480 or 192.0.2.2:8480")]
pub struct AddressError(String);

/// The address at which a page is served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Address {
    /// IP address and port; port 0 stands for any free one.
    pub socket: SocketAddr,
    /// Whether the port was not stated, so that another one may be used.
    pub any_port: bool,
}

impl Default for Address {
    fn default() -> Self {
        Self::on_this_machine(DEFAULT_PORT)
    }
}

/// A random text that cannot be guessed.
pub(crate) fn secret() -> String {
    let mut random = rand::rng();
    let letter = |_| char::from(TOKEN_LETTERS[random.random_range(0..TOKEN_LETTERS.len())]);
    (0..TOKEN_LENGTH).map(letter).collect()
}

impl Address {
    /// A new token for access from other machines; `None` for an address on loopback, which needs none.
    pub(crate) fn token(&self) -> Option<String> {
        (!self.socket.ip().is_loopback()).then(secret)
    }

    /// A loopback address with a port that is tried first.
    fn on_this_machine(port: u16) -> Self {
        Self { socket: SocketAddr::new(Ipv4Addr::LOCALHOST.into(), port), any_port: true }
    }

    /// Reads an address. `first_port` is tried first where the text states no port.
    ///
    /// # Errors
    /// When the text is not an address.
    pub fn parse(text: &str, first_port: u16) -> Result<Self, AddressError> {
        let bare = text.trim();
        if bare.is_empty() {
            return Ok(Self::on_this_machine(first_port));
        }
        if let Ok(socket) = bare.parse() {
            return Ok(Self { socket, any_port: false });
        }
        if let Ok(ip) = bare.trim_matches(['[', ']']).parse::<IpAddr>() {
            return Ok(Self { socket: SocketAddr::new(ip, first_port), any_port: true });
        }
        let port = bare.trim_start_matches("localhost").trim_start_matches(':').parse::<u16>();
        let port = port.map_err(|_| AddressError(text.into()))?;
        Ok(Self { socket: SocketAddr::new(Ipv4Addr::LOCALHOST.into(), port), any_port: false })
    }
}

impl std::str::FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        Self::parse(text, DEFAULT_PORT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_only_those_beyond_this_machine_have_a_token() {
        for (text, socket, any_port) in [
            ("", "127.0.0.1:8480", true),
            ("0", "127.0.0.1:0", false),
            ("localhost:9000", "127.0.0.1:9000", false),
            ("192.0.2.2", "192.0.2.2:8480", true),
            ("[::1]:81", "[::1]:81", false),
            ("::", "[::]:8480", true),
        ] {
            let address: Address = text.parse().unwrap();
            assert_eq!((address.socket.to_string().as_str(), address.any_port), (socket, any_port), "{text}");
            assert_eq!(address.token().is_none(), address.socket.ip().is_loopback(), "{text}");
        }
        let everywhere: Address = "0.0.0.0".parse().unwrap();
        let tokens = [everywhere.token().unwrap(), everywhere.token().unwrap()];
        assert!(tokens[0] != tokens[1] && tokens[0].len() == TOKEN_LENGTH);
        for text in ["here", "1.2.3.4:x", "99999"] {
            assert!(text.parse::<Address>().unwrap_err().to_string().contains(text));
        }
    }
}
