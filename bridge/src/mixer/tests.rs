use super::*;
use proptest::prelude::*;

/// PX4 and ArduPilot number the motors of a quad-X as the frame does.
const NATIVE: [usize; 4] = [1, 2, 3, 4];

fn vehicle() -> Vehicle {
    Vehicle::builtin("quadrotor").unwrap()
}

fn mixed(options: &MixerOptions, outputs: &[f64]) -> Vec<f64> {
    let mixer = Mixer::new(options, &NATIVE, &vehicle()).unwrap();
    let mut u = vec![f64::NAN; mixer.inputs()];
    mixer.mix(outputs, &mut u);
    u
}

#[test]
fn a_quad_turns_the_model_the_way_its_motors_say() {
    let options = MixerOptions::default();
    // Both inputs of the paper's quadrotor have reversed signs: a positive one turns it to the left and the
    // nose down.
    assert_eq!(mixed(&options, &[0.5; 4]), [0.0, 0.0], "hover");
    assert_eq!(mixed(&options, &[0.0, 1.0, 1.0, 0.0]), [-20.0, 0.0], "left full: all to the right");
    assert_eq!(mixed(&options, &[1.0, 0.0, 1.0, 0.0]), [0.0, -20.0], "front full: nose up");
    let plus = MixerOptions { frame: FrameKind::QuadPlus, ..options };
    assert_eq!(mixed(&plus, &[0.25, 0.75, 0.5, 0.5]), [-10.0, 0.0]);
    assert_eq!(mixed(&plus, &[0.5, 0.5, 0.75, 0.25]), [0.0, -10.0]);
}

#[test]
fn yaw_and_collective_are_told_apart() {
    let mixer = Mixer::new(&MixerOptions::default(), &NATIVE, &vehicle()).unwrap();
    let demands = |outputs: &[f64]| {
        [Demand::Roll, Demand::Pitch, Demand::Yaw, Demand::Vertical].map(|d| mixer.demand(d, outputs))
    };
    assert_eq!(demands(&[1.0, 1.0, 0.0, 0.0]), [0.0, 0.0, 1.0, 0.0]);
    assert_eq!(demands(&[1.0; 4]), [0.0, 0.0, 0.0, 0.5]);
    assert_eq!(demands(&[]), [0.0, 0.0, 0.0, -0.5], "absent outputs are still");
}

#[test]
fn a_swashplate_is_undone() {
    for azimuths in
        [None, Some(vec![0.0, 140f64.to_radians(), 220f64.to_radians()]), Some(vec![0.0, 1.6, 3.1, 4.7])]
    {
        let options =
            MixerOptions { frame: FrameKind::Ccpm, azimuths: azimuths.clone(), ..Default::default() };
        let native = [1, 2, 3, 4];
        let mixer = Mixer::new(&options, &native, &vehicle()).unwrap();
        let angles = azimuths.unwrap_or_else(|| [-60f64, 60.0, 180.0].map(f64::to_radians).to_vec());
        let (roll, pitch, collective) = (0.3, -0.4, 0.2);
        let servos: Vec<f64> = angles.iter().map(|a| collective + pitch * a.cos() - roll * a.sin()).collect();
        for (demand, wanted) in [(Demand::Roll, roll), (Demand::Pitch, pitch), (Demand::Vertical, collective)]
        {
            assert!((mixer.demand(demand, &servos) - wanted).abs() < 1e-12, "{demand:?}");
        }
    }
}

#[test]
fn outputs_can_be_reordered_reversed_scaled_and_trimmed() {
    let mut options =
        MixerOptions { outputs: Some(vec![5, 6, 7, 8]), reversed: vec![5], ..Default::default() };
    options.roll =
        AxisOptions { input: Some("u_pitch".into()), scale: Some(2.0), trim: 0.5, ..Default::default() };
    options.pitch = AxisOptions { input: Some("u_roll".into()), scale: Some(1.0), ..Default::default() };
    let u = mixed(&options, &[9.0, 9.0, 9.0, 9.0, 1.0, 1.0, 1.0, 0.0]);
    assert_eq!(u, [0.0, 2.5]);
}

