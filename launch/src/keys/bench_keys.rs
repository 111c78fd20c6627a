//! The keys of one bench while it runs.

use whirlstand_bus::{Authority, Member, Protection};

use super::members::members;
use crate::error::Failure;
use crate::file::{Plan, Security};
use crate::key_folder::KeyFolder;

/// Host names under which nodes on this host reach each other.
pub(crate) const LOOPBACK: [&str; 3] = ["127.0.0.1", "::1", "localhost"];

/// Issues the identities of a bench's members.
pub(crate) struct BenchKeys {
    source: Source,
    members: Vec<Member>,
}

enum Source {
    /// An open bench: no member needs a key.
    Open,
    /// Keys made for this run only.
    Fresh(Box<Authority>),
    /// Keys that were made before, for several hosts.
    Folder(KeyFolder),
}

impl BenchKeys {
    /// The keys of a planned bench.
    ///
    /// # Errors
    /// When none can be made.
    pub fn new(plan: &Plan) -> Result<Self, Failure> {
        let source = match &plan.security {
            Security::Open => Source::Open,
            Security::Secret => {
                Source::Fresh(Box::new(Authority::new(&plan.config.bench).map_err(Failure::run)?))
            }
            Security::Tls(folder) => Source::Folder(folder.clone()),
        };
        Ok(Self { source, members: members(plan) })
    }

    /// Key and certificates with which the member `name` joins; `None` on an open bench.
    ///
    /// # Errors
    /// When its key does not exist or cannot be made.
    pub fn protection(&self, name: &str) -> Result<Option<Protection>, Failure> {
        let identity = match &self.source {
            Source::Open => return Ok(None),
            Source::Fresh(authority) => {
                authority.issue(name, &LOOPBACK.map(String::from)).map_err(Failure::run)?
            }
            Source::Folder(folder) => folder.identity(name).map_err(Failure::mend)?,
        };
        Ok(Some(Protection { identity, members: self.members.clone() }))
    }
}
