//! The transports by name.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Transport of the messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// Shared memory between processes of one machine.
    #[default]
    Iceoryx2,
    /// TCP, TLS or UDP between processes of any machines.
    Zenoh,
    /// Between threads, or within one thread, of one process.
    Inproc,
}

impl Transport {
    /// Every transport.
    pub const ALL: [Self; 3] = [Self::Iceoryx2, Self::Zenoh, Self::Inproc];
}

impl fmt::Display for Transport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Iceoryx2 => "iceoryx2",
            Self::Zenoh => "zenoh",
            Self::Inproc => "inproc",
        })
    }
}

impl FromStr for Transport {
    type Err = UnknownTransport;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|t| t.to_string() == text).ok_or_else(|| UnknownTransport(text.into()))
    }
}

/// A transport that does not exist.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no transport \"{0}\": it must be iceoryx2, zenoh or inproc")]
pub struct UnknownTransport(String);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transports_are_called_as_in_launch_files() {
        for t in Transport::ALL {
            assert_eq!(t.to_string().parse::<Transport>().unwrap(), t);
            assert_eq!(serde_json::to_value(t).unwrap(), t.to_string());
        }
        let error = "dds".parse::<Transport>().unwrap_err().to_string();
        assert!(error.contains("\"dds\"") && error.contains("iceoryx2"), "{error}");
    }
}