#[test]
fn accelerations_part_the_axes_that_b_couples() {
    let text = r#"
        roll = { acceleration = "100 deg/s^2" }
        pitch = { acceleration = 2.0 }
    "#;
    let options: MixerOptions = toml::from_str(text).unwrap();
    let vehicle = vehicle();
    for (outputs, roll, pitch) in [
        ([0.0, 1.0, 1.0, 0.0], 100f64.to_radians(), 0.0),
        ([1.0, 0.0, 1.0, 0.0], 0.0, 2.0),
        ([0.5, 0.5, 0.5, 0.5], 0.0, 0.0),
    ] {
        let u = mixed(&options, &outputs);
        let made = |state: &str| {
            let row = vehicle.state_index(state).unwrap();
            vehicle.b[(row, 0)] * u[0] + vehicle.b[(row, 1)] * u[1]
        };
        assert!(
            (made("roll_rate") - roll).abs() < 1e-12 && (made("pitch_rate") - pitch).abs() < 1e-12,
            "{u:?}"
        );
    }
    let refuse = |text: &str| {
        let options: MixerOptions = toml::from_str(text).unwrap();
        Mixer::new(&options, &NATIVE, &vehicle).unwrap_err().to_string()
    };
    assert!(refuse("roll = { acceleration = 1.0 }").contains("all axes"));
    assert!(refuse("roll = { acceleration = 1.0, scale = 1.0 }").contains("mixer.roll.scale"));
    assert!(toml::from_str::<MixerOptions>("roll = { acceleration = \"3 m\" }").is_err());
}

#[test]
fn a_mixer_that_does_not_fit_is_refused_with_its_key() {
    let refuse = |change: fn(&mut MixerOptions)| {
        let mut options = MixerOptions::default();
        change(&mut options);
        Mixer::new(&options, &NATIVE, &vehicle()).unwrap_err().to_string()
    };
    for (error, words) in [
        (refuse(|o| o.roll.input = Some("u_rol".into())), ["mixer.roll.input", "u_roll, u_pitch"]),
        (refuse(|o| o.outputs = Some(vec![1, 2])), ["outputs", "4 outputs"]),
        (refuse(|o| o.outputs = Some(vec![0, 1, 2, 3])), ["outputs", "from 1"]),
        (refuse(|o| o.azimuths = Some(vec![0.0; 3])), ["azimuths", "ccpm"]),
        (refuse(|o| (o.frame, o.azimuths) = (FrameKind::Ccpm, Some(vec![0.0; 3]))), ["azimuths", "line"]),
        (refuse(|o| o.yaw.input = Some("u_yaw".into())), ["yaw", "no input"]),
        (refuse(|o| o.hover = Some(f64::NAN)), ["hover", "share"]),
        (refuse(|o| o.yaw.input = Some("u_roll".into())), ["mixer.yaw.scale", "give a scale"]),
    ] {
        assert!(words.iter().all(|w| error.contains(w)), "{error}");
    }
}

proptest! {
    /// Demands within the motors' range are recovered from any autopilot's mixer.
    #[test]
    fn mixing_undoes_mixing(roll in -0.3..0.3f64, pitch in -0.3..0.3f64, yaw in -0.3..0.3f64) {
        let mixer = Mixer::new(&MixerOptions::default(), &NATIVE, &vehicle()).unwrap();
        // Front right, rear left, front left, rear right, by hand.
        let motors = [
            0.5 + (-roll + pitch + yaw) / 2.0,
            0.5 + (roll - pitch + yaw) / 2.0,
            0.5 + (roll + pitch - yaw) / 2.0,
            0.5 + (-roll - pitch - yaw) / 2.0,
        ];
        prop_assert!((mixer.demand(Demand::Roll, &motors) - roll).abs() < 1e-12);
        prop_assert!((mixer.demand(Demand::Pitch, &motors) - pitch).abs() < 1e-12);
        prop_assert!((mixer.demand(Demand::Yaw, &motors) - yaw).abs() < 1e-12);
        prop_assert!(mixer.demand(Demand::Vertical, &motors).abs() < 1e-12);
    }
}
