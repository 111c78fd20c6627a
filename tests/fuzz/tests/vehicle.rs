//! Any text at all, as a vehicle file: a vehicle that writes as the same and flies, or an error that names the file.
//!
//! `cargo test` tries the kept corpus and some random inputs; `docs/architecture.md` says how to search for long.

use whirlstand_file_fuzz::edited;
use whirlstand_vehicle::{Simulator, Vehicle};

/// A vehicle with something of everything that a vehicle file may have.
const SEED: &str = r#"name = "motor"
description = "a motor with a flap"
states = [{ name = "angle", unit = "deg" }, { name = "rate", unit = "deg/s", bound = 9000.0 }]
inputs = [{ name = "u", lower = -1.0, upper = 1.0, rate_limit = 20.0 }]
A = [[0.0, 1.0], [-4.0, -0.5]]
B = [[0.0], [30.0]]

[[outputs]]
name = "angle"
unit = "deg"
noise = "0.1 deg"
every = 2
quantization = 0.01

[yaw]
gain = "90 deg/s"
time_constant_s = 0.3

[[effects]]
effect = "input_delay"
where = "u"
delay_s = 0.08

[[effects]]
effect = "backlash"
where = "u"
width = 0.1

[[effects]]
effect = "parameter_change"
where = "A[2,1]"
factor = 1.5
"#;

/// Steps that a vehicle flies.
const STEPS: usize = 20;

const WORDS: [&[u8]; 40] = [
    b"\n",
    b"[",
    b"]",
    b"\"",
    b"=",
    b",",
    b"nan",
    b"inf",
    b"-",
    b"1e308",
    b"1e-320",
    b"1_0",
    b"0x7f",
    b"[[effects]]\n",
    b"[[outputs]]\n",
    b"\"deg\"",
    b"\"m/s^2\"",
    b"effect = \"quadratic_drag\"\nwhere = \"rate\"\ncoefficient = ",
    b"effect = \"cubic_stiffness\"\nwhere = \"angle->rate\"\ncoefficient = ",
    b"effect = \"dead_zone\"\nwhere = \"u\"\nwidth = ",
    b"effect = \"unmodelled_mode\"\nwhere = \"u\"\nfrequency_hz = 5.0\ndamping_ratio = 0.1\ngain = ",
    b"effect = \"input_saturation\"\nwhere = \"u\"\nlower = -1\nupper = ",
    b"effect = \"dropouts\"\nwhere = \"angle\"\nfraction = ",
    b"effect = \"turbulence\"\nwhere = \"rate\"\nstd = 1.0\nbandwidth_hz = ",
    b"effect = \"quantization\"\nwhere = \"angle\"\nstep = ",
    b"effect = \"sensor_delay\"\nwhere = \"angle\"\ndelay_s = ",
    b"effect = \"mode_transition\"\nwhere = \"vehicle\"\nat_s = 0\nto = ",
    b"where = \"B[2,1]\"\n",
    b"from_s = ",
    b"until_s = ",
    b"noise = ",
    b"bias = ",
    b"[free]\n",
    b"[map]\n",
    b"[fit]\n",
    b"[provenance]\n",
    b"quadrotor",
    b"1e9",
    b"-0.0",
    b"C = [[1.0, 0.0]]\n",
];

/// Flies a vehicle for a moment; what it measures is a number for as long as its states are.
fn fly(vehicle: &Vehicle) {
    let Ok(mut simulator) = Simulator::new(vehicle, 0.005, 1) else { return };
    let u = vec![0.5; vehicle.inputs.len()];
    for _ in 0..STEPS {
        simulator.step(&u);
        let finite = simulator.state().iter().all(|x| x.is_finite());
        assert!(finite || simulator.diverged(), "{:?}", simulator.state());
        let measured = simulator.measure();
        assert_eq!(measured.len(), vehicle.outputs.len());
    }
}

#[test]
fn vehicle() {
    let seeds: Vec<String> = std::iter::once(SEED.to_string())
        .chain(
            whirlstand_vehicle::builtin_names()
                .map(|name| Vehicle::builtin(name).unwrap_or_else(|e| panic!("{name}: {e}")).source_text),
        )
        .collect();
    for (i, seed) in seeds.iter().enumerate() {
        Vehicle::parse(seed, "seed.toml").unwrap_or_else(|e| panic!("seed {i}: {e}"));
    }
    bolero::check!().for_each(|input: &[u8]| {
        let which = input.first().map_or(0, |first| usize::from(first >> 3));
        let bytes = edited(seeds[which % seeds.len()].as_bytes(), input, &WORDS);
        let text = String::from_utf8_lossy(&bytes);
        match Vehicle::parse(&text, "a.toml") {
            Ok(vehicle) => {
                let written = vehicle.to_toml();
                let again = Vehicle::parse(&written, "a.toml").unwrap_or_else(|e| panic!("{e}\n{written}"));
                assert_eq!(again.states, vehicle.states);
                assert_eq!((&again.a, &again.b, &again.effects), (&vehicle.a, &vehicle.b, &vehicle.effects));
                fly(&vehicle);
            }
            Err(error) => assert!(error.to_string().contains("a.toml"), "{error}"),
        }
    });
}
