//! Reference for a bridge's latency: a process that only returns datagrams.

use std::net::UdpSocket;

use super::BenchError;

/// Returns every datagram to its sender, forever.
///
/// # Errors
/// [`BenchError::Process`] when the port cannot be bound.
pub(super) fn run_echo(port: u16) -> Result<(), BenchError> {
    let socket = UdpSocket::bind(("127.0.0.1", port)).map_err(failed("bind the echo's port"))?;
    let mut buffer = [0; 2048];
    loop {
        let (length, from) = socket.recv_from(&mut buffer).map_err(failed("receive"))?;
        socket.send_to(&buffer[..length], from).map_err(failed("send"))?;
    }
}

fn failed(what: &'static str) -> impl Fn(std::io::Error) -> BenchError {
    move |source| BenchError::Process { what: what.into(), source }
}
