use super::*;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::io::Write;
use std::net::TcpListener;
use std::os::fd::OwnedFd;

/// Repeats until a link is open and something was received, at most five seconds.
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
            Ok(Received::Stream(n) | Received::Datagram { length: n, .. }) => Some(buffer[..n].to_vec()),
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

/// Decodes words: those that begin with "good" are valid.
#[derive(Default)]
struct Words {
    taken: Vec<String>,
    looked_at: usize,
    peers: usize,
}

impl Decoder for Words {
    fn recognises(&mut self, datagram: &[u8]) -> bool {
        self.looked_at += 1;
        datagram.starts_with(b"good")
    }

    fn peer_changed(&mut self) {
        self.peers += 1;
    }

    fn decode(&mut self, bytes: &[u8], _is_datagram: bool) -> bool {
        self.taken.push(String::from_utf8_lossy(bytes).into());
        bytes.starts_with(b"good")
    }
}

fn notes(link: &mut Link) -> Vec<String> {
    std::iter::from_fn(|| link.take_note()).map(|(_, text)| text).collect()
}

/// Receives until `done`, at the time `now` of the link.
fn drain(link: &mut Link, words: &mut Words, now: Instant, done: impl Fn(&Link, &Words) -> bool) {
    until(|| {
        link.drain(&mut [0; 64], now, words).unwrap();
        done(link, words).then_some(())
    });
}

