//! A bad network link in user space: datagrams arrive late, and some never.

use std::net::{SocketAddr, UdpSocket};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Relays datagrams between one client and a server until the test process ends.
///
/// Returns the address for the client. Loss is drawn from a fixed sequence, so that two runs lose the same share.
pub fn udp(server: SocketAddr, delay: Duration, loss: f64) -> SocketAddr {
    let front = Arc::new(UdpSocket::bind("127.0.0.1:0").expect("a free port"));
    let back = Arc::new(UdpSocket::bind("127.0.0.1:0").expect("a free port"));
    let address = front.local_addr().expect("bound");
    let client = Arc::new(Mutex::new(None));

    let (known, to_server) = (client.clone(), late(back.clone(), delay));
    let (inbound, mut dice) = (front.clone(), PseudoRandom(1));
    thread::spawn(move || {
        let mut buffer = vec![0; 65_536];
        while let Ok((n, from)) = inbound.recv_from(&mut buffer) {
            *known.lock().expect("no panic holds it") = Some(from);
            if dice.keeps(loss)
                && to_server.send((Instant::now() + delay, server, buffer[..n].to_vec())).is_err()
            {
                break;
            }
        }
    });
    let to_client = late(front, delay);
    let mut dice = PseudoRandom(2);
    thread::spawn(move || {
        let mut buffer = vec![0; 65_536];
        while let Ok((n, _)) = back.recv_from(&mut buffer) {
            let Some(client) = *client.lock().expect("no panic holds it") else { continue };
            if dice.keeps(loss)
                && to_client.send((Instant::now() + delay, client, buffer[..n].to_vec())).is_err()
            {
                break;
            }
        }
    });
    address
}

type Datagram = (Instant, SocketAddr, Vec<u8>);

/// Sends each datagram when it is due. All have the same delay, so they are due in the order of their arrival.
fn late(socket: Arc<UdpSocket>, delay: Duration) -> Sender<Datagram> {
    let (sender, queue) = channel::<Datagram>();
    let (never, due) = channel::<()>();
    thread::spawn(move || {
        let _keep_open = never;
        while let Ok((at, to, bytes)) = queue.recv() {
            // An empty channel as a timer: it can only time out.
            let wait = at.saturating_duration_since(Instant::now()).min(delay);
            let timed = due.recv_timeout(wait);
            debug_assert_eq!(timed, Err(RecvTimeoutError::Timeout));
            let _ = socket.send_to(&bytes, to);
        }
    });
    sender
}

/// The 32-bit linear congruential generator of Numerical Recipes, sufficient for the loss of one datagram in
/// a hundred.
struct PseudoRandom(u32);

impl PseudoRandom {
    fn keeps(&mut self, loss: f64) -> bool {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0) / f64::from(u32::MAX) >= loss
    }
}
