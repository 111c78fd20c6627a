//! Damaged, cut, doubled, disordered and delayed streams: never a wrong command, and every loss counted.

use std::time::Duration;

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use whirlstand_bridge::arming::Mode;
use whirlstand_bridge::mavlink::{Deframer, Encoder, Event, Key, MavMessage, Signing, dialect};
use whirlstand_bridge::vehicle::{Group, Port};
use whirlstand_bridge::{crsf, sbus};

use crate::support::{Pair, config};

/// Damage to a stream of frames, applied in this order.
#[derive(Debug, Clone)]
enum Damage {
    /// Flips bits of a byte.
    Flip(prop::sample::Index, u8),
    /// Cuts bytes out.
    Cut(prop::sample::Index, u8),
    /// Puts noise in.
    Noise(prop::sample::Index, Vec<u8>),
    /// Sends a frame twice.
    Double(prop::sample::Index),
    /// Exchanges two neighbouring frames.
    Swap(prop::sample::Index),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<prop::sample::Index>;
    prop_oneof![
        (at(), 1u8..).prop_map(|(i, bits)| Damage::Flip(i, bits)),
        (at(), 1u8..60).prop_map(|(i, n)| Damage::Cut(i, n)),
        (at(), prop::collection::vec(any::<u8>(), 1..80)).prop_map(|(i, n)| Damage::Noise(i, n)),
        at().prop_map(Damage::Double),
        at().prop_map(Damage::Swap),
    ]
}

/// Damages frames; what comes out is one stream.
fn apply(mut frames: Vec<Vec<u8>>, damages: &[Damage]) -> Vec<u8> {
    for d in damages {
        match d {
            Damage::Double(i) => {
                let i = i.index(frames.len());
                frames.insert(i, frames[i].clone());
            }
            Damage::Swap(i) => {
                let i = i.index(frames.len() - 1);
                frames.swap(i, i + 1);
            }
            _ => {}
        }
    }
    let mut stream = frames.concat();
    for d in damages {
        match d {
            Damage::Flip(i, bits) => {
                let i = i.index(stream.len());
                stream[i] ^= bits;
            }
            Damage::Cut(i, n) => {
                let i = i.index(stream.len());
                let end = (i + usize::from(*n)).min(stream.len());
                if i > 0 {
                    stream.drain(i..end);
                }
            }
            Damage::Noise(i, noise) => {
                let i = i.index(stream.len());
                stream.splice(i..i, noise.iter().copied());
            }
            Damage::Double(_) | Damage::Swap(_) => {}
        }
    }
    stream
}

fn attitude(i: u32) -> MavMessage {
    MavMessage::ATTITUDE(dialect::ATTITUDE_DATA {
        time_boot_ms: 60_000 + i,
        roll: i as f32 * 1e-3,
        pitch: -(i as f32) * 1e-3,
        ..Default::default()
    })
}