fn free_udp() -> SocketAddr {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

#[test]
fn udp_answers_the_one_who_spoke_validly_and_nobody_else_until_he_is_silent() {
    let place = free_udp();
    let mut link = Link::new(Address::UdpIn(place));
    up(&mut link);
    let [peer, stranger] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    let mut words = Words::default();
    let now = Instant::now();
    stranger.send_to(b"x", place).unwrap();
    drain(&mut link, &mut words, now, |link, _| link.refused().invalid == 1);
    assert!(!link.sender().send(b"to nobody"));
    peer.send_to(b"good day", place).unwrap();
    drain(&mut link, &mut words, now, |_, words| words.taken == ["good day"]);
    for _ in 0..50 {
        stranger.send_to(b"good evening", place).unwrap();
    }
    drain(&mut link, &mut words, now, |link, _| link.refused().second == 50);
    assert_eq!((words.looked_at, words.taken.len()), (2, 1), "what is refused is not read");
    assert!(link.sender().send(b"answer"));
    let mut buffer = [0; 16];
    peer.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    assert_eq!(peer.recv(&mut buffer).unwrap(), 6);
    let told = notes(&mut link);
    assert_eq!(told.len(), 3, "each once: {told:?}");
    // The peer sends nothing valid any more, which counts as silence.
    let later = now + SILENCE + Duration::from_millis(1);
    peer.send_to(b"bad", place).unwrap();
    drain(&mut link, &mut words, later, |_, words| words.taken.len() == 2);
    stranger.send_to(b"good night", place).unwrap();
    drain(&mut link, &mut words, later, |_, words| words.taken.len() == 3);
    assert_eq!(words.peers, 1);
    assert!(notes(&mut link)[0].contains("had sent nothing valid for 1 s"));
}

#[test]
fn a_flood_is_taken_in_so_much_at_a_look_and_told_once() {
    let place = free_udp();
    let mut link = Link::with_peer(Address::UdpIn(place), Some("192.0.2.7".parse().unwrap()), SILENCE);
    up(&mut link);
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    for _ in 0..200 {
        stranger.send_to(b"good", place).unwrap();
    }
    let mut words = Words::default();
    let mut last = 0;
    until(|| {
        link.drain(&mut [0; 64], Instant::now(), &mut words).unwrap();
        let refused = link.refused().not_pinned;
        assert!(refused - last <= 64, "{refused} after {last}");
        last = refused;
        (refused == 200).then_some(())
    });
    assert_eq!((words.looked_at, words.taken.len()), (0, 0));
    let told = notes(&mut link);
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(
        told[0].contains("only 192.0.2.7 is accepted") && told[1].contains("64 of the datagrams"),
        "{told:?}"
    );
}

#[test]
fn the_peer_waits_behind_no_flood_and_loses_nothing_to_it() {
    for place in ["127.0.0.1:0", "0.0.0.0:0", "[::]:0"] {
        let Ok(free) = UdpSocket::bind(place).and_then(|s| s.local_addr()) else { continue };
        let mut link = Link::new(Address::UdpIn(free));
        up(&mut link);
        let place = SocketAddr::from(([127, 0, 0, 1], free.port()));
        let [peer, stranger] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let mut words = Words::default();
        peer.send_to(b"good day", place).unwrap();
        drain(&mut link, &mut words, Instant::now(), |_, words| words.taken.len() == 1);
        // More than any queue holds, before the peer speaks again.
        for _ in 0..5000 {
            stranger.send_to(b"good", place).unwrap();
        }
        let said: Vec<_> = (0..20).map(|n| format!("good {n}")).collect();
        for word in &said {
            peer.send_to(word.as_bytes(), place).unwrap();
        }
        assert!(wait_for_bytes(link.fd().into_iter(), Instant::now() + RETRY, Duration::ZERO));
        words.taken.clear();
        link.drain(&mut [0; 64], Instant::now(), &mut words).unwrap();
        assert_eq!(words.taken, said, "{free}: all of it, at the first look");
        assert!(link.refused().second > 0 && link.sender().send(b"answer"));
        // Nobody else gets the port meanwhile.
        assert!(UdpSocket::bind(free).is_err());
    }
}

#[test]
fn who_holds_a_taken_port_is_told() {
    let (udp, tcp) = (UdpSocket::bind("127.0.0.1:0").unwrap(), TcpListener::bind("127.0.0.1:0").unwrap());
    let (udp_at, tcp_at) = (udp.local_addr().unwrap(), tcp.local_addr().unwrap());
    for address in [Address::UdpIn(udp_at), Address::TcpIn(tcp_at)] {
        let told = Link::new(address).maintain(Instant::now());
        let own = format!("is held by process {} (", std::process::id());
        assert!(matches!(&told, Some(LinkEvent::Down(why)) if why.contains(&own)), "{told:?}");
    }
}

#[test]
fn a_silent_tcp_client_gives_way_to_one_that_waits_and_one_that_speaks_does_not() {
    let place = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut server = Link::new(Address::TcpIn(place));
    server.maintain(Instant::now());
    let silent = TcpStream::connect(place).unwrap();
    up(&mut server);
    let mut words = Words::default();
    let mut now = Instant::now();
    let mut look = |server: &mut Link, ms: u64| {
        now += Duration::from_millis(ms);
        (server.maintain(now), now)
    };
    assert_eq!(look(&mut server, 900).0, None);
    assert!(notes(&mut server).is_empty());
    assert_eq!(look(&mut server, 200).0, None, "nobody waits");
    let told = notes(&mut server);
    let holder = silent.local_addr().unwrap();
    assert!(told.len() == 1 && told[0].contains(&format!("{holder} holds the port")), "{told:?}");
    let mut speaker = TcpStream::connect(place).unwrap();
    let replaced = until(|| look(&mut server, 100).0);
    let next = speaker.local_addr().unwrap();
    assert!(
        matches!(&replaced, LinkEvent::Replaced(why) if why.contains(&format!("{holder} has sent nothing valid for 1 s, and {next}"))),
        "{replaced:?}"
    );
    speaker.write_all(b"good day").unwrap();
    let at = look(&mut server, 500).1;
    drain(&mut server, &mut words, at, |_, words| words.taken == ["good day"]);
    let third = TcpStream::connect(place).unwrap();
    let waits = format!("{} waits: {next} holds the port and is active", third.local_addr().unwrap());
    let told = until(|| {
        assert_eq!(server.maintain(at + Duration::from_millis(900)), None);
        server.look_at = at;
        server.take_note()
    });
    assert!(told.1.ends_with(&waits), "{told:?}");
    drop(speaker);
    let down = until(|| server.drain(&mut [0; 8], at, &mut words).err());
    assert!(matches!(down, LinkEvent::Down(_)));
    assert_eq!(server.maintain(at + Duration::from_secs(1)), Some(LinkEvent::Up), "the third has waited");
}

#[test]
fn one_that_is_not_pinned_is_not_let_in() {
    let place = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut server = Link::with_peer(Address::TcpIn(place), Some("192.0.2.7".parse().unwrap()), SILENCE);
    server.maintain(Instant::now());
    let mut client = TcpStream::connect(place).unwrap();
    until(|| {
        assert_eq!(server.maintain(Instant::now()), None);
        (server.refused().not_pinned == 1).then_some(())
    });
    assert_eq!(client.read(&mut [0; 8]).unwrap_or(0), 0, "it is closed");
    let closed =
        configured("px4", "link", "tcpout://127.0.0.1:1", Some("192.0.2.7".parse().unwrap()), SILENCE);
    let told = closed.err().unwrap().to_string();
    assert!(told.contains("bridge.px4.peer") && told.contains("tcpout://127.0.0.1:1 is neither"), "{told}");
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

/// A pseudo-terminal's driver holds nothing back, so a socket pair replaces the line: TIOCOUTQ counts there
/// unread bytes as well.
#[test]
fn nothing_is_added_to_a_line_whose_driver_holds_more_than_50_ms_back() {
    use std::os::unix::net::UnixStream;

    let (line, mut other) = UnixStream::pair().unwrap();
    line.set_nonblocking(true).unwrap();
    let most_waiting = serial::most_waiting(57_600, false);
    let shared = Shared::new(most_waiting);
    *lock(&shared.wire) = Some(Arc::new(Wire::Serial(line.into())));
    let sender = LinkSender(Arc::new(shared));
    let old = [1; 300];
    assert!(sender.send(&old), "nothing waits yet");
    for dropped in 1..=10 {
        assert!(!sender.send(&[2; 20]), "it would go out behind 50 ms of old outputs");
        assert_eq!(sender.dropped(), dropped, "told as unsent");
    }
    let mut read = [0; 300];
    other.read_exact(&mut read).unwrap();
    assert_eq!(read, old);
    // The line has caught up: the newest data are sent at once, and none of the dropped ones.
    assert!(sender.send(&[3; 20]));
    let mut read = [0; 64];
    assert_eq!(other.read(&mut read).unwrap(), 20);
    assert_eq!(read[..20], [3; 20]);
}
