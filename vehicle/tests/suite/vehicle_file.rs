//! What a user meets when a vehicle file is wrong, and that any size of model loads and is written back.

use nalgebra::DMatrix;
use proptest::prelude::*;
use whirlstand_vehicle::{Simulator, Vehicle};

const GOOD: &str = r#"name = "cart"
A = [
    [0.0, 1.0],
    [-4.0, -0.5],
]
B = [[0.0], [2.0]]
states = [
    { name = "angle", unit = "deg" },
    { name = "rate", unit = "deg/s" },
]
inputs = [{ name = "u", lower = -1, upper = 1, rate_limit = 5 }]

[[outputs]]
name = "angle"
noise = "0.1 deg"

[[outputs]]
name = "rate"
unit = "rad/s"
noise = 0.01
every = 2

[[effects]]
effect = "input_delay"
where = "u"
delay_s = "80 ms"
"#;

#[test]
fn the_good_file_is_good() {
    let vehicle = Vehicle::parse(GOOD, "cart.toml").unwrap();
    assert_eq!(vehicle.effects[0].parameter("delay_s"), Some(0.08));
    assert!((vehicle.outputs[0].noise - 0.1f64.to_radians()).abs() < 1e-18);
    assert_eq!(vehicle.outputs[1].noise, 0.01);
    assert_eq!(vehicle.c, DMatrix::identity(2, 2));
    let deg = std::f64::consts::PI / 180.0;
    assert!((vehicle.b[(1, 0)] - 2.0 * deg).abs() < 1e-17);
}

#[test]
fn the_bound_of_a_state_is_read_in_its_unit_and_written_again() {
    let text = GOOD.replacen("unit = \"deg/s\" }", "unit = \"deg/s\", bound = 90 }", 1);
    let vehicle = Vehicle::parse(&text, "cart.toml").unwrap();
    assert_eq!((vehicle.states[0].bound, vehicle.states[1].bound), (None, Some(90f64.to_radians())));
    let again = Vehicle::parse(&vehicle.to_toml(), "again.toml").unwrap();
    assert!((again.states[1].bound.unwrap() - 90f64.to_radians()).abs() < 1e-15);
    assert!(vehicle.state_bounds(&[0.0, 0.0])[1] < 2.0);
}

#[test]
fn what_an_input_does_between_its_samples_is_read_and_written_again() {
    assert!(!Vehicle::parse(GOOD, "cart.toml").unwrap().inputs[0].is_straight());
    let text = GOOD.replacen("rate_limit = 5", "rate_limit = 5, intersample = \"foh\"", 1);
    let vehicle = Vehicle::parse(&text, "cart.toml").unwrap();
    assert!(vehicle.inputs[0].is_straight());
    assert!(Vehicle::parse(&vehicle.to_toml(), "again.toml").unwrap().inputs[0].is_straight());
}

#[test]
fn a_state_beyond_its_bound_is_told_with_its_value() {
    let mut vehicle = Vehicle::parse(GOOD, "cart.toml").unwrap();
    vehicle.states[1].bound = Some(0.5);
    let bounds = vehicle.state_bounds(&[0.0, 0.0]);
    assert_eq!(bounds[1], 0.5);
    assert!(bounds[0] >= 1e3 && vehicle.state_bounds(&[70.0, 0.0])[0] >= 7e4);
    let mut simulator = Simulator::new(&vehicle, 0.01, 1).unwrap();
    simulator.set_state(&[0.1, 0.4]);
    assert_eq!(simulator.beyond(&bounds), None);
    simulator.set_state(&[0.1, -0.6]);
    assert_eq!(simulator.beyond(&bounds), Some((1, -0.6)));
    simulator.set_state(&[f64::NAN, 0.0]);
    assert!(simulator.beyond(&bounds).is_some_and(|(i, x)| i == 0 && x.is_nan()));
}

/// Replaces a piece of the good file and returns the error.
fn error(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from}");
    Vehicle::parse(&GOOD.replacen(from, to, 1), "cart.toml").unwrap_err().to_string()
}

