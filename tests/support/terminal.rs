//! A terminal at which somebody types: a pseudo-terminal.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::{FromRawFd, OwnedFd};
use std::process::Stdio;

/// A terminal, and the ends that a command gets as its standard input and error.
pub struct Terminal {
    pub screen: Screen,
    pub stdin: Stdio,
    pub stderr: Stdio,
}

impl Terminal {
    /// A terminal at which `typed` has been typed.
    pub fn typed(typed: &str) -> Self {
        let (mut master, mut slave) = (-1, -1);
        let (name, settings, size) = (std::ptr::null_mut(), std::ptr::null(), std::ptr::null());
        // SAFETY: openpty(3) writes two descriptors, and nothing where the pointers are null.
        let result = unsafe { libc::openpty(&mut master, &mut slave, name, settings, size) };
        assert_eq!(result, 0, "openpty: {}", std::io::Error::last_os_error());
        // SAFETY: both were just opened, and nobody else has them.
        let [master, slave] = [master, slave].map(|fd| unsafe { OwnedFd::from_raw_fd(fd) });
        for fd in [&master, &slave] {
            // SAFETY: fcntl(2) on an open descriptor touches no memory of ours.
            unsafe { libc::fcntl(std::os::fd::AsRawFd::as_raw_fd(fd), libc::F_SETFD, libc::FD_CLOEXEC) };
        }
        let mut master = File::from(master);
        master.write_all(typed.as_bytes()).expect("type");
        let stderr = slave.try_clone().expect("a second descriptor");
        Self { screen: Screen(master), stdin: slave.into(), stderr: stderr.into() }
    }
}

/// What the terminal shows.
pub struct Screen(File);

impl Read for Screen {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        match self.0.read(buffer) {
            // No process has the terminal open any more.
            Err(e) if e.raw_os_error() == Some(libc::EIO) => Ok(0),
            result => result,
        }
    }
}
