use super::*;
use crate::arming::Reason;
use crate::config::PilotConfig;

const NOW: Duration = Duration::from_secs(1);

fn input(name: &str) -> Input {
    turning(name, [0.0; 3])
}

fn turning(name: &str, turns: [f64; 3]) -> Input {
    Input { name: name.into(), full: 20.0, turns }
}

fn inputs() -> Vec<Input> {
    vec![input("u_roll"), input("u_pitch")]
}

fn pilot() -> Pilot {
    let config: PilotConfig = serde_json::from_str(r#"{"source": "sbus"}"#).unwrap();
    let mut pilot = Pilot::new(&config).unwrap();
    pilot.update(&[1600.0, 1450.0, 1300.0, 1550.0, 2000.0, 2000.0, 1234.0], false, NOW);
    pilot
}

#[test]
fn who_is_in_charge_moves_the_channels() {
    let mut m = Mapping::new(&[], &inputs(), true).unwrap();
    let pilot = pilot();
    let mut at = |mode| m.apply(mode, &[10.0, -4.0], Some(&pilot), NOW)[..4].to_vec();
    assert_eq!(at(Mode::Disarmed), [1500.0, 1500.0, 1000.0, 1500.0]);
    assert_eq!(at(Mode::Automatic), [1750.0, 1400.0, 1300.0, 1550.0]);
    assert_eq!(at(Mode::Manual), [1600.0, 1450.0, 1300.0, 1550.0]);
    assert_eq!(at(Mode::Failed(Reason::Stale)), [1500.0, 1500.0, 1300.0, 1550.0]);
}

#[test]
fn each_axis_moves_its_channel_alone_both_ways() {
    for (axis, other) in [(0, 1), (1, 0)] {
        for sign in [1.0, -1.0] {
            let mut m = Mapping::new(&[], &inputs(), false).unwrap();
            let mut u = [0.0; 2];
            u[axis] = 10.0 * sign;
            let us = m.apply(Mode::Automatic, &u, None, NOW);
            assert_eq!((us[axis], us[other]), (1500.0 + 250.0 * sign, 1500.0));
        }
    }
}

#[test]
fn trims_spans_limits_and_fixed_channels_are_kept() {
    let channels = [
        ChannelConfig {
            trim_us: 1480.0,
            span_us: -400.0,
            lower_us: 1300.0,
            ..ChannelConfig::new(2, Some("u_roll".into()))
        },
        ChannelConfig { full: Some(1.0), ..ChannelConfig::new(8, Some("u_pitch".into())) },
        ChannelConfig { trim_us: 2000.0, neutral_us: Some(1000.0), ..ChannelConfig::new(5, None) },
    ];
    let mut m = Mapping::new(&channels, &inputs(), false).unwrap();
    let us = *m.apply(Mode::Automatic, &[5.0, f64::NAN], None, NOW);
    assert_eq!((us[1], us[7], us[4]), (1380.0, 1500.0, 2000.0));
    assert_eq!(m.apply(Mode::Automatic, &[90.0, 0.0], None, NOW)[1], 1300.0);
    assert_eq!(m.apply(Mode::Disarmed, &[90.0, 0.0], None, NOW)[4], 1000.0);
    assert_eq!(m.in_use().iter().filter(|u| **u).count(), 3);
}

#[test]
fn mistakes_are_told_with_their_key() {
    let roll = || ChannelConfig::new(1, Some("u_roll".into()));
    let pitch = || ChannelConfig::new(2, Some("u_pitch".into()));
    for (channels, key, word) in [
        (vec![ChannelConfig { channel: 17, ..roll() }], "channels.0.channel", "1 to 16"),
        (vec![roll(), ChannelConfig { channel: 1, ..pitch() }], "channels.1.channel", "twice"),
        (vec![roll()], "channels", "u_pitch"),
        (vec![ChannelConfig { from: Some("u_rol".into()), ..roll() }], "channels.0.from", "u_roll"),
        (
            vec![ChannelConfig { from: Some("pilot.yaw".into()), ..roll() }],
            "channels.0.from",
            "[bridge.pilot]",
        ),
        (vec![ChannelConfig { trim_us: 900.0, ..roll() }], "channels.0.trim_us", "limits"),
        (vec![ChannelConfig { upper_us: f64::NAN, ..roll() }], "channels.0.upper_us", "2200"),
        (vec![ChannelConfig { rate_us_per_s: Some(0.0), ..roll() }], "channels.0.rate_us_per_s", "above 0"),
    ] {
        let error = Mapping::new(&channels, &inputs(), false).unwrap_err();
        assert_eq!(error.path.join("."), key);
        assert!(error.message.contains(word), "{error}");
    }
    let error = Mapping::new(&[], &[input("u_collective")], false).unwrap_err();
    assert!(error.message.contains("u_collective"), "{error}");
}

#[test]
fn a_channel_up_turns_the_vehicle_the_way_of_the_stick_whatever_the_sign_of_b() {
    // A full input that accelerates to the right gives a channel at its upper end, whether that input is
    // positive or negative.
    for sign in [1.0, -1.0] {
        let inputs = [turning("u_roll", [sign, -4.0, 0.0]), turning("u_pitch", [0.0, sign, 0.0])];
        let mut m = Mapping::new(&[], &inputs, true).unwrap();
        let us = *m.apply(Mode::Automatic, &[10.0 * sign, -4.0 * sign], Some(&pilot()), NOW);
        assert_eq!(us[..2], [1750.0, 1400.0], "{sign}");
        let mut acting = [0.0; 2];
        m.acting(&mut acting);
        assert_eq!(acting, [10.0 * sign, -4.0 * sign]);
        // The pilot's stick is independent of the input's sign.
        assert_eq!(m.apply(Mode::Manual, &[0.0; 2], Some(&pilot()), NOW)[..2], [1600.0, 1450.0]);
        let reversed = ChannelConfig { span_us: -500.0, ..ChannelConfig::new(2, Some("u_pitch".into())) };
        let channels = [ChannelConfig::new(1, Some("u_roll".into())), reversed];
        let mut m = Mapping::new(&channels, &inputs, true).unwrap();
        assert_eq!(m.apply(Mode::Automatic, &[0.0, -4.0 * sign], None, NOW)[1], 1600.0);
        assert_eq!(m.apply(Mode::Manual, &[0.0; 2], Some(&pilot()), NOW)[1], 1550.0);
    }
}

#[test]
fn each_channel_says_what_it_does_to_each_axis() {
    let inputs = [turning("u_roll", [-0.02, -0.08, 0.0]), turning("u_pitch", [0.0, 0.25, 0.0])];
    let reversed = ChannelConfig { span_us: -500.0, ..ChannelConfig::new(2, Some("u_pitch".into())) };
    let throttle = ChannelConfig::new(3, Some("pilot.throttle".into()));
    let channels = [ChannelConfig::new(1, Some("u_roll".into())), reversed, throttle];
    let m = Mapping::new(&channels, &inputs, true).unwrap();
    assert_eq!(
        m.sentences(&inputs),
        [
            "u_roll + -> channel 1 down -> the vehicle rolls left and pitches nose down",
            "u_pitch + -> channel 2 down, because its span_us is negative -> the vehicle pitches nose up",
            "channel 3 is the pilot's throttle",
        ]
    );
    let steering: Vec<_> =
        m.steering(&inputs).iter().map(|s| (s.channel, s.axis, s.up_is_positive)).collect();
    assert_eq!(steering, [(0, 0, true), (1, 1, false)]);
}

#[test]
fn an_unnamed_channel_5_arms_and_the_others_are_the_pilots_or_low() {
    let pilot = pilot();
    let at = |m: &mut Mapping, mode, pilot| m.apply(mode, &[0.0; 2], pilot, NOW)[4..].to_vec();
    let low = [1000.0; 12];
    // With a pilot, whose switches of the bench are 5 and 6, and who has 1234 us on 7 and no value on the
    // others.
    let mut m = Mapping::new(&[], &inputs(), true).unwrap().with_switches(Some([5, 6]));
    assert_eq!(at(&mut m, Mode::Disarmed, Some(&pilot)), low);
    for mode in [Mode::Automatic, Mode::Manual, Mode::Failed(Reason::Stale)] {
        assert_eq!(at(&mut m, mode, Some(&pilot))[..3], [2000.0, 1000.0, 1234.0], "{mode:?}");
    }
    assert_eq!(at(&mut m, Mode::Failed(Reason::PilotLost), None), low, "nobody wants it to stay in the air");
    // Without a pilot.
    let mut m = Mapping::new(&[], &inputs(), false).unwrap().with_switches(None);
    assert_eq!(at(&mut m, Mode::Automatic, None)[..2], [2000.0, 1000.0]);
    assert_eq!(at(&mut m, Mode::Failed(Reason::Stale), None), low);
    // A channel in the launch file keeps its own meaning.
    let own = [
        ChannelConfig::new(1, Some("u_roll".into())),
        ChannelConfig::new(2, Some("u_pitch".into())),
        ChannelConfig { trim_us: 1700.0, ..ChannelConfig::new(5, None) },
        ChannelConfig::new(8, Some("arm".into())),
    ];
    let mut m = Mapping::new(&own, &inputs(), false).unwrap().with_switches(None);
    assert_eq!(at(&mut m, Mode::Automatic, None)[..4], [1700.0, 1000.0, 1000.0, 2000.0]);
    assert_eq!(m.in_use().iter().filter(|used| **used).count(), 4, "what is not named is not checked");
    assert!(
        m.sentences(&inputs())
            .iter()
            .any(|s| s == "channel 8 arms the vehicle: high while the controller or the pilot is in charge")
    );
}