#[test]
fn errors_name_file_line_field_and_reason() {
    let cases: &[(&str, &str, &[&str])] = &[
        (
            "[-4.0, -0.5]",
            "[-4.0]",
            &["cart.toml, line 4: A[2]", "1 entries, but 2 are needed: one for each state"],
        ),
        ("B = [[0.0], [2.0]]", "B = [[0.0]]", &["line 6: B", "has 1 rows, but 2 are needed"]),
        ("-0.5", "nan", &["line 4: A[2][2]", "not a finite number"]),
        ("-0.5", "inf", &["line 4: A[2][2]", "not a finite number"]),
        ("-0.5", "\"x\"", &["line 4: A[2][2]", "expected a number, found a string"]),
        ("noise = 0.01", "nois = 0.01", &["line 20: outputs[2].nois", "did you mean 'noise'?"]),
        ("noise = 0.01", "noise = -0.01", &["line 20: outputs[2].noise", "must not be negative"]),
        ("noise = 0.01", "noise = \"1 m\"", &["outputs[2].noise", "in m", "rad/s"]),
        (
            "unit = \"deg/s\" }",
            "unit = \"deg/s\", bound = 0 }",
            &["line 9: states[2].bound", "must be above 0"],
        ),
        ("unit = \"deg/s\" }", "unit = \"deg/s\", bound = \"2 m\" }", &["line 9: states[2].bound", "in m"]),
        ("every = 2", "every = 0", &["line 21: outputs[2].every", "whole number of at least 1"]),
        (
            "unit = \"rad/s\"",
            "unit = \"m/s\"",
            &["line 19: outputs[2].unit", "is incompatible with the state's unit"],
        ),
        (
            "unit = \"rad/s\"",
            "unit = \"furlong\"",
            &["line 19: outputs[2].unit", "'furlong'", "not a known unit"],
        ),
        (
            "name = \"rate\"\nunit",
            "name = \"rat\"\nunit",
            &["outputs[2].name", "did you mean 'rate'?", "give C"],
        ),
        ("{ name = \"rate\"", "{ name = \"angle\"", &["line 9: states[2].name", "given twice"]),
        ("lower = -1", "lower = 3", &["line 11: inputs[1].lower", "must not be above upper"]),
        ("rate_limit = 5", "rate_limit = 0", &["line 11: inputs[1].rate_limit", "above 0"]),
        (
            "rate_limit = 5",
            "intersample = \"linear\"",
            &["line 11: inputs[1].intersample", "\"linear\"", "expected \"zoh\"", "or \"foh\""],
        ),
        ("B = [[0.0], [2.0]]", "", &["cart.toml: B is missing"]),
        ("states = [", "statse = [", &["line 7: statse", "did you mean 'states'?"]),
        ("A = [\n", "A = [[\n", &["cart.toml, line", "not valid TOML"]),
        ("\"input_delay\"", "\"input_dely\"", &["line 24: effects[1].effect", "did you mean 'input_delay'?"]),
        (
            "where = \"u\"",
            "where = \"v\"",
            &["line 25: effects[1].where", "must name an input", "there are u"],
        ),
        ("delay_s", "delay", &["line 26: effects[1].delay", "did you mean 'delay_s'?"]),
        ("\"80 ms\"", "-1", &["line 26: effects[1].delay_s", "from 0 s to 60 s, but is -1 s"]),
        ("\"80 ms\"", "\"80 deg\"", &["line 26: effects[1].delay_s", "quantity in s"]),
    ];
    for (from, to, parts) in cases {
        let message = error(from, to);
        for part in *parts {
            assert!(message.contains(part), "{from} -> {to}: '{part}' is not in: {message}");
        }
    }
}

