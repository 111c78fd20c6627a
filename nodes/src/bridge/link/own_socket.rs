//! A socket that hears the peer alone.

use std::io;
use std::net::{SocketAddr, UdpSocket};

use socket2::{Domain, Protocol, SockRef, Socket, Type};

/// A second socket on the port of `open`, connected to the peer: the system gives it what comes from there, and all else to
/// the open one. So strangers, however many, cannot fill the queue in which the peer's datagrams wait, and wake nobody.
///
/// # Errors
/// The system's answer.
pub(super) fn own_socket(open: &UdpSocket, peer: SocketAddr) -> io::Result<UdpSocket> {
    let at = open.local_addr()?;
    let own = Socket::new(Domain::for_address(at), Type::DGRAM, Some(Protocol::UDP))?;
    let open = SockRef::from(open);
    // Two sockets may have a port when both allow it, which must not last: another program could come as well.
    open.set_reuse_address(true)?;
    own.set_reuse_address(true)?;
    let bound = own.bind(&at.into());
    open.set_reuse_address(false)?;
    own.set_reuse_address(false)?;
    bound?;
    own.connect(&peer.into())?;
    own.set_nonblocking(true)?;
    Ok(own.into())
}
