//! Opens serial ports in raw mode, at any rate.

use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::Path;

use rustix::fs::{Mode, OFlags, open};
use rustix::termios::{ControlModes, OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

/// Largest age of bytes that wait in the driver when something new is sent, s: beyond it a failsafe would
/// come too late.
const OLDEST: f64 = 0.05;

/// Largest number of bytes that may wait in the driver of a line at this rate and format.
pub(super) fn most_waiting(baud: u32, even_two: bool) -> usize {
    let bits = if even_two { 12.0 } else { 10.0 };
    (f64::from(baud) / bits * OLDEST) as usize
}

/// Number of bytes that wait in the driver; 0 where it is not reported, as for a pseudo-terminal.
pub(super) fn waiting(port: &OwnedFd) -> usize {
    let mut count: libc::c_int = 0;
    // SAFETY: the descriptor is open for as long as `port` lives, and TIOCOUTQ writes one int, for which there is room.
    let answer = unsafe { libc::ioctl(port.as_raw_fd(), libc::TIOCOUTQ, &raw mut count) };
    if answer == 0 { usize::try_from(count).unwrap_or(0) } else { 0 }
}

/// Opens a port without waiting for a modem and sets rate and format.
///
/// # Errors
/// The error of the operating system, also for a rate that the port does not support.
pub(super) fn open_port(path: &Path, baud: u32, even_two: bool) -> io::Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let port = open(path, flags, Mode::empty())?;
    let mut settings = tcgetattr(&port)?;
    settings.make_raw();
    settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    settings.control_modes.remove(ControlModes::CRTSCTS | ControlModes::PARODD);
    settings.control_modes.set(ControlModes::PARENB | ControlModes::CSTOPB, even_two);
    settings.set_speed(baud)?;
    tcsetattr(&port, OptionalActions::Now, &settings)?;
    let is = tcgetattr(&port)?.output_speed();
    // A divider meets most rates within two percent; a difference above three is another rate.
    if is.abs_diff(baud) > baud / 32 {
        let reason = format!("the port does not support {baud} baud; it is at {is}");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    // Waiting bytes were sent before the port was opened.
    tcflush(&port, QueueSelector::IOFlush)?;
    Ok(port)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_may_hold_back_what_it_says_in_50_ms() {
        assert_eq!(most_waiting(57_600, false), 288);
        assert_eq!(most_waiting(100_000, true), 416);
        let pair = rustix::pty::openpt(rustix::pty::OpenptFlags::RDWR | rustix::pty::OpenptFlags::NOCTTY);
        assert_eq!(waiting(&pair.unwrap()), 0);
    }
}