#[test]
fn effect_units_are_checked_against_the_place() {
    let effect = |text: &str| {
        let start = GOOD.find("[[effects]]").unwrap();
        Vehicle::parse(&format!("{}[[effects]]\n{text}", &GOOD[..start]), "cart.toml")
    };
    let step = |unit: &str| {
        effect(&format!(
            "effect = \"step_disturbance\"\nwhere = \"rate\"\nat_s = 1\nmagnitude = \"2 {unit}\""
        ))
    };
    let vehicle = step("deg/s^2").unwrap();
    assert!((vehicle.effects[0].parameter("magnitude").unwrap() - 2f64.to_radians()).abs() < 1e-16);
    let message = step("deg/s").unwrap_err().to_string();
    assert!(
        message.contains("magnitude") && message.contains("must be in rad/s^2, but is in rad/s"),
        "{message}"
    );
    assert!(effect("effect = \"parameter_change\"\nwhere = \"A[2,1]\"\nvalue = \"-5 1/s^2\"").is_ok());
    let message =
        effect("effect = \"parameter_change\"\nwhere = \"A[3,1]\"\nvalue = 1").unwrap_err().to_string();
    assert!(message.contains("lies outside A, which has 2 rows and 2 columns"), "{message}");
    let message = effect("effect = \"mode_transition\"\nwhere = \"vehicle\"\nat_s = 1\nto = \"quadrotr\"");
    let message = message.unwrap_err().to_string();
    assert!(message.contains("did you mean 'quadrotor'?"), "{message}");
}

#[test]
fn files_are_found_by_path_and_each_other_by_relative_path() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("next.toml", &GOOD.replace("-4.0", "-9.0"));
    let transition =
        "\n[[effects]]\neffect = \"mode_transition\"\nwhere = \"vehicle\"\nat_s = 0.5\nto = \"next.toml\"\n";
    write("cart.toml", &(GOOD.to_string() + transition));
    let path = folder.path().join("cart.toml");
    let vehicle = Vehicle::find(path.to_str().unwrap()).unwrap();
    assert!(Simulator::new(&vehicle, 0.01, 1).is_ok());
    std::fs::remove_file(folder.path().join("next.toml")).unwrap();
    let message = Vehicle::load(&path).unwrap_err().to_string();
    assert!(message.contains("cart.toml") && message.contains("next.toml: cannot be read"), "{message}");
    let message = Vehicle::find("quadrator").unwrap_err().to_string();
    assert!(
        message.contains("did you mean 'quadrotor'?") && message.contains("helicopter-lateral"),
        "{message}"
    );
    let message = Vehicle::find("nowhere/x.toml").unwrap_err().to_string();
    assert!(message.contains("nowhere/x.toml: cannot be read"), "{message}");
}

prop_compose! {
    fn sizes()(n in 1usize..24, m in 1usize..6, p in 1usize..30)
        (n in Just(n), m in Just(m), p in Just(p), entries in prop::collection::vec(-9.0f64..9.0, (n + p) * (n + m)))
        -> (usize, usize, usize, Vec<f64>) { (n, m, p, entries) }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn any_size_loads_runs_and_is_written_back((n, m, p, entries) in sizes()) {
        let units = ["deg", "m", "rad/s", "1", "cm", "deg/s^2", "g"];
        let mut next = entries.iter();
        let mut matrix = |rows: usize, columns: usize| {
            let row = |next: &mut dyn Iterator<Item = &f64>| {
                let entries = (0..columns).map(|_| format!("{:?}", next.next().unwrap())).collect::<Vec<_>>();
                format!("[{}]", entries.join(", "))
            };
            format!("[{}]", (0..rows).map(|_| row(&mut next)).collect::<Vec<_>>().join(", "))
        };
        let signals = |name: &str, count: usize| {
            let one = |i: usize| format!("{{ name = \"{name}{i}\", unit = \"{}\" }}", units[i * 5 % units.len()]);
            format!("[{}]", (0..count).map(one).collect::<Vec<_>>().join(", "))
        };
        let text = format!(
            "A = {}\nB = {}\nC = {}\nD = {}\nstates = {}\ninputs = {}\noutputs = {}\n",
            matrix(n, n), matrix(n, m), matrix(p, n), matrix(p, m),
            signals("x", n), signals("u", m), signals("y", p)
        );
        let vehicle = Vehicle::parse(&text, "any").unwrap_or_else(|e| panic!("{e}"));
        prop_assert_eq!((vehicle.a.nrows(), vehicle.b.ncols(), vehicle.c.nrows()), (n, m, p));
        prop_assert_eq!(&vehicle.to_toml(), &text);
        let bare = Vehicle { source_text: String::new(), ..vehicle };
        let again = Vehicle::parse(&bare.to_toml(), "any").unwrap_or_else(|e| panic!("{e}"));
        prop_assert_eq!(Vehicle { source_text: String::new(), ..again }, bare.clone());
        let mut simulator = Simulator::new(&bare, 0.001, 1).unwrap();
        let mut outputs = vec![0.0; 50 * p];
        simulator.run(&vec![0.1; 50 * m], &mut outputs);
        prop_assert!(outputs.iter().all(|y| y.is_finite()));
    }

    #[test]
    fn no_text_panics(text in "\\PC{0,200}", cut in 0usize..GOOD.len(), insert in "\\PC{0,6}") {
        let _ = Vehicle::parse(&text, "x");
        let _ = Vehicle::parse(&format!("{}{insert}{}", &GOOD[..cut], &GOOD[cut..]), "x");
    }
}

