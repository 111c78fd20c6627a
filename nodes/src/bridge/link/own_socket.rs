//! Socket that receives only the peer's datagrams.

use std::io;
use std::net::{SocketAddr, UdpSocket};

use socket2::{Domain, Protocol, SockRef, Socket, Type};

/// A second socket on the port of `open`, connected to the peer: the system delivers the peer's datagrams to
/// it, and all others to the open one. So other senders cannot fill the queue of the peer's datagrams, and do
/// not wake the node.
///
/// # Errors
/// The error of the operating system.
pub(super) fn own_socket(open: &UdpSocket, peer: SocketAddr) -> io::Result<UdpSocket> {
    let at = open.local_addr()?;
    let own = Socket::new(Domain::for_address(at), Type::DGRAM, Some(Protocol::UDP))?;
    let open = SockRef::from(open);
    // Two sockets may share a port when both allow it, which must not remain so: another program could bind
    // it as well.
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
