//! The faults of a soak: how each is injected, and how it is removed.

mod address_space;
mod again;
mod disk;
mod flood;
mod forge;
mod load;
mod ongoing;
mod processes;
mod strangers;

use std::io;
use std::path::Path;

use crate::cli::FaultArg;
use crate::error::Failure;
use crate::file::Plan;
use disk::Disk;
use flood::Flood;
pub(super) use forge::FORGED;
use forge::Forge;
pub(super) use ongoing::Ongoing;

/// Target name of a fault that is not injected into a single node.
const BENCH: &str = "bench";

/// A kind of fault, with the resources that have to be prepared.
pub(super) enum FaultKind {
    /// A node is killed (SIGKILL).
    Kill,
    /// A node is stopped (SIGSTOP) and later continued (SIGCONT).
    Stop,
    /// A node gets no memory beyond what it has.
    Memory,
    /// The disk has no space for the log.
    Disk(Disk),
    /// A stranger publishes forged messages.
    Forge(Forge),
    /// Far more messages arrive than needed.
    Flood(Flood),
    /// All processors are busy.
    Load,
}

impl FaultKind {
    /// Prepares faults to a bench whose log goes into `folder`, and changes the plan where the fault requires
    /// it.
    ///
    /// # Errors
    /// When this bench has no place for such a fault.
    pub fn prepare(fault: FaultArg, plan: &mut Plan, folder: &Path) -> Result<Self, Failure> {
        Ok(match fault {
            FaultArg::Kill => Self::Kill,
            FaultArg::Stop => Self::Stop,
            FaultArg::Memory => Self::Memory,
            FaultArg::Disk => Self::Disk(Disk::prepare(plan, folder)?),
            FaultArg::Forge => Self::Forge(Forge::prepare(plan)?),
            FaultArg::Flood => Self::Flood(Flood::prepare(plan)),
            FaultArg::Load => Self::Load,
        })
    }

    /// The targets of the fault in every round.
    pub fn targets(&self, nodes: &[String]) -> Vec<String> {
        match self {
            Self::Kill | Self::Stop | Self::Memory => nodes.to_vec(),
            Self::Disk(_) => vec![whirlstand_nodes::config::Role::Recorder.name().into()],
            Self::Forge(_) | Self::Flood(_) | Self::Load => vec![BENCH.into()],
        }
    }

    /// Whether the recorder continues its log only some time after the fault.
    pub fn stops_the_log(&self) -> bool {
        matches!(self, Self::Disk(_))
    }

    /// Begins a fault, in the process `pid` where it has a single target. Returns `None` for a fault that
    /// does not last.
    ///
    /// # Errors
    /// When the system refuses it.
    pub fn begin(&self, pid: Option<u32>) -> io::Result<Option<Box<dyn Ongoing>>> {
        let pid = || pid.ok_or_else(|| io::Error::other("the node does not run"));
        Ok(match self {
            Self::Kill => {
                processes::kill(pid()?);
                None
            }
            Self::Stop => Some(Box::new(processes::Stopped::begin(pid()?))),
            Self::Memory => Some(Box::new(address_space::NoMemory::begin(pid()?)?)),
            Self::Disk(disk) => Some(disk.begin(pid()?)?),
            Self::Forge(forge) => Some(forge.begin()?),
            Self::Flood(flood) => Some(flood.begin()?),
            Self::Load => Some(Box::new(load::Busy::begin()?)),
        })
    }
}
