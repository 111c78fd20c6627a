//! Units never guess: a number without a unit is taken only where it can mean one thing, and what is written reads back.

use proptest::prelude::*;
use whirlstand_vehicle::{Effect, FieldValue, Kind, PlaceKind, Requirement, SPECS, Scale, Spec, Vehicle};

/// Degrees at roll, SI at the speed, per cent at the input.
const MIXED: &str = r#"A = [[0.0, 1.0, 0.0], [-4.0, -0.5, 0.0], [0.36, 0.0, -0.2]]
B = [[0.0], [2.0], [0.0]]
states = [
    { name = "roll", unit = "deg" },
    { name = "roll_rate", unit = "deg/s" },
    { name = "speed", unit = "m/s" },
]
inputs = [{ name = "u", unit = "%" }]
"#;

fn with(effect: &str) -> Result<Vehicle, String> {
    Vehicle::parse(&format!("{MIXED}[[effects]]\n{effect}"), "mixed.toml").map_err(|e| e.to_string())
}

#[test]
fn a_bare_number_of_an_effect_is_refused_with_both_readings() {
    for (effect, words) in [
        (
            "effect = 'step_disturbance'\nwhere = 'roll_rate'\nat_s = 1\nmagnitude = 60",
            "line 13: effects[1].magnitude: step_disturbance: is 60 without a unit: 60 rad/s^2 = 3438 deg/s^2, or \
             60 deg/s^2: write the unit, as in \"60 deg/s^2\"",
        ),
        ("effect = 'sensor_bias'\nwhere = 'roll'\noffset = 2", "2 rad = 115 deg, or 2 deg"),
        ("effect = 'sensor_drift'\nwhere = 'roll'\nrate_per_s = 0.1", "0.1 rad/s = 5.73 deg/s, or 0.1 deg/s"),
        ("effect = 'noise'\nwhere = 'roll'\nstd = 0.1", "0.1 rad = 5.73 deg, or 0.1 deg"),
        ("effect = 'input_bias'\nwhere = 'u'\noffset = 5", "5 = 500 %, or 5 %"),
        ("effect = 'rate_limit'\nwhere = 'u'\nlimit_per_s = 5", "5 1/s = 500 %/s, or 5 %/s"),
        (
            "effect = 'coulomb_friction'\nwhere = 'roll_rate'\nlevel = '3 deg/s^2'\nasymmetry = 0.01",
            "effects[1].asymmetry",
        ),
        // In the matrix of the same file this number is in deg/s^2 per per cent.
        (
            "effect = 'parameter_change'\nwhere = 'B[2,1]'\nvalue = 2.0",
            "2 rad/s^2 = 1.15 deg/s^2/%, or 2 deg/s^2/%",
        ),
        ("effect = 'parameter_change'\nwhere = 'A[3,1]'\nvalue = 0.36", "or 0.36 m/s^2/deg"),
    ] {
        let error = with(effect).unwrap_err();
        assert!(error.contains(words), "{effect}: {error}");
    }
}

#[test]
fn a_bare_number_is_taken_where_both_readings_agree() {
    for effect in [
        "effect = 'step_disturbance'\nwhere = 'speed'\nat_s = 1\nmagnitude = 2",
        "effect = 'step_disturbance'\nwhere = 'roll_rate'\nat_s = 1\nmagnitude = 0",
        "effect = 'step_disturbance'\nwhere = 'roll_rate'\nat_s = 1\nmagnitude = '60 deg/s^2'",
        "effect = 'input_delay'\nwhere = 'u'\ndelay_s = 0.08",
        "effect = 'input_gain'\nwhere = 'u'\nfactor = 0.9",
        "effect = 'parameter_change'\nwhere = 'A[2,1]'\nvalue = -4.0",
        "effect = 'parameter_change'\nwhere = 'A[2,1]'\nfactor = 1.1",
        // A coefficient of powers is in SI, and says so where it is written.
        "effect = 'quadratic_drag'\nwhere = 'roll_rate'\ncoefficient = 0.5",
        "effect = 'cubic_stiffness'\nwhere = 'roll->roll_rate'\ncoefficient = 0.5",
    ] {
        with(effect).unwrap_or_else(|e| panic!("{effect}: {e}"));
    }
}