#[test]
fn yaw_and_vertical_axes_are_first_order_and_decoupled() {
    let text = format!(
        "{}\n[yaw]\ngain = \"90 deg/s\"\ntime_constant_s = 0.3\n[vertical]\ngain = 3.0\ntime_constant_s = \"500 ms\"\nlower = 0.0\n",
        whirlstand_vehicle::Vehicle::builtin("quadrotor").unwrap().source_text
    );
    let vehicle = Vehicle::parse(&text, "with-axes.toml").unwrap();
    let plain = Vehicle::builtin("quadrotor").unwrap();
    let names: Vec<_> = vehicle.states.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names[4..], ["yaw", "yaw_rate", "height", "vertical_speed"]);
    assert_eq!((vehicle.inputs[2].name.as_str(), vehicle.inputs[3].lower), ("u_yaw", 0.0));
    assert_eq!(vehicle.a.view((0, 0), (4, 4)), plain.a);
    assert_eq!(vehicle.b.view((0, 0), (4, 2)), plain.b);
    assert!(
        vehicle.a.view((0, 4), (4, 4)).iter().chain(vehicle.a.view((4, 0), (4, 4)).iter()).all(|v| *v == 0.0)
    );
    assert_eq!(vehicle.outputs.len(), 4, "outputs are those of the file");
    let mut simulator = whirlstand_vehicle::Simulator::new(&vehicle, 0.01, 1).unwrap();
    simulator.set_state(&[0.0; 8]);
    for _ in 0..30 {
        simulator.step(&[0.0, 0.0, 1.0, 1.0]);
    }
    // One time constant of yaw; 0.6 of the vertical one.
    let x = simulator.state();
    assert!((x[5] - 90f64.to_radians() * (1.0 - (-1f64).exp())).abs() < 1e-9, "{x:?}");
    assert!((x[7] - 3.0 * (1.0 - (-0.6f64).exp())).abs() < 1e-9, "{x:?}");
    let again = Vehicle::parse(&vehicle.to_toml(), "again.toml").unwrap();
    assert_eq!((again.a, again.b), (vehicle.a, vehicle.b));
    for (bad, words) in [
        ("[yaw]\ngain = 1.0\n", "time_constant_s"),
        ("[yaw]\ngain = \"1 m\"\ntime_constant_s = 1.0\n", "rad"),
        ("[vertical]\ngain = 1.0\ntime_constant_s = 0.0\n", "above 0"),
        ("[vertical]\ngian = 1.0\ntime_constant_s = 1.0\n", "'gain'"),
    ] {
        let text = format!("{}\n{bad}", plain.source_text);
        let error = Vehicle::parse(&text, "bad.toml").unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}
