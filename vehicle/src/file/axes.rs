//! Optional axes of a vehicle file, `[yaw]` and `[vertical]`: first-order models decoupled from the file's
//! own model.
//!
//! The rate r of an axis responds to its input u by dr/dt = (gain u - r) / time constant, and its angle or
//! height is the integral of the rate. Both axes become ordinary states and inputs, after those of the file.

use nalgebra::DMatrix;
use whirlstand_msgs::units::Unit;

use super::table::Table;
use crate::error::FileError;
use crate::model::{Input, Intersample, State};
use crate::signal_unit::SignalUnit;

/// An axis: its key, the names of its integral, its rate and its input, and their units.
const AXES: [(&str, [&str; 3], [&str; 2]); 2] = [
    ("yaw", ["yaw", "yaw_rate", "u_yaw"], ["rad", "rad/s"]),
    ("vertical", ["height", "vertical_speed", "u_vertical"], ["m", "m/s"]),
];

/// The keys of the axes in a vehicle file.
pub(super) const KEYS: [&str; 2] = [AXES[0].0, AXES[1].0];

/// One axis, in SI.
pub(super) struct Axis {
    gain: f64,
    time_constant: f64,
    states: [State; 2],
    input: Input,
}

/// The axes in the file.
///
/// # Errors
/// An unknown key, a missing gain or time constant, an invalid value, or a name already used in the file.
pub(super) fn axes(file: &Table<'_>, states: &[State], inputs: &[Input]) -> Result<Vec<Axis>, FileError> {
    let mut axes = Vec::new();
    for (key, [integral, rate, input], [unit, rate_unit]) in AXES {
        let Some(node) = file.get(key) else { continue };
        let table = node.table(&["gain", "time_constant_s", "lower", "upper"])?;
        let taken = states.iter().map(|s| &s.name).chain(inputs.iter().map(|i| &i.name));
        if let Some(name) = taken.into_iter().find(|n| [integral, rate, input].contains(&n.as_str())) {
            return Err(node.error(format!("the vehicle already has '{name}'; an axis defines its own")));
        }
        let signal_unit = |text: &str| {
            text.parse::<SignalUnit>()
                .map(SignalUnit::implied)
                .map_err(|e: whirlstand_msgs::units::UnitError| node.error(e.to_string()))
        };
        let time = table.requirement("time_constant_s")?;
        let time_constant = time.magnitude(&Unit::SECOND)?;
        if time_constant == 0.0 {
            return Err(time.error("must be above 0"));
        }
        let gain = table.requirement("gain")?.signal_value(&signal_unit(rate_unit)?)?;
        let limit = |key, default| table.get(key).map_or(Ok(default), |n| n.number());
        let (lower, upper) = (limit("lower", -1.0)?, limit("upper", 1.0)?);
        if lower > upper {
            return Err(table.error(Some("lower"), "must not be above upper"));
        }
        axes.push(Axis {
            gain,
            time_constant,
            states: [
                State { name: integral.into(), unit: signal_unit(unit)?, bound: None },
                State { name: rate.into(), unit: signal_unit(rate_unit)?, bound: None },
            ],
            input: Input {
                name: input.into(),
                unit: SignalUnit::default(),
                lower,
                upper,
                rate_limit: f64::INFINITY,
                intersample: Intersample::Held,
            },
        });
    }
    Ok(axes)
}

/// Appends the axes to a model: states, inputs, A and B grow.
pub(super) fn append(
    axes: Vec<Axis>,
    states: &mut Vec<State>,
    inputs: &mut Vec<Input>,
    a: DMatrix<f64>,
    b: DMatrix<f64>,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let (n, m) = (states.len(), inputs.len());
    let mut a = a.resize(n + 2 * axes.len(), n + 2 * axes.len(), 0.0);
    let mut b = b.resize(n + 2 * axes.len(), m + axes.len(), 0.0);
    for (i, axis) in axes.into_iter().enumerate() {
        let (integral, rate) = (n + 2 * i, n + 2 * i + 1);
        a[(integral, rate)] = 1.0;
        a[(rate, rate)] = -1.0 / axis.time_constant;
        b[(rate, m + i)] = axis.gain / axis.time_constant;
        states.extend(axis.states);
        inputs.push(axis.input);
    }
    (a, b)
}
