use super::*;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Turns until a link is up and something was received, at most five seconds.
fn until<T>(mut done: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + Duration::from_secs(5);
    loop {
        if let Some(value) = done() {
            return value;
        }
        assert!(Instant::now() < end, "nothing happened for 5 s");
        std::thread::yield_now();
    }
}

fn receive(link: &mut Link) -> Vec<u8> {
    let mut buffer = [0; 512];
    until(|| {
        link.maintain(Instant::now());
        match link.receive(&mut buffer) {
            Ok(Received::Stream(n) | Received::Datagram(n)) => Some(buffer[..n].to_vec()),
            _ => None,
        }
    })
}

fn up(link: &mut Link) {
    until(|| link.maintain(Instant::now()).filter(|e| *e == LinkEvent::Up));
}

/// A pseudo-terminal: its master, and the path of its other side.
fn pty() -> (OwnedFd, String) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let path = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    (master, path)
}

#[test]
fn bytes_go_both_ways_over_a_serial_line_of_any_rate() {
    let (master, path) = pty();
    let mut link = Link::new(format!("serial://{path}:420000").parse().unwrap());
    up(&mut link);
    rustix::io::write(&master, b"\xc8\x00\x0a\x0d\x11").unwrap();
    assert_eq!(receive(&mut link), b"\xc8\x00\x0a\x0d\x11", "nothing is translated");
    assert!(link.sender().send(b"\x0f\x13\x03"));
    let mut back = [0; 8];
    let n = rustix::io::read(&master, &mut back[..]).unwrap();
    assert_eq!(&back[..n], b"\x0f\x13\x03");
}

#[test]
fn a_serial_port_that_was_unplugged_is_opened_again() {
    let dir = tempfile::tempdir().unwrap();
    let plug = dir.path().join("tty");
    let mut link = Link::new(format!("serial://{}:57600", plug.display()).parse().unwrap());
    let told = until(|| link.maintain(Instant::now()));
    assert!(matches!(told, LinkEvent::Down(why) if why.contains("cannot be opened")));
    for round in 0..2u8 {
        let (master, path) = pty();
        std::os::unix::fs::symlink(path, &plug).unwrap();
        up(&mut link);
        rustix::io::write(&master, &[round]).unwrap();
        assert_eq!(receive(&mut link), [round]);
        std::fs::remove_file(&plug).unwrap();
        drop(master);
        let mut buffer = [0; 8];
        let down = until(|| link.receive(&mut buffer).err());
        assert!(matches!(down, LinkEvent::Down(_)) && !link.is_up());
        assert!(!link.sender().send(b"x"));
    }
    assert_eq!(link.sender().dropped(), 2);
}

#[test]
fn udp_answers_whoever_spoke_last() {
    let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut link = Link::new(Address::UdpIn(free));
    up(&mut link);
    assert!(!link.sender().send(b"to nobody"));
    for _ in 0..2 {
        let mut peer = Link::new(Address::UdpOut(free));
        up(&mut peer);
        peer.sender().send(b"hello");
        assert_eq!(receive(&mut link), b"hello");
        assert!(link.sender().send(b"answer"));
        assert_eq!(receive(&mut peer), b"answer");
    }
}

#[test]
fn tcp_peers_may_leave_and_come_back() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut server = Link::new(Address::TcpIn(free));
    assert_eq!(server.maintain(Instant::now()), None);
    for round in 0..2 {
        let mut client = Link::new(Address::TcpOut(free));
        up(&mut client);
        up(&mut server);
        client.sender().send(b"hello");
        assert_eq!(receive(&mut server), b"hello");
        assert!(server.sender().send(b"answer"));
        // The second leaves with the answer unread, which resets the connection.
        if round == 0 {
            assert_eq!(receive(&mut client), b"answer");
        }
        drop(client);
        let mut buffer = [0; 8];
        let down = until(|| server.receive(&mut buffer).err());
        assert!(matches!(&down, LinkEvent::Down(why) if why.contains("the other end closed it")), "{down:?}");
    }
}
