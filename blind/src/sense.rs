//! Sensor model: noise, rounding, limits, dropouts and outliers, from the motion to the record.

use std::f64::consts::TAU;

use whirlstand_vehicle::{Effect, Engine, Kind, Place, Vehicle};

use super::error::BlindError;
use super::hidden::{Hidden, value};
use super::motion::Motion;
use super::noise::Colour;
use super::out_of_library::{OutOfLibrary, OutOfLibraryEffect};
use super::random::RandomStream;

/// The sensor noise of a trial.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Noise {
    pub colour: Colour,
    /// Standard deviation of each output, SI.
    pub std: Vec<f64>,
}

impl Noise {
    /// Draws the noise of all outputs (samples x outputs).
    pub fn draw(&self, samples: usize, period_s: f64, trial: u64) -> Vec<f64> {
        let p = self.std.len();
        let mut all = vec![0.0; samples * p];
        for (i, std) in self.std.iter().enumerate() {
            let mut stream = RandomStream::new(trial, &format!("noise {i}"));
            let values = self.colour.noise(samples, period_s, &mut stream);
            for (k, v) in values.into_iter().enumerate() {
                all[k * p + i] = std * v;
            }
        }
        all
    }
}

/// Operations of a sensor on its value at each sample, in order.
enum Operation {
    Scale(f64),
    Bias(f64),
    Drift(f64),
    Tone { hz: f64, amplitude: f64, phase: f64 },
    Square(f64),
    Cube(f64),
    Sweep { from_hz: f64, amplitude: f64, length_s: f64 },
    Record,
    White(f64, RandomStream),
    Round(f64),
    Limit(f64, f64),
    Drop(f64, RandomStream),
    Outlier(f64, f64, RandomStream),
}

/// The sensors of a vehicle, which process a record sample by sample.
pub(crate) struct Sensors<'a> {
    vehicle: &'a Vehicle,
    /// Misaligned pairs of outputs, with their angle of rotation, rad.
    turned: Vec<(usize, usize, f64)>,
    channels: Vec<Channel>,
    period_s: f64,
}

struct Channel {
    operations: Vec<Operation>,
    /// Number of samples from one new measurement to the next.
    every: usize,
    last: f64,
    kept: Option<f64>,
}

impl<'a> Sensors<'a> {
    /// The sensors, ready for the first of `samples` samples.
    pub fn new(
        vehicle: &'a Vehicle,
        samples: usize,
        period_s: f64,
        hidden: Hidden<'_>,
    ) -> Result<Self, BlindError> {
        let mut placed: Vec<(usize, &Effect, Place)> = Vec::new();
        for (index, effect) in vehicle.effects.iter().chain(hidden.effects).enumerate() {
            placed.push((index, effect, effect.resolve(vehicle).map_err(BlindError::effect)?));
        }
        let mut turned = Vec::new();
        for (_, effect, place) in &placed {
            if let Place::OutputPair(i, j) = *place {
                turned.push((i, j, value(effect, "angle_rad")));
            }
        }
        let length_s = samples as f64 * period_s;
        let channel = |i: usize| {
            let own: Vec<(usize, &Effect)> =
                placed.iter().filter(|(_, _, q)| *q == Place::Output(i)).map(|(k, e, _)| (*k, *e)).collect();
            let every = if hidden.expected { 1 } else { vehicle.outputs[i].every.max(1) as usize };
            Channel {
                operations: operations(vehicle, i, &own, hidden, length_s),
                every,
                last: 0.0,
                kept: None,
            }
        };
        let channels = (0..vehicle.outputs.len()).map(channel).collect();
        Ok(Self { vehicle, turned, channels, period_s })
    }

    /// Converts sample `k` in place from the true sensor inputs to the reported values. `noise` is added
    /// after the deterministic sensor errors.
    pub fn sample(&mut self, k: usize, row: &mut [f64], noise: Option<&[f64]>) {
        for (i, j, angle) in &self.turned {
            turn(self.vehicle, row, *i, *j, *angle);
        }
        for (i, (channel, y)) in self.channels.iter_mut().zip(row).enumerate() {
            if k.is_multiple_of(channel.every) {
                let added = noise.map_or(0.0, |n| n[i]);
                channel.last =
                    one(&mut channel.operations, *y, added, k as f64 * self.period_s, &mut channel.kept);
            }
            *y = channel.last;
        }
    }
}

/// The record of a motion (samples x outputs).
pub(crate) fn sense(
    vehicle: &Vehicle,
    motion: &Motion,
    noise: Option<&[f64]>,
    period_s: f64,
    hidden: Hidden<'_>,
) -> Result<Vec<f64>, BlindError> {
    let p = vehicle.outputs.len();
    let mut sensors = Sensors::new(vehicle, motion.samples, period_s, hidden)?;
    let mut sensed = motion.sensed.clone();
    for (k, row) in sensed.chunks_exact_mut(p).enumerate() {
        sensors.sample(k, row, noise.map(|n| &n[k * p..(k + 1) * p]));
    }
    Ok(sensed)
}

