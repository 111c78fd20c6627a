use super::*;
use proptest::prelude::*;

fn address(text: &str) -> SocketAddr {
    text.parse().unwrap()
}

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn told(keeper: &mut PeerKeeper) -> Vec<String> {
    std::iter::from_fn(|| keeper.note()).map(|n| n.to_string()).collect()
}

#[test]
fn a_second_sender_is_counted_told_once_and_adopted_only_when_the_peer_is_silent() {
    let (vehicle, stranger) = (address("192.0.2.7:14550"), address("192.0.2.66:9"));
    let mut keeper = PeerKeeper::new(None, SILENCE);
    assert_eq!((keeper.judge(stranger, ms(0)), keeper.peer()), (Verdict::Candidate, None));
    keeper.refuse(stranger, 1);
    keeper.refuse(stranger, 1);
    assert_eq!(keeper.judge(vehicle, ms(1)), Verdict::Candidate);
    assert_eq!(keeper.adopt(vehicle, ms(1)), None);
    for at in 2..1000 {
        assert_eq!(keeper.judge(stranger, ms(at)), Verdict::Refused);
    }
    assert_eq!(keeper.judge(vehicle, ms(1000)), Verdict::Peer);
    // It sent only invalid data.
    assert_eq!(keeper.judge(stranger, ms(1001)), Verdict::Refused, "one second to the millisecond");
    keeper.keep(ms(1001));
    assert_eq!(keeper.judge(stranger, ms(2001)), Verdict::Refused);
    assert_eq!(keeper.judge(stranger, ms(2002)), Verdict::Candidate);
    assert_eq!(keeper.judge(vehicle, ms(9000)), Verdict::Peer, "nobody has taken its place");
    assert_eq!(keeper.adopt(stranger, ms(9001)), Some(vehicle));
    assert_eq!(keeper.counts(), PeerCounts { second: 1000, invalid: 2, not_pinned: 0 });
    assert_eq!(
        told(&mut keeper),
        [
            "1 bytes from 192.0.2.66:9 are refused: they are not valid messages of the protocol",
            "the other end is 192.0.2.7:14550",
            "192.0.2.66:9 sends as well and is refused: 192.0.2.7:14550 is the other end and is active",
            "the other end is 192.0.2.66:9 now: 192.0.2.7:14550 had sent nothing valid for 1 s",
        ]
    );
}

#[test]
fn a_pinned_address_refuses_all_others_whatever_they_say() {
    for (pin, good, bad) in [
        ("192.0.2.7", "192.0.2.7:5", "192.0.2.8:5"),
        ("192.0.2.7:5", "192.0.2.7:5", "192.0.2.7:6"),
        ("192.0.2.7", "[::ffff:192.0.2.7]:5", "[::1]:5"),
        ("[::1]:5", "[::1]:5", "127.0.0.1:5"),
        ("::1", "[::1]:5", "127.0.0.1:5"),
    ] {
        let mut keeper = PeerKeeper::new(Some(pin.parse().unwrap()), SILENCE);
        assert_eq!(keeper.judge(address(good), ms(0)), Verdict::Candidate, "{pin}");
        assert_eq!(keeper.judge(address(bad), ms(0)), Verdict::Refused, "{pin}");
        keeper.judge(address(bad), ms(9000));
        assert_eq!((keeper.counts().not_pinned, told(&mut keeper).len()), (2, 1), "{pin}");
    }
}

#[test]
fn a_pin_is_written_as_it_is_read() {
    for text in ["192.0.2.7", "192.0.2.7:14550", "::1", "[::1]:14550"] {
        let pin: Pin = serde_json::from_value(text.into()).unwrap();
        assert_eq!(serde_json::to_value(pin).unwrap(), text);
    }
    let error = "vehicle.local".parse::<Pin>().unwrap_err().to_string();
    assert_eq!(error, "'vehicle.local' is no numeric address: 192.0.2.7 or 192.0.2.7:14550 is expected");
}

#[test]
fn a_client_that_connected_has_its_time_to_speak() {
    let mut keeper = PeerKeeper::new(None, SILENCE);
    assert!(keeper.is_free(ms(0)));
    keeper.hold(address("127.0.0.1:5"), ms(0));
    assert!(!keeper.is_free(ms(1000)) && keeper.is_free(ms(1001)) && !keeper.has_spoken());
    keeper.keep(ms(1500));
    assert!(!keeper.is_free(ms(2500)) && keeper.has_spoken());
    keeper.release();
    assert!(keeper.is_free(ms(2500)) && keeper.peer().is_none());
}

proptest! {
    /// For any data from any sender: the peer changes only to a valid one, and only when there was none or
    /// the old one had been silent; every datagram is decoded or counted.
    #[test]
    fn nobody_steals_a_link(
        pinned in any::<bool>(),
        events in prop::collection::vec((0u16..4, any::<bool>(), 0u64..700), 1..200)
    ) {
        let pin = pinned.then(|| Pin::Place(address("127.0.0.1:1")));
        let mut keeper = PeerKeeper::new(pin, SILENCE);
        let (mut now, mut last_valid, mut decoded) = (0, None, 0);
        let total = events.len() as u64;
        for (port, valid, wait) in events {
            now += wait;
            let from = SocketAddr::from(([127, 0, 0, 1], port));
            let before = keeper.peer();
            match keeper.judge(from, ms(now)) {
                Verdict::Peer => {
                    prop_assert_eq!(before, Some(from));
                    decoded += 1;
                    if valid {
                        keeper.keep(ms(now));
                    }
                }
                Verdict::Candidate if valid => {
                    prop_assert!(last_valid.is_none_or(|at| now - at > 1000));
                    decoded += 1;
                    keeper.adopt(from, ms(now));
                }
                Verdict::Candidate => keeper.refuse(from, 1),
                Verdict::Refused => {}
            }
            if keeper.peer() == Some(from) && valid {
                last_valid = Some(now);
            }
            prop_assert!(keeper.peer() == before || (valid && keeper.peer() == Some(from)));
            prop_assert!(!pinned || keeper.peer().is_none_or(|peer| peer.port() == 1));
        }
        prop_assert_eq!(decoded + keeper.counts().sum(), total);
    }
}
