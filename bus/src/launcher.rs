//! Ensures a single launcher per bench, as far as a network allows.
//!
//! A launcher declares a liveliness token (Zenoh's presence, which ends with the session in any case) under
//! the bench's name, and then queries those of others. Because it declares its own first, of two launchers
//! that start at once at least one sees the other. Its query reaches all peers to which it is connected, and
//! everybody behind a router.

use std::time::{Duration, Instant};

use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;

use crate::OpenError;

/// Longest time until requested links are up; a node on another host may start much later.
const LINKS: Duration = Duration::from_secs(1);

/// Longest time between two queries, and the longest wait for replies.
const AGAIN: Duration = Duration::from_millis(100);

/// Announces this process as the launcher of a bench, until it is dropped.
#[derive(Debug)]
pub struct LauncherToken {
    _token: Option<LivelinessToken>,
}

impl LauncherToken {
    /// A token without effect, for a transport within one machine.
    pub(crate) fn local() -> Self {
        Self { _token: None }
    }

    /// Announces this process over a session; `has_links` is true when it connects to others.
    pub(crate) fn announce(
        session: &zenoh::Session,
        bench: &str,
        has_links: bool,
    ) -> Result<Self, OpenError> {
        let refused = |e: zenoh::Error| OpenError::Transport {
            action: "announce the launcher".into(),
            bench: bench.into(),
            transport: crate::Transport::Zenoh,
            reason: e.to_string(),
        };
        let all = format!("whirlstand/{bench}/@launcher");
        let own = format!("{all}/{}/{}/{}", session.zid(), host(), std::process::id());
        let token = session.liveliness().declare_token(own.clone()).wait().map_err(refused)?;
        let changes = session.liveliness().declare_subscriber(format!("{all}/**")).wait().map_err(refused)?;
        let began = Instant::now();
        loop {
            let question = session.liveliness().get(format!("{all}/**")).timeout(AGAIN);
            let answers = question.wait().map_err(refused)?;
            let mut other = None;
            while let Ok(answer) = answers.recv() {
                let Ok(sample) = answer.result() else { continue };
                let key = sample.key_expr().as_str();
                if key != own {
                    other = Some(holder(key));
                }
            }
            // A token that has just ended may still be reported for a moment.
            let patience = if has_links || other.is_some() { LINKS } else { Duration::ZERO };
            if began.elapsed() >= patience {
                return match other {
                    Some(holder) => Err(OpenError::Taken { bench: bench.into(), holder }),
                    None => Ok(Self { _token: Some(token) }),
                };
            }
            // A token that comes or goes is an event, but a link that is up is none: so the query is repeated
            // at any rate.
            let _ = changes.recv_timeout(AGAIN);
        }
    }
}

/// Name of this host, as a part of a key expression.
fn host() -> String {
    let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let fits = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '-' };
    format!("h-{}", name.chars().map(fits).collect::<String>())
}

/// Text on the owner of a token.
fn holder(key: &str) -> String {
    let mut parts = key.rsplit('/');
    let (pid, host) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    format!("process {pid} on host {}", host.strip_prefix("h-").unwrap_or(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_holder_is_read_from_its_token() {
        let key = format!("whirlstand/lab/@launcher/0a1b/{}/77", host());
        let told = holder(&key);
        assert!(told.starts_with("process 77 on host ") && !told.contains("h-/"), "{told}");
        assert_eq!(holder("whirlstand/lab/@launcher/0a1b/h-lab.example/7"), "process 7 on host lab.example");
    }
}
