//! Design of test flights: inputs that excite the vehicle within limits, and the expected accuracy of a fit.

mod closed_loop;
mod expectation;
mod flight;
pub mod signals;
mod text;

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use whirlstand_vehicle::Vehicle;

pub use closed_loop::{ClosedLoop, FlightData, InjectionPoint, fly};
pub use flight::*;
pub use signals::{Kind, Shape};

/// Designs a test flight for `vehicle` with the effects of its file.
///
/// # Errors
/// [`ExciteError`].
pub fn design(vehicle: &Vehicle, options: &Options) -> Result<Flight, ExciteError> {
    check(vehicle, options)?;
    let shape = &options.shape;
    let limits = limits(vehicle, options);
    let tops = tops(vehicle, options, &limits)?;
    let closed = options.closed.as_ref();
    let Drawn { signals, flown, shrunk, returning } = draw(vehicle, options, &limits, &tops)?;
    let greatest = |v: &Vec<f64>| v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut flight = Flight {
        schema: EXCITATION_SCHEMA.into(),
        vehicle: vehicle.name.clone(),
        kind: shape.kind,
        period_s: shape.period_s,
        duration_s: options.shape.duration_s(),
        controller: closed.map(|c| c.law.clone()),
        through: match closed.map(|c| &c.through) {
            Some(InjectionPoint::Setpoint(_)) => "setpoint".into(),
            _ => "stick".into(),
        },
        amplitudes: tops.iter().zip(&signals).map(|((name, _), v)| (name.clone(), greatest(v))).collect(),
        commands: vehicle
            .inputs
            .iter()
            .zip(greatest_of(&flown.inputs, vehicle.inputs.len()))
            .map(|(i, v)| (i.name.clone(), v))
            .collect(),
        units: units(vehicle, options),
        peaks: vehicle
            .outputs
            .iter()
            .zip(peaks(&flown, vehicle.outputs.len()))
            .map(|(o, p)| (o.name.clone(), o.unit.shown(), p))
            .collect(),
        parameters: Vec::new(),
        effects: Vec::new(),
        remarks: Vec::new(),
        signals,
    };
    if returning {
        flight.remarks.push(format!(
            "'{}' integrates its inputs: every step is followed by its opposite, so that the outputs return.",
            vehicle.name
        ));
    }
    if shrunk < 1.0 {
        flight.remarks.push(format!(
            "The test signals were scaled down by a factor of {:.2} to keep the predicted outputs within their limits.",
            1.0 / shrunk
        ));
    }
    expectation::expect(vehicle, &mut flight, closed)?;
    Ok(flight)
}

/// Checks the frequencies against the flight, and the limits against the vehicle.
fn check(vehicle: &Vehicle, options: &Options) -> Result<(), ExciteError> {
    let shape = &options.shape;
    let duration_s = options.shape.duration_s();
    let fits = shape.lowest_hz * duration_s >= 1.0
        && shape.highest_hz > shape.lowest_hz
        && shape.highest_hz * shape.period_s <= 0.1;
    if !fits {
        return Err(ExciteError::Frequencies {
            lowest_hz: shape.lowest_hz,
            highest_hz: shape.highest_hz,
            duration_s,
            period_s: shape.period_s,
        });
    }
    if let Some((name, _)) = options.limits.iter().find(|(n, _)| vehicle.output_index(n).is_none()) {
        return Err(ExciteError::NoOutput {
            vehicle: vehicle.name.clone(),
            name: name.clone(),
            known: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
        });
    }
    Ok(())
}

/// Test signals within the limits, and the simulated flight.
struct Drawn {
    signals: Vec<Vec<f64>>,
    flown: FlightData,
    /// Factor by which the signals are smaller than requested.
    shrunk: f64,
    /// True when every step is followed by its opposite.
    returning: bool,
}

