//! What a vehicle file says about identification: free parameters, fitted signals, provenance.

use whirlstand_vehicle::{Matrix, Target, Vehicle, template_names};

const CART: &str = r#"
A = [[0.0, 1.0], [-4.0, -0.5]]
B = [[0.0], [2.0]]
states = [{ name = "angle", unit = "deg" }, { name = "rate", unit = "deg/s" }]
inputs = [{ name = "u" }]
"#;

fn with(text: &str) -> Result<Vehicle, String> {
    // Keys before tables: the arrays above are inline, so anything may follow.
    Vehicle::parse(&format!("{CART}{text}"), "cart.toml").map_err(|e| e.to_string())
}

#[test]
fn free_entries_are_in_the_units_of_the_file_and_survive_writing() {
    let text = r#"
free = [
    { entry = "A[2,1]", lower = -10.0, upper = 0.0, start = -3.0 },
    { entry = "B[2,1]", lower = -5.0, upper = 5.0 },
    { effect = "input_delay", where = "u", parameter = "delay_s", lower = 0.0, upper = 0.3 },
]
fit = { angle = 1.0, rate = 0.5 }
provenance = { method = "pem", seed = "1" }
[[effects]]
effect = "input_delay"
where = "u"
delay_s = 0.05
"#;
    let mut vehicle = with(text).unwrap();
    assert_eq!(vehicle.free[0].target, Target::Entry(Matrix::A, 1, 0));
    assert_eq!(vehicle.free[0].start, Some(-3.0));
    // One of B turns degrees a second squared into radians.
    assert!((vehicle.free[1].upper - 5.0f64.to_radians()).abs() < 1e-15);
    assert_eq!(vehicle.free_name(&vehicle.free[2].target), "input_delay(u).delay_s");
    assert_eq!(vehicle.free_value(&vehicle.free[2].target), 0.05);
    assert_eq!((vehicle.fit_weight("rate"), vehicle.fit_weight("other")), (0.5, 0.0));
    let targets: Vec<Target> = vehicle.free.iter().map(|f| f.target.clone()).collect();
    for (target, value) in targets.iter().zip([-4.5, 0.01, 0.2]) {
        vehicle.set_free(target, value).unwrap();
        assert_eq!(vehicle.free_value(target), value);
    }
    let again = Vehicle::parse(&vehicle.to_toml(), "cart.toml").unwrap();
    assert_eq!(
        (&again.free, &again.fit, &again.provenance),
        (&vehicle.free, &vehicle.fit, &vehicle.provenance)
    );
    assert_eq!((again.a, again.b), (vehicle.a, vehicle.b));
}

#[test]
fn errors_name_file_line_field_and_reason() {
    let cases = [
        (
            "free = [{ entry = \"A[3,1]\", lower = 0.0, upper = 1.0 }]",
            "line 6: free[1].entry: lies outside A",
        ),
        (
            "free = [{ entry = \"A[2,1]\", upper = 1.0 }]",
            "free[1]: lower is missing: a free parameter needs bounds",
        ),
        ("free = [{ entry = \"A[2,1]\", lower = 2.0, upper = 1.0 }]", "free[1].lower: must be below upper"),
        (
            "free = [{ entry = \"A[2,1]\", lower = 0.0, upper = 1.0, start = 2.0 }]",
            "free[1].start: lies outside",
        ),
        ("free = [{ lower = 0.0, upper = 1.0 }]", "give either entry"),
        (
            "free = [{ effect = \"input_delay\", where = \"u\", parameter = \"delay_s\", lower = 0.0, upper = 1.0 }]",
            "no input_delay at 'u' is among the effects",
        ),
        (
            "free = [{ effect = \"input_delay\", where = \"u\", parameter = \"delay\", lower = 0.0, upper = 1.0 }]",
            "did you mean 'delay_s'?",
        ),
        ("fit = { angel = 1.0 }", "did you mean 'angle'?"),
        ("fit = { angle = 0.0 }", "at least one output must have a weight above 0"),
        (
            "free = [{ entry = \"A[2,1]\", lower = 0.0, upper = 1.0 }, { entry = \"A[2,1]\", lower = 0.0, upper = 1.0 }]",
            "A[2,1] is given twice",
        ),
    ];
    for (text, expected) in cases {
        let message = with(text).unwrap_err();
        assert!(message.contains(expected) && message.starts_with("cart.toml"), "{message}");
    }
}

#[test]
fn the_papers_structures_are_templates() {
    let counts: Vec<(String, usize)> =
        template_names().map(|name| (name.to_string(), Vehicle::builtin(name).unwrap().free.len())).collect();
    assert_eq!(counts, [("quadrotor-structure".into(), 12), ("helicopter-structure".into(), 20)]);
    for name in ["quadrotor", "helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"] {
        let vehicle = Vehicle::builtin(name).unwrap();
        assert_eq!(vehicle.free.len(), if name == "quadrotor" { 12 } else { 20 });
        // The file's own values lie within the bounds.
        for f in &vehicle.free {
            assert!((f.lower..=f.upper).contains(&vehicle.free_value(&f.target)), "{name}");
        }
        // What is not free is the structure: zero, or a kinematic one.
        let structure = Vehicle::builtin(if name == "quadrotor" {
            "quadrotor-structure"
        } else {
            "helicopter-structure"
        })
        .unwrap();
        let mut emptied = vehicle.clone();
        for f in &vehicle.free {
            emptied.set_free(&f.target, 0.0).unwrap();
        }
        assert_eq!((emptied.a, emptied.b, emptied.c), (structure.a, structure.b, structure.c), "{name}");
    }
}