#[test]
fn bounds_of_an_effects_parameter_are_read_as_the_parameter_is() {
    let free = |bounds: &str| {
        let free = format!(
            "free = [{{ effect = 'sensor_bias', where = 'roll', parameter = 'offset', {bounds} }}]\n{MIXED}[[effects]]\n\
             effect = 'sensor_bias'\nwhere = 'roll'\noffset = 0.0\n"
        );
        Vehicle::parse(&free, "mixed.toml").map_err(|e| e.to_string())
    };
    let error = free("lower = -2, upper = '2 deg'").unwrap_err();
    assert!(error.contains("free[1].lower: is -2 without a unit: -2 rad = -115 deg, or -2 deg"), "{error}");
    let vehicle = free("lower = '-2 deg', upper = '2 deg', start = 0").unwrap();
    assert_eq!((vehicle.free[0].upper, vehicle.free[0].start), (2f64.to_radians(), Some(0.0)));
    let written = Vehicle { source_text: String::new(), ..vehicle }.to_toml();
    assert!(written.contains("lower = \"-2 deg\", upper = \"2 deg\""), "{written}");
    assert!(free("lower = '-2 m', upper = 0").unwrap_err().contains("rad"));
}

#[test]
fn a_matrix_that_copies_without_converting_is_refused() {
    let mixed = |c: &str, unit: &str| {
        let text = format!(
            "A = [[0.0, 1.0], [-4.0, -0.5]]\nB = [[0.0], [2.0]]\n{c}states = [{{ name = 'roll', unit = 'rad' }}, \
             {{ name = 'roll_rate', unit = '{unit}' }}]\ninputs = [{{ name = 'u' }}]\noutputs = [{{ name = 'roll', unit = \
             'deg' }}]\n"
        );
        Vehicle::parse(&text, "mixed.toml").map_err(|e| e.to_string())
    };
    let error = mixed("C = [[1.0, 0.0]]\n", "rad/s").unwrap_err();
    let words = "line 3: C[1][1]: is 1, which says that 1 rad of roll reads as 1 deg of roll, not as 57.3 deg: write \
                 57.29577951308232";
    assert!(error.contains(words), "{error}");
    assert!(mixed("C = [[-1.0, 0.0]]\n", "rad/s").unwrap_err().contains("not as -57.3 deg"));
    let error = mixed("", "deg/s").unwrap_err();
    assert!(
        error.contains("A[1][2]: is 1, which says that 1 deg/s of roll_rate moves roll by 1 rad/s"),
        "{error}"
    );
    assert_eq!(mixed("", "rad/s").unwrap().c[(0, 0)], 1.0, "without C the unit is converted");
    assert_eq!(mixed("C = [[57.29577951308232, 0.0]]\n", "rad/s").unwrap().c[(0, 0)], 1.0);
    assert!(mixed("C = [[1.0, 0.1]]\n", "rad/s").is_ok(), "no copy");
}

#[test]
fn the_gain_of_an_axis_that_declares_no_unit_carries_its_own() {
    let axis = |gain: &str| {
        let text = format!("{MIXED}[yaw]\ngain = {gain}\ntime_constant_s = 0.3\n");
        Vehicle::parse(&text, "mixed.toml").map_err(|e| e.to_string())
    };
    assert!(
        axis("90")
            .unwrap_err()
            .contains("yaw.gain: is 90 without a unit: 90 rad/s = 5157 deg/s, or 90 deg/s")
    );
    let vehicle = axis("\"90 deg/s\"").unwrap();
    let yaw = &vehicle.states[vehicle.state_index("yaw").unwrap()];
    assert!(yaw.unit.two_readings(5.0).unwrap().contains("5 rad = 286 deg, or 5 deg"));
}

