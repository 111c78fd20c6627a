//! The vehicles of the trials: built-in ones, and stable linear vehicles drawn at random.

use std::fmt::Write;

use nalgebra::DMatrix;
use whirlstand_vehicle::Vehicle;

use super::commands::Commands;
use super::error::BlindError;
use super::excitation::Excitation;
use super::linear::model;
use super::manoeuvres::{CommandFormat, commands};
use super::poles::{fastest, rightmost};
use super::random::RandomStream;
use super::ranges::{Ranges, VehicleRanges};

/// The helicopters, between which mode transitions are possible.
pub(crate) const HELICOPTERS: [&str; 3] =
    ["helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"];

/// The nominal vehicle of a trial.
#[derive(Debug, Clone)]
pub(crate) struct Nominal {
    /// The vehicle that the diagnosis is given, parsed from `toml`.
    pub vehicle: Vehicle,
    /// Text of the vehicle file.
    pub toml: String,
    /// Highest frequency of the excitation, Hz.
    pub highest_hz: f64,
}

impl Nominal {
    /// The vehicle as read back from its written file.
    pub fn new(vehicle: &Vehicle) -> Result<Self, BlindError> {
        let toml = vehicle.to_toml();
        let mut vehicle = Vehicle::parse(&toml, "nominal.toml").map_err(BlindError::effect)?;
        vehicle.source_text.clear();
        if let Some(output) = vehicle.outputs.iter().find(|o| o.noise <= 0.0) {
            return Err(BlindError::NoNoise { vehicle: vehicle.name.clone(), output: output.name.clone() });
        }
        let highest_hz = band(&vehicle.a);
        Ok(Self { vehicle, toml, highest_hz })
    }
}

/// The vehicle file without the sensor noise, as of a user who does not know it.
pub(crate) fn without_noise(vehicle: &Vehicle) -> String {
    let mut silent = vehicle.clone();
    silent.outputs.iter_mut().for_each(|output| output.noise = 0.0);
    silent.to_toml()
}

/// Approximately the highest frequency that the vehicle follows, Hz.
fn band(a: &DMatrix<f64>) -> f64 {
    (1.2 * fastest(a) / std::f64::consts::TAU).clamp(0.3, 3.0)
}

/// Draws a vehicle; with `helicopter`, one of the helicopters.
pub(crate) fn draw(
    helicopter: bool,
    free: bool,
    ranges: &Ranges,
    stream: &mut RandomStream,
) -> Result<Nominal, BlindError> {
    let own = &ranges.vehicles;
    let which = stream.unit();
    let vehicle = if helicopter || which < own.helicopters {
        self::helicopter(own, stream)?
    } else if which < own.helicopters + own.quadrotors {
        plain(Vehicle::builtin("quadrotor").map_err(BlindError::effect)?)
    } else {
        random(ranges, stream)?
    };
    let mut vehicle = vehicle;
    if !free {
        vehicle.free.clear();
    }
    Nominal::new(&vehicle)
}

/// Removes the declared vibration, whose phase is unknown, and sets every sensor to the full rate.
fn plain(mut vehicle: Vehicle) -> Vehicle {
    for output in &mut vehicle.outputs {
        output.vibration = None;
        output.every = 1;
    }
    vehicle
}

/// A helicopter, sometimes without its position outputs, which only integrate the speeds.
fn helicopter(ranges: &VehicleRanges, stream: &mut RandomStream) -> Result<Vehicle, BlindError> {
    let name = HELICOPTERS[stream.below(HELICOPTERS.len())];
    let mut vehicle = plain(Vehicle::builtin(name).map_err(BlindError::effect)?);
    if stream.chance(ranges.without_positions) {
        let kept: Vec<usize> =
            (0..vehicle.outputs.len()).filter(|i| !vehicle.outputs[*i].name.ends_with("_position")).collect();
        vehicle.c = vehicle.c.select_rows(&kept);
        vehicle.d = vehicle.d.select_rows(&kept);
        vehicle.outputs = kept.iter().map(|i| vehicle.outputs[*i].clone()).collect();
    }
    Ok(vehicle)
}

/// A stable vehicle of two to six states: either coupled axes with position and rate, or a dense random
/// matrix.
fn random(ranges: &Ranges, stream: &mut RandomStream) -> Result<Vehicle, BlindError> {
    let own = &ranges.vehicles;
    let built = if stream.chance(0.7) { axes(own, stream) } else { dense(own, stream) };
    let text = built.text(&vec![1.0; built.outputs.len()]);
    let vehicle = Vehicle::parse(&text, "random").map_err(BlindError::effect)?;
    // The noise of each sensor is a realistic share of the response to pilot-like commands.
    let period_s = 0.01;
    let highest = band(&vehicle.a);
    let format = CommandFormat { inputs: vehicle.inputs.len(), samples: 3000, period_s, highest_hz: highest };
    let commands =
        Commands { period_s, inputs: commands(Excitation::Pilot, &ranges.excitation, format, stream) };
    let response = model(&vehicle, &vec![0.0; vehicle.states.len()], &commands);
    let p = vehicle.outputs.len();
    let noise: Vec<f64> = (0..p)
        .map(|i| {
            let square: f64 = response.iter().skip(i).step_by(p).map(|y| y * y).sum();
            let rms = (square * p as f64 / response.len() as f64).sqrt();
            let noise = rms * stream.scaled_within(own.noise_share);
            // Round to two significant digits, as in a data sheet.
            format!("{noise:.1e}").parse().unwrap_or(noise)
        })
        .collect();
    Vehicle::parse(&built.text(&noise), "random").map_err(BlindError::effect)
}

