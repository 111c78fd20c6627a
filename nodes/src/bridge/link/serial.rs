//! Opening a serial port: raw, at any rate.

use std::io;
use std::os::fd::OwnedFd;
use std::path::Path;

use rustix::fs::{Mode, OFlags, open};
use rustix::termios::{ControlModes, OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

/// Opens a port without waiting for a modem and sets rate and format.
///
/// # Errors
/// The system's answer; a rate that the port does not take is one.
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
    // A divider hits most rates within two percent; more than three is another rate.
    if is.abs_diff(baud) > baud / 32 {
        let reason = format!("the port does not take {baud} baud, it is at {is}");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    // What waited there was sent before anybody listened.
    tcflush(&port, QueueSelector::IOFlush)?;
    Ok(port)
}