/// Rotates a pair of outputs by `angle`, and their rates with them.
fn turn(vehicle: &Vehicle, row: &mut [f64], i: usize, j: usize, angle: f64) {
    let rate = |i: usize| vehicle.output_index(&format!("{}_rate", vehicle.outputs[i].name));
    let rates = rate(i).zip(rate(j));
    for (i, j) in std::iter::once((i, j)).chain(rates) {
        let (first, second) = (row[i], row[j]);
        row[i] = first * angle.cos() + second * angle.sin();
        row[j] = second * angle.cos() - first * angle.sin();
    }
}

fn operations(
    vehicle: &Vehicle,
    output: usize,
    own: &[(usize, &Effect)],
    hidden: Hidden<'_>,
    length_s: f64,
) -> Vec<Operation> {
    let declared = &vehicle.outputs[output];
    let of = |kind: Kind| own.iter().filter(move |(_, e)| e.kind() == kind);
    let stream = |index: usize, what: &str| RandomStream::new(hidden.trial, &format!("{what} {index}"));
    let mut operations = Vec::new();
    operations.extend(of(Kind::SensorScale).map(|(_, e)| Operation::Scale(value(e, "factor"))));
    let outside = |kind: OutOfLibrary| {
        hidden.outside.filter(|o: &&OutOfLibraryEffect| o.kind == kind && o.output == output)
    };
    operations.extend(outside(OutOfLibrary::SquaredSensor).map(|o| Operation::Square(o.size)));
    operations.extend(outside(OutOfLibrary::CubedSensor).map(|o| Operation::Cube(o.size)));
    operations.push(Operation::Bias(declared.bias));
    operations.extend(of(Kind::SensorBias).map(|(_, e)| Operation::Bias(value(e, "offset"))));
    operations.extend(of(Kind::SensorDrift).map(|(_, e)| Operation::Drift(value(e, "rate_per_s"))));
    if let Some(v) = declared.vibration.as_ref().filter(|_| !hidden.expected) {
        for (harmonic, relative) in (1u32..).zip(&v.harmonics) {
            let h = f64::from(harmonic);
            let amplitude = relative * v.amplitude(Engine::Flying);
            operations.push(Operation::Tone { hz: h * v.frequency_hz, amplitude, phase: h * v.phase_rad });
        }
    }
    operations.extend(of(Kind::Vibration).map(|(_, e)| Operation::Tone {
        hz: value(e, "frequency_hz"),
        amplitude: value(e, "amplitude"),
        phase: value(e, "phase_rad"),
    }));
    operations.extend(outside(OutOfLibrary::SweepingTone).map(|o| Operation::Sweep {
        from_hz: o.scale,
        amplitude: o.size,
        length_s,
    }));
    operations.push(Operation::Record);
    if !hidden.expected {
        operations.extend(
            of(Kind::Noise).map(|(k, e)| Operation::White(value(e, "std"), stream(*k, "more noise"))),
        );
        operations.extend(Some(declared.quantization).filter(|q| *q > 0.0).map(Operation::Round));
        operations.extend(of(Kind::Quantization).map(|(_, e)| Operation::Round(value(e, "step"))));
    }
    operations.extend(
        of(Kind::OutputSaturation).map(|(_, e)| Operation::Limit(value(e, "lower"), value(e, "upper"))),
    );
    if !hidden.expected {
        operations.extend(
            of(Kind::Dropouts).map(|(k, e)| Operation::Drop(value(e, "fraction"), stream(*k, "dropouts"))),
        );
        operations.extend(of(Kind::Outliers).map(|(k, e)| {
            Operation::Outlier(value(e, "fraction"), value(e, "magnitude"), stream(*k, "outliers"))
        }));
    }
    operations
}

/// Applies all operations to one sample; `kept` holds the last value before outliers.
fn one(operations: &mut [Operation], sensed: f64, noise: f64, t: f64, kept: &mut Option<f64>) -> f64 {
    let mut y = sensed;
    let mut delivered = None;
    for operation in operations {
        match operation {
            Operation::Scale(factor) => y *= *factor,
            Operation::Bias(offset) => y += *offset,
            Operation::Drift(rate) => y += *rate * t,
            Operation::Tone { hz, amplitude, phase } => {
                y += *amplitude * (TAU * (*hz * t).fract() + *phase).sin();
            }
            Operation::Square(size) => y += *size * y * y,
            Operation::Cube(size) => y += *size * y.powi(3),
            Operation::Sweep { from_hz, amplitude, length_s } => {
                // The frequency grows linearly with time, from f to 3 f.
                y += *amplitude * (TAU * *from_hz * t * (1.0 + t / *length_s)).sin();
            }
            Operation::Record => y += noise,
            Operation::White(std, stream) => y += *std * stream.normal(),
            Operation::Round(step) if *step > 0.0 => y = *step * (y / *step).round(),
            Operation::Round(_) => {}
            Operation::Limit(lower, upper) => y = y.max(*lower).min(*upper),
            Operation::Drop(fraction, stream) => {
                if stream.chance(*fraction) {
                    y = kept.unwrap_or(y);
                }
            }
            Operation::Outlier(fraction, magnitude, stream) => {
                delivered.get_or_insert(y);
                let side = stream.sign();
                if stream.chance(*fraction) {
                    y += side * *magnitude;
                }
            }
        }
    }
    *kept = Some(delivered.unwrap_or(y));
    y
}
