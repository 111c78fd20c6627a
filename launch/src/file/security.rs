//! How a bench over Zenoh is protected.

use crate::key_folder::KeyFolder;

/// Who may join a bench over Zenoh. Over shared memory the operating system decides: its files belong to the user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Security {
    /// Everybody who reaches the bench, unless Zenoh's own configuration restricts that.
    Open,
    /// Nodes of this run on this host, with keys that the launcher makes for it.
    Secret,
    /// Every program that has a key from this folder.
    Tls(KeyFolder),
}

/// Why a secret of this host cannot protect a bench with these endpoints.
pub(crate) fn secret_beyond_its_reach(endpoints: &[String]) -> Option<String> {
    let beyond = endpoints.iter().find(|e| !is_on_loopback(e))?;
    Some(format!(
        "the bench can be reached at '{beyond}', which the secret of this host does not protect: set [security] \
         mode = \"tls\" with keys from `whirlstand keys new`, or mode = \"open\" (--set security.mode=open) if \
         everybody on that network may fly it"
    ))
}

/// Whether an endpoint is one that TLS can protect with names of this host.
fn is_on_loopback(endpoint: &str) -> bool {
    let Some((protocol, address)) = endpoint.split_once('/') else { return false };
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    matches!(protocol, "tcp" | "tls") && (host == "localhost" || host == "[::1]" || host.starts_with("127."))
}
