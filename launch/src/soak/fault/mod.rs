//! The faults: what is done to a bench, and how it is taken back.

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

/// Whom a fault is done to that is not done to one node.
const BENCH: &str = "bench";

/// What a soak does, with all that has to be there beforehand.
pub(super) enum FaultKind {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, later SIGCONT.
    Stop,
    /// No memory beyond what a node has.
    Memory,
    /// No room for the log.
    Disk(Disk),
    /// Messages of a stranger.
    Forge(Forge),
    /// More messages than anybody needs.
    Flood(Flood),
    /// Busy processors.
    Load,
}

impl FaultKind {
    /// Prepares faults to a bench whose log goes into `folder`, and changes of its plan what they need.
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

    /// Whom it is done to, in every round.
    pub fn targets(&self, nodes: &[String]) -> Vec<String> {
        match self {
            Self::Kill | Self::Stop | Self::Memory => nodes.to_vec(),
            Self::Disk(_) => vec![whirlstand_nodes::config::Role::Recorder.name().into()],
            Self::Forge(_) | Self::Flood(_) | Self::Load => vec![BENCH.into()],
        }
    }

    /// Whether the log is written on only some time after the fault.
    pub fn stops_the_log(&self) -> bool {
        matches!(self, Self::Disk(_))
    }

    /// Begins a fault to the process `pid`, where it is done to one; `None` for one that does not last.
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