proptest! {
    // The same cases each time: one damaged frame in 65536 passes a checksum of 16 bits, and that is no failure.
    #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(11), ..ProptestConfig::default() })]

    #[test]
    fn every_message_that_passes_was_sent_and_every_byte_is_accounted_for(
        count in 2u32..30,
        damages in prop::collection::vec(damage(), 0..6),
        pieces in prop::collection::vec(1usize..200, 1..40),
        signed in any::<bool>(),
    ) {
        let now = Duration::from_secs(1);
        let signing = || Signing::new(Key([7; 32]), 0, Duration::from_secs(1_700_000_000));
        let mut encoder = Encoder::new(1, 1);
        let mut deframer = Deframer::new();
        if signed {
            encoder = encoder.with_signing(signing());
            deframer = Deframer::with_signing(signing());
        }
        let sent: Vec<_> = (0..count).map(attitude).collect();
        let frames = sent.iter().map(|m| { let mut f = Vec::new(); encoder.encode(m, now, &mut f); f }).collect();
        let stream = apply(frames, &damages);
        let (mut rest, mut heard, mut lengths) = (&stream[..], Vec::new(), 0usize);
        let mut pieces = pieces.iter().cycle();
        while !rest.is_empty() {
            let (piece, later) = rest.split_at((*pieces.next().unwrap()).min(rest.len()));
            rest = later;
            deframer.push(piece);
            while let Some(event) = deframer.next(now) {
                if let Event::Message(_, message) = event {
                    lengths += deframer.frame().len();
                    heard.push(message);
                }
            }
        }
        deframer.end();
        for message in &heard {
            prop_assert!(sent.contains(message), "{message:?} was never sent");
        }
        let counts = deframer.counts();
        prop_assert_eq!(counts.bytes, stream.len() as u64);
        prop_assert_eq!(counts.messages, heard.len() as u64);
        if damages.is_empty() {
            prop_assert_eq!(&heard, &sent);
            prop_assert_eq!((counts.dropped(), counts.lost, counts.late, counts.noise_bytes), (0, 0, 0, 0));
        }
        if lengths < stream.len() {
            prop_assert!(counts.dropped() + counts.noise_bytes > 0, "bytes went uncounted: {counts:?}");
        }
        // Each message that is missing shows as a drop or as a gap, and at the ends as a drop or noise.
        let missing = sent.iter().filter(|m| !heard.contains(m)).count() as u64;
        prop_assert!(missing == 0 || counts.dropped() + counts.lost + counts.noise_bytes > 0);
        if signed {
            let mut once = heard.clone();
            once.dedup();
            prop_assert_eq!(once.len(), heard.len(), "a signed frame is believed once");
        }
    }

    #[test]
    fn a_damaged_link_never_moves_a_channel_that_nobody_commanded(
        damages in prop::collection::vec(damage(), 1..12),
        noise in prop::collection::vec(any::<u8>(), 0..400),
    ) {
        // Disarmed, whatever comes in: neutral. The bytes hold valid frames of an unarmed autopilot.
        let mut pair = Pair::new(&config());
        for _ in 0..5 {
            pair.step([10.0, -4.0]);
        }
        let frames = (0..20).map(|i| {
            let mut f = Vec::new();
            let message = if i % 4 == 0 { pair.heartbeat() } else { attitude(i + 1100) };
            pair.autopilot.encode(&message, pair.now, &mut f);
            f
        }).collect();
        let mut stream = apply(frames, &damages);
        stream.extend(noise);
        for piece in stream.chunks(37) {
            pair.now += Duration::from_millis(2);
            pair.vehicle.receive(Port::Link, piece, false, pair.now);
            pair.vehicle.command(&[10.0, -4.0], pair.now);
            pair.listen();
            prop_assert_eq!(pair.vehicle.mode(), Mode::Disarmed);
            prop_assert_eq!(pair.channels(), Some([1500, 1500]));
            let (imu, _) = pair.vehicle.measure();
            prop_assert!(imu.roll.is_finite() && imu.pitch.is_finite());
        }
    }

    #[test]
    fn time_never_goes_back_in_what_is_measured(
        order in Just((0u32..40).collect::<Vec<_>>()).prop_shuffle(),
        doubled in prop::collection::vec(0usize..40, 0..10),
    ) {
        let mut pair = Pair::new(&config());
        pair.say(&pair.heartbeat());
        let mut list = order;
        for i in doubled {
            list.push(list[i]);
        }
        let (mut newest, mut refused) = (None, 0);
        for i in list {
            pair.now += Duration::from_millis(1);
            pair.say(&attitude(i));
            if newest.is_none_or(|n| i > n) {
                newest = Some(i);
            } else {
                refused += 1;
            }
            let roll = pair.vehicle.telemetry().values(Group::Attitude).unwrap()[0];
            prop_assert_eq!(roll as f32, newest.unwrap() as f32 * 1e-3);
        }
        prop_assert_eq!(pair.vehicle.figures().refused, refused);
    }

    #[test]
    fn crsf_passes_only_what_was_sent_and_counts_the_rest(
        channels in prop::collection::vec(prop::array::uniform16(0u16..2048), 2..10),
        damages in prop::collection::vec(damage(), 0..4),
        pieces in prop::collection::vec(1usize..40, 1..40),
    ) {
        let frames: Vec<Vec<u8>> = channels
            .iter()
            .map(|c| { let mut f = Vec::new(); crsf::write_channels(&crsf::Channels(*c), &mut f); f })
            .collect();
        let stream = apply(frames, &damages);
        let mut parser = crsf::Parser::new();
        let (mut rest, mut heard) = (&stream[..], 0usize);
        let mut pieces = pieces.iter().cycle();
        while !rest.is_empty() {
            let (piece, later) = rest.split_at((*pieces.next().unwrap()).min(rest.len()));
            rest = later;
            parser.push(piece);
            while let Some(event) = parser.next_event() {
                if let crsf::Event::Channels(c) = event {
                    heard += 1;
                    // Eight bits of checksum let one damaged frame in 256 pass; whole frames that do are rare enough to
                    // be told from a parser that is wrong, which passes many.
                    let damaged = !damages.is_empty();
                    prop_assert!(channels.contains(&c.0) || damaged);
                }
            }
        }
        parser.reset();
        let counts = parser.counts();
        prop_assert_eq!(counts.bytes, stream.len() as u64);
        if damages.is_empty() {
            prop_assert_eq!(heard, channels.len());
            prop_assert_eq!((counts.checksum, counts.noise_bytes), (0, 0));
        } else if heard < channels.len() {
            prop_assert!(counts.checksum + counts.noise_bytes + counts.malformed > 0);
        }
    }

    /// SBUS has no checksum; between frames is a pause, and what is cut, doubled or overtaken is told from a frame by that.
    #[test]
    fn sbus_passes_only_what_was_sent_and_counts_the_rest(
        bursts in prop::collection::vec((prop::array::uniform16(0u16..2048), 0u8..6, 0usize..60, any::<u8>()), 1..40),
    ) {
        let mut parser = sbus::Parser::new();
        let (mut sent, mut heard, mut whole, mut bytes) = (Vec::new(), Vec::new(), 0, 0);
        for (channels, fate, size, noise) in bursts {
            let frame = sbus::Frame { channels, digital: [false; 2], lost: false, failsafe: false };
            sent.push(frame);
            let mut burst = Vec::new();
            sbus::write(&frame, &mut burst);
            match fate {
                0 => burst.truncate(size % sbus::FRAME),
                1 => burst = burst.repeat(2),
                // Noise that begins no frame.
                2 => burst.splice(0..0, std::iter::repeat_n(noise | 0x80, size)).for_each(drop),
                3 => { let last = sent[size % sent.len()]; sbus::write(&last, &mut burst); }
                _ => {}
            }
            whole += [1, 2, 1, 2, 1, 1][usize::from(fate)] - usize::from(fate == 0);
            bytes += burst.len() as u64;
            for piece in burst.chunks(1 + size % 30) {
                parser.push(piece);
                while let Some(frame) = parser.next_frame() {
                    prop_assert!(sent.contains(&frame));
                    heard.push(frame);
                }
            }
            parser.reset();
        }
        let counts = parser.counts();
        prop_assert_eq!(heard.len(), whole);
        prop_assert_eq!(counts.bytes, bytes);
        prop_assert_eq!(counts.bytes, counts.noise_bytes + counts.frames * sbus::FRAME as u64);
    }

    /// Whatever the delays, the controller is in charge only while the newest attitude is as young as it must be.
    #[test]
    fn what_is_delayed_is_never_flown_on(delays in prop::collection::vec(0u64..500, 1..8)) {
        let mut pair = Pair::flying(&config());
        let stale = Duration::from_millis(250);
        let mut under_way = Vec::new();
        let mut newest = pair.now;
        for k in 0..300 {
            pair.now += Duration::from_millis(5);
            let delay = Duration::from_millis(delays[k / 40 % delays.len()]);
            under_way.push((pair.now + delay, pair.now, pair.attitude(0.1)));
            pair.say(&pair.heartbeat());
            let (arrived, later) = under_way.into_iter().partition::<Vec<_>, _>(|(due, ..)| *due <= pair.now);
            under_way = later;
            for (_, measured, message) in arrived {
                pair.say(&message);
                newest = newest.max(measured);
            }
            pair.vehicle.command(&[10.0, -4.0], pair.now);
            pair.listen();
            let age = pair.now - newest;
            // The stamps are in whole milliseconds.
            if age > stale + Duration::from_millis(2) {
                prop_assert_ne!(pair.vehicle.mode(), Mode::Automatic, "{:?}", age);
                prop_assert_eq!(pair.channels(), Some([1500, 1500]));
            }
        }
    }
}
