//! The fault of a full file system below the log.
//!
//! Where the system allows it, the log is in a small file system of its own, in a mount namespace that only this
//! process and its nodes see. The fault takes its free space away, and its end restores it. Elsewhere the
//! recorder's file size limit (RLIMIT_FSIZE) is set to zero, which makes writes fail as a full disk does.

use std::ffi::{CStr, CString};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use rustix::process::{Resource, getegid, geteuid};
use whirlstand_nodes::config::Mode;

use super::address_space::Limited;
use super::ongoing::Ongoing;
use crate::error::Failure;
use crate::file::Plan;

/// Free space that is left when the disk is made full, bytes.
const LEFT_OVER: u64 = 16 << 10;

/// Attempts to make the disk full: data written between the measurement of the used space and the fault has
/// to fit.
const ATTEMPTS: u32 = 20;

/// Size of the file system between two faults: a share of the machine's memory, which is taken only as far as
/// it is written to.
const ROOMY: &str = "size=50%";

/// The method by which the disk is made full.
pub(in crate::soak) enum Disk {
    /// A file system of the soak, at this path, that can be made small.
    Own(PathBuf),
    /// The recorder's file size limit.
    Limit,
}

impl Disk {
    /// Mounts a file system for the log alone, if the system allows that.
    ///
    /// # Errors
    /// When the bench has no log, or one that would fill any disk.
    pub fn prepare(plan: &Plan, folder: &Path) -> Result<Self, Failure> {
        if plan.config.recorder.is_none() {
            return Err(Failure::Mend("--fault disk: a bench that records is expected".into()));
        }
        if plan.config.mode == Mode::Lockstep {
            let why = "in lockstep the log grows continuously: --mode realtime is expected";
            return Err(Failure::Mend(format!("--fault disk: {why}")));
        }
        match own_namespace().and_then(|()| mount(c"tmpfs", folder, c"tmpfs", 0, ROOMY)) {
            Ok(()) => Ok(Self::Own(folder.into())),
            Err(e) => {
                crate::style::say(&format!(
                    "the soak cannot mount a file system of its own ({e}): instead of filling the disk, it keeps \
                     the recorder from writing"
                ));
                ignore_the_limits_signal();
                Ok(Self::Limit)
            }
        }
    }

    pub fn begin(&self, recorder: u32) -> io::Result<Box<dyn Ongoing>> {
        Ok(match self {
            Self::Own(folder) => Box::new(Full::begin(folder)?),
            Self::Limit => Box::new(NoMoreBytes { _limit: Limited::begin(recorder, Resource::Fsize, 0)? }),
        })
    }
}

/// A file system without free space; dropped, it gets its space back.
struct Full {
    folder: PathBuf,
    taken: u64,
}

impl Full {
    fn begin(folder: &Path) -> io::Result<Self> {
        let mut attempt = 0;
        loop {
            let is = rustix::fs::statvfs(folder)?;
            let used = is.f_blocks.saturating_sub(is.f_bfree) * is.f_frsize;
            let size = format!("size={}", used + LEFT_OVER);
            attempt += 1;
            match mount(c"tmpfs", folder, c"tmpfs", libc::MS_REMOUNT, &size) {
                Err(_) if attempt < ATTEMPTS => {}
                made => {
                    let taken = (is.f_bfree * is.f_frsize).saturating_sub(LEFT_OVER);
                    return made.map(|()| Self { folder: folder.into(), taken });
                }
            }
        }
    }
}

impl Ongoing for Full {
    fn dealt(&self) -> u64 {
        self.taken
    }
}

impl Drop for Full {
    fn drop(&mut self) {
        if let Err(e) = mount(c"tmpfs", &self.folder, c"tmpfs", libc::MS_REMOUNT, ROOMY) {
            tracing::error!("cannot free the space of the log's file system again: {e}");
        }
    }
}

/// A recorder that may not write any byte.
struct NoMoreBytes {
    _limit: Limited,
}

impl Ongoing for NoMoreBytes {
    fn dealt(&self) -> u64 {
        1
    }
}

/// Gives this process a mount namespace of its own, as root or as the root of a user namespace.
fn own_namespace() -> io::Result<()> {
    let (user, group) = (geteuid().as_raw(), getegid().as_raw());
    let spaces = if user == 0 { libc::CLONE_NEWNS } else { libc::CLONE_NEWNS | libc::CLONE_NEWUSER };
    // SAFETY: unshare(2) touches no memory. For a user namespace the kernel itself checks that no other thread
    // runs yet.
    if unsafe { libc::unshare(spaces) } != 0 {
        return Err(io::Error::last_os_error());
    }
    if user != 0 {
        std::fs::write("/proc/self/setgroups", "deny")?;
        std::fs::write("/proc/self/uid_map", format!("{user} {user} 1"))?;
        std::fs::write("/proc/self/gid_map", format!("{group} {group} 1"))?;
    }
    // Mounts made here must not appear in other namespaces.
    mount(c"none", Path::new("/"), c"none", libc::MS_REC | libc::MS_PRIVATE, "")
}

fn mount(source: &CStr, target: &Path, kind: &CStr, flags: libc::c_ulong, options: &str) -> io::Result<()> {
    let target = CString::new(target.as_os_str().as_bytes())?;
    let options = CString::new(options)?;
    // SAFETY: mount(2) reads four strings that end with a zero and live until it returns.
    let failed = unsafe {
        libc::mount(source.as_ptr(), target.as_ptr(), kind.as_ptr(), flags, options.as_ptr().cast())
    };
    if failed == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Makes a write beyond RLIMIT_FSIZE fail instead of ending the process; the nodes inherit that.
fn ignore_the_limits_signal() {
    // SAFETY: to ignore a signal installs no code.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}