const UNITS: [&str; 12] = ["deg", "deg/s", "rad", "m", "cm", "km/h", "g", "rpm", "%", "1", "N*m", "deg/s^2"];

/// A vehicle of two states, inputs and outputs in any units, with one effect of any kind, size and sign.
fn extended() -> impl Strategy<Value = (Vehicle, Effect)> {
    let unit = || prop::sample::select(&UNITS[..]);
    let size = || (-9.0f64..9.0, prop::bool::ANY);
    (prop::array::uniform6(unit()), 0..SPECS.len(), 0usize..4, prop::array::uniform3(size())).prop_map(
        |(units, spec, entry, sizes)| {
            let text = format!(
                "A = [[0.0, 3.1], [-4.0, -0.5]]\nB = [[0.0, 0.2], [2.0, 1.0]]\nC = [[0.7, 0.3], [0.1, 0.9]]\n\
                 states = [{{ name = 'x', unit = '{}' }}, {{ name = 'v', unit = '{}' }}]\n\
                 inputs = [{{ name = 'u', unit = '{}' }}, {{ name = 'w', unit = '{}' }}]\n\
                 outputs = [{{ name = 'y', unit = '{}' }}, {{ name = 'z', unit = '{}' }}]\n",
                units[0], units[1], units[2], units[3], units[4], units[5]
            );
            let vehicle = Vehicle::parse(&text, "any.toml").unwrap_or_else(|e| panic!("{e}"));
            (vehicle, effect(&SPECS[spec], entry, &sizes))
        },
    )
}

fn effect(spec: &Spec, entry: usize, sizes: &[(f64, bool)]) -> Effect {
    let place = match spec.place {
        PlaceKind::Input => "u",
        PlaceKind::InputPair => "u->w",
        PlaceKind::Output => "y",
        PlaceKind::OutputPair => "y,z",
        PlaceKind::State => "v",
        PlaceKind::StatePair => "x->v",
        PlaceKind::Entry => ["A[2,1]", "B[1,2]", "C[2,1]", "D[1,1]"][entry],
        PlaceKind::Vehicle => "vehicle",
    };
    let mut fields: Vec<(&str, FieldValue)> = Vec::new();
    for (p, (exponent, is_negative)) in spec.parameters.iter().zip(sizes) {
        let size = if *is_negative { -exponent.exp() } else { exponent.exp() };
        let value = match p.name {
            "lower" => -size.abs(),
            "upper" => size.abs(),
            "asymmetry" => 0.0,
            _ => size.clamp(p.lower.max(-1e9), p.upper.min(1e9)),
        };
        if p.requirement != Requirement::OneOf || fields.is_empty() {
            fields.push((p.name, FieldValue::Number(value)));
        }
    }
    if spec.kind == Kind::ModeTransition {
        return Effect::new(Kind::InputGain, "u", &[("factor", 1.5)]).unwrap();
    }
    Effect::from_fields(spec.kind, place, fields).unwrap_or_else(|e| panic!("{e}"))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn what_is_written_carries_units_and_reads_back_unchanged((mut vehicle, effect) in extended()) {
        vehicle.add_effect(effect.clone()).unwrap_or_else(|e| panic!("{e}"));
        for vehicle in [Vehicle { source_text: String::new(), ..vehicle.clone() }, vehicle] {
            let text = vehicle.to_toml();
            let again = Vehicle::parse(&text, "any.toml").unwrap_or_else(|e| panic!("{e}\n{text}"));
            prop_assert_eq!(&again.effects, &vehicle.effects, "{}", text);
            for p in effect.kind().spec().parameters {
                let bare = text.lines().any(|line| {
                    line.strip_prefix(p.name).is_some_and(|rest| rest.starts_with(" = ") && !rest.contains('"'))
                });
                let unit = effect.unit(p.name, &vehicle).unwrap();
                let has_own = matches!(p.scale, Scale::One | Scale::Time | Scale::Frequency | Scale::Angle);
                prop_assert!(has_own || !bare || unit.si_symbol().is_empty(), "{}: {}", p.name, text);
            }
        }
    }
}