/// Generates the signals. A vehicle that integrates its inputs drifts under random steps even if it is stable
/// otherwise: there every step is followed by its opposite where that allows larger amplitudes.
fn draw(
    vehicle: &Vehicle,
    options: &Options,
    limits: &[f64],
    tops: &[(String, f64)],
) -> Result<Drawn, ExciteError> {
    let with = |integrations: usize| -> Result<Drawn, ExciteError> {
        let unit = signals::signals(&options.shape, tops.len(), integrations);
        let scaled = unit.iter().zip(tops).map(|(signal, (_, top))| signal.iter().map(|v| top * v).collect());
        let mut signals: Vec<Vec<f64>> = scaled.collect();
        let (flown, shrunk) = fly_within(vehicle, options, limits, &mut signals)?;
        Ok(Drawn { signals, flown, shrunk, returning: integrations > 0 })
    };
    let plain = with(0);
    let integrations = if options.closed.is_some() { 0 } else { integrations(vehicle) };
    let drifts = plain.as_ref().map_or(true, |drawn| drawn.shrunk < 1.0);
    if integrations == 0 || !drifts || options.shape.kind != Kind::Multistep {
        return plain.map_err(|error| match error {
            ExciteError::Unstable { name } if integrations > 0 => ExciteError::Integrates { name },
            error => error,
        });
    }
    match (plain, with(integrations)) {
        (Ok(plain), Ok(other)) => Ok(if other.shrunk > plain.shrunk { other } else { plain }),
        (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(one),
        (Err(ExciteError::Unstable { name }), Err(_)) => Err(ExciteError::Integrates { name }),
        (Err(error), Err(_)) => Err(error),
    }
}

/// Largest magnitude of a pole that counts as zero, as a share of the largest pole: a double pole is accurate
/// to the root of the rounding error.
const ZERO_POLE_SHARE: f64 = 1e-6;

/// Number of poles at zero; 0 when another pole is unstable.
fn integrations(vehicle: &Vehicle) -> usize {
    let poles = vehicle.poles().unwrap_or_default();
    let zero = ZERO_POLE_SHARE * poles.iter().map(|p| p.norm()).fold(0.0, f64::max);
    if poles.iter().any(|p| p.re > zero) { 0 } else { poles.iter().filter(|p| p.norm() <= zero).count() }
}

/// Reduces the signals until the predicted outputs stay within their limits; returns the flight and the
/// factor.
fn fly_within(
    vehicle: &Vehicle,
    options: &Options,
    limits: &[f64],
    signals: &mut [Vec<f64>],
) -> Result<(FlightData, f64), ExciteError> {
    let (shape, closed) = (&options.shape, options.closed.as_ref());
    let mut flown = fly(vehicle, shape.period_s, signals, closed)?;
    let mut shrunk = 1.0;
    // A linear vehicle needs one iteration, one with thresholds a few.
    for _ in 0..40 {
        let peaks = peaks(&flown, vehicle.outputs.len());
        let worst = peaks.iter().zip(limits).map(|(p, l)| p / l).fold(0.0, f64::max);
        if worst <= 1.0 {
            break;
        }
        let factor = if worst.is_finite() { (0.99 / worst).max(0.1) } else { 0.1 };
        shrunk *= factor;
        if shrunk < 1e-3 {
            let name = peaks.iter().zip(limits).position(|(p, l)| p > l).unwrap_or(0);
            return Err(ExciteError::Unstable { name: vehicle.outputs[name].name.clone() });
        }
        signals.iter_mut().flatten().for_each(|v| *v *= factor);
        flown = fly(vehicle, shape.period_s, signals, closed)?;
    }
    Ok((flown, shrunk))
}

fn limits(vehicle: &Vehicle, options: &Options) -> Vec<f64> {
    vehicle
        .outputs
        .iter()
        .map(|o| match options.limits.iter().find(|(n, _)| *n == o.name) {
            Some((_, limit)) => *limit,
            None if o.unit.si_symbol() == "rad" => options.angle_limit,
            None => f64::INFINITY,
        })
        .collect()
}

/// SI units of the inputs, and of the states whose setpoints are excited.
fn units(vehicle: &Vehicle, options: &Options) -> BTreeMap<String, ShownUnit> {
    let mut units: BTreeMap<String, ShownUnit> =
        vehicle.inputs.iter().map(|i| (i.name.clone(), i.unit.shown())).collect();
    if let Some(ClosedLoop { through: InjectionPoint::Setpoint(states), .. }) = &options.closed {
        units
            .extend(states.iter().map(|&j| (vehicle.states[j].name.clone(), vehicle.states[j].unit.shown())));
    }
    units
}

/// Name and largest value of each test signal.
fn tops(vehicle: &Vehicle, options: &Options, limits: &[f64]) -> Result<Vec<(String, f64)>, ExciteError> {
    if let Some(ClosedLoop { through: InjectionPoint::Setpoint(states), .. }) = &options.closed {
        return states
            .iter()
            .map(|&j| {
                let name = vehicle.states[j].name.clone();
                let shown = (0..limits.len()).find(|i| {
                    vehicle.c[(*i, j)] != 0.0 && vehicle.c.row(*i).iter().filter(|c| **c != 0.0).count() == 1
                });
                match shown.map(|i| limits[i] / vehicle.c[(i, j)].abs()) {
                    Some(range) if range.is_finite() => Ok((name, options.amplitude * range)),
                    _ => Err(ExciteError::NoRange { name, unit: vehicle.states[j].unit.to_string() }),
                }
            })
            .collect();
    }
    Ok(vehicle
        .inputs
        .iter()
        .map(|input| {
            let room = input.upper.min(-input.lower);
            let room = if room.is_finite() && room > 0.0 { room } else { 1.0 };
            (input.name.clone(), options.amplitude * room)
        })
        .collect())
}

/// Largest absolute predicted value of each output.
fn peaks(flown: &FlightData, outputs: usize) -> Vec<f64> {
    if flown.diverged { vec![f64::INFINITY; outputs] } else { greatest_of(&flown.outputs, outputs) }
}

/// Largest absolute value of each column.
fn greatest_of(rows: &[f64], columns: usize) -> Vec<f64> {
    let mut greatest = vec![0.0f64; columns];
    for row in rows.chunks_exact(columns.max(1)) {
        greatest.iter_mut().zip(row).for_each(|(g, v)| *g = g.max(v.abs()));
    }
    greatest
}