/// The matrices and names of a drawn vehicle.
struct Built {
    name: String,
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    /// Name and unit of each state.
    states: Vec<(String, &'static str)>,
    /// Indices of the states that are measured.
    outputs: Vec<usize>,
}

impl Built {
    fn text(&self, noise: &[f64]) -> String {
        let matrix = |m: &DMatrix<f64>| -> String {
            let row = |i: usize| -> String {
                let entries: Vec<String> = m.row(i).iter().map(|v| format!("{v:?}")).collect();
                format!("    [{}],\n", entries.join(", "))
            };
            (0..m.nrows()).map(row).collect()
        };
        let mut text = format!("name = \"{}\"\n", self.name);
        // Writing to a string cannot fail.
        let _ = write!(text, "A = [\n{}]\nB = [\n{}]\n", matrix(&self.a), matrix(&self.b));
        text.push_str("states = [\n");
        for (name, unit) in &self.states {
            let _ = writeln!(text, "    {{ name = \"{name}\", unit = \"{unit}\" }},");
        }
        text.push_str("]\ninputs = [\n");
        for j in 0..self.b.ncols() {
            let _ = writeln!(text, "    {{ name = \"u{}\", lower = -1.0, upper = 1.0 }},", j + 1);
        }
        text.push_str("]\n");
        for (&i, noise) in self.outputs.iter().zip(noise) {
            let (name, unit) = &self.states[i];
            let _ = write!(text, "[[outputs]]\nname = \"{name}\"\nunit = \"{unit}\"\nnoise = {noise:?}\n");
        }
        text
    }
}

/// Rounds to four decimals, as in a hand-written file.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn axes(ranges: &VehicleRanges, stream: &mut RandomStream) -> Built {
    const AXES: [&str; 3] = ["alpha", "beta", "gamma"];
    let count = 1 + stream.below(3);
    let speed = count < 3 && stream.chance(0.4);
    let (n, m) = (2 * count + usize::from(speed), count.min(2));
    let (mut a, mut b) = (DMatrix::zeros(n, n), DMatrix::zeros(n, m));
    let mut states = Vec::new();
    for i in 0..count {
        states.push((AXES[i].to_string(), "rad"));
        states.push((format!("{}_rate", AXES[i]), "rad/s"));
        let (w, damping) = (stream.scaled_within(ranges.axis_rad_s), stream.within(ranges.axis_damping));
        a[(2 * i, 2 * i + 1)] = 1.0;
        a[(2 * i + 1, 2 * i)] = rounded(-w * w);
        a[(2 * i + 1, 2 * i + 1)] = rounded(-2.0 * damping * w);
        // Couplings act in one direction only, so that they do not move the poles.
        for k in 0..i {
            a[(2 * i + 1, 2 * k)] = rounded(ranges.axis_coupling * w * w * stream.between(-1.0, 1.0));
            a[(2 * i + 1, 2 * k + 1)] = rounded(ranges.axis_coupling * w * stream.between(-1.0, 1.0));
        }
        for j in 0..m {
            let own = j == i % m;
            let size = if own {
                stream.sign() * stream.within(ranges.axis_gain)
            } else {
                stream.between(-0.15, 0.15)
            };
            b[(2 * i + 1, j)] = rounded(w * w * size);
        }
    }
    if speed {
        states.push(("speed".into(), "m/s"));
        a[(n - 1, 0)] = rounded(9.81 * stream.sign());
        a[(n - 1, n - 1)] = rounded(-stream.scaled_within(ranges.speed_damping));
    }
    let rates = stream.chance(0.7);
    let outputs = (0..n).filter(|i| rates || i % 2 == 0).collect();
    Built { name: "drawn-axes".into(), a, b, states, outputs }
}

fn dense(ranges: &VehicleRanges, stream: &mut RandomStream) -> Built {
    let n = 2 + stream.below(5);
    let m = 1 + stream.below(2);
    let mut a = DMatrix::from_fn(n, n, |_, _| 1.5 * stream.normal());
    let shift = rightmost(&a) + stream.within(ranges.stability_margin);
    for i in 0..n {
        a[(i, i)] -= shift;
    }
    let a = a.map(rounded);
    let b = DMatrix::from_fn(n, m, |_, _| rounded(2.0 * stream.normal()));
    let states: Vec<(String, &'static str)> = (1..=n).map(|i| (format!("x{i}"), "1")).collect();
    let all = stream.chance(0.5);
    let outputs = (0..n).filter(|i| all || *i == 0 || stream.chance(0.5)).collect();
    Built { name: "drawn".into(), a, b, states, outputs }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::Generator;

    #[test]
    fn drawn_vehicles_are_stable_and_read_back() {
        for trial in 0..400 {
            let generator = if trial < 200 { Generator::Reference } else { Generator::Shifted };
            let mut stream = RandomStream::new(trial, "vehicle");
            let nominal = draw(false, trial % 2 == 0, generator.ranges(), &mut stream).unwrap();
            let vehicle = &nominal.vehicle;
            assert!(!vehicle.outputs.is_empty() && !vehicle.inputs.is_empty());
            let right = rightmost(&vehicle.a);
            // The positions of the helicopters are integrators, with poles at 0.
            assert!(right < 1e-9, "{} {right}", vehicle.name);
            assert!(vehicle.outputs.iter().all(|o| o.noise > 0.0 && o.every == 1));
        }
    }
}
