//! From the motion to the record: what sensors add, round, limit, lose and spoil.

use std::f64::consts::TAU;

use whirlstand_vehicle::{Effect, Engine, Kind, Place, Vehicle};

use super::BlindError;
use super::motion::Motion;
use super::noise::Colour;
use super::outside::{Outside, Strange};
use super::plant::{Hidden, value};
use super::random::Dice;

/// The sensor noise of a trial.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Noise {
    pub colour: Colour,
    /// Standard deviation of each output, SI.
    pub std: Vec<f64>,
}

impl Noise {
    /// The noise itself: samples x outputs.
    pub fn draw(&self, samples: usize, period_s: f64, trial: u64) -> Vec<f64> {
        let p = self.std.len();
        let mut all = vec![0.0; samples * p];
        for (i, std) in self.std.iter().enumerate() {
            let mut dice = Dice::new(trial, &format!("noise {i}"));
            let values = self.colour.noise(samples, period_s, &mut dice);
            for (k, v) in values.into_iter().enumerate() {
                all[k * p + i] = std * v;
            }
        }
        all
    }
}

/// What a sensor does to its value at each sample, in order.
enum Act {
    Scale(f64),
    Bias(f64),
    Drift(f64),
    Tone { hz: f64, amplitude: f64, phase: f64 },
    Square(f64),
    Sweep { from_hz: f64, amplitude: f64, length_s: f64 },
    Record,
    White(f64, Dice),
    Round(f64),
    Limit(f64, f64),
    Drop(f64, Dice),
    Outlier(f64, f64, Dice),
}

/// Samples x outputs as they stand in the record; `noise` is added where a sensor's noise enters.
pub(crate) fn sense(
    vehicle: &Vehicle,
    motion: &Motion,
    noise: Option<&[f64]>,
    period_s: f64,
    hidden: Hidden<'_>,
) -> Result<Vec<f64>, BlindError> {
    let p = vehicle.outputs.len();
    let mut seen = motion.seen.clone();
    let mut placed: Vec<(usize, &Effect, Place)> = Vec::new();
    for (index, effect) in vehicle.effects.iter().chain(hidden.effects).enumerate() {
        placed.push((index, effect, effect.resolve(vehicle).map_err(BlindError::effect)?));
    }
    for (_, effect, place) in &placed {
        if let Place::OutputPair(i, j) = *place {
            turn(vehicle, &mut seen, i, j, value(effect, "angle_rad"));
        }
    }
    let length_s = motion.samples as f64 * period_s;
    for i in 0..p {
        let own: Vec<(usize, &Effect)> =
            placed.iter().filter(|(_, _, q)| *q == Place::Output(i)).map(|(k, e, _)| (*k, *e)).collect();
        let mut acts = acts(vehicle, i, &own, hidden, length_s);
        let every = if hidden.expected { 1 } else { vehicle.outputs[i].every.max(1) as usize };
        let mut last = 0.0;
        let mut kept: Option<f64> = None;
        for k in 0..motion.samples {
            if k % every == 0 {
                let added = noise.map_or(0.0, |n| n[k * p + i]);
                last = one(&mut acts, seen[k * p + i], added, k as f64 * period_s, &mut kept);
            }
            seen[k * p + i] = last;
        }
    }
    Ok(seen)
}

/// Turns a pair of outputs into each other, and their rates with them.
fn turn(vehicle: &Vehicle, seen: &mut [f64], i: usize, j: usize, angle: f64) {
    let rate = |i: usize| vehicle.output_index(&format!("{}_rate", vehicle.outputs[i].name));
    let rates = rate(i).zip(rate(j));
    for (i, j) in std::iter::once((i, j)).chain(rates) {
        for row in seen.chunks_exact_mut(vehicle.outputs.len()) {
            let (first, second) = (row[i], row[j]);
            row[i] = first * angle.cos() + second * angle.sin();
            row[j] = second * angle.cos() - first * angle.sin();
        }
    }
}

fn acts(
    vehicle: &Vehicle,
    output: usize,
    own: &[(usize, &Effect)],
    hidden: Hidden<'_>,
    length_s: f64,
) -> Vec<Act> {
    let declared = &vehicle.outputs[output];
    let of = |kind: Kind| own.iter().filter(move |(_, e)| e.kind() == kind);
    let dice = |index: usize, what: &str| Dice::new(hidden.trial, &format!("{what} {index}"));
    let mut acts = Vec::new();
    acts.extend(of(Kind::SensorScale).map(|(_, e)| Act::Scale(value(e, "factor"))));
    let outside =
        |strange: Strange| hidden.outside.filter(|o: &&Outside| o.strange == strange && o.output == output);
    acts.extend(outside(Strange::SquaredSensor).map(|o| Act::Square(o.size)));
    acts.push(Act::Bias(declared.bias));
    acts.extend(of(Kind::SensorBias).map(|(_, e)| Act::Bias(value(e, "offset"))));
    acts.extend(of(Kind::SensorDrift).map(|(_, e)| Act::Drift(value(e, "rate_per_s"))));
    if let Some(v) = declared.vibration.as_ref().filter(|_| !hidden.expected) {
        for (harmonic, relative) in (1u32..).zip(&v.harmonics) {
            let h = f64::from(harmonic);
            let amplitude = relative * v.amplitude(Engine::Flying);
            acts.push(Act::Tone { hz: h * v.frequency_hz, amplitude, phase: h * v.phase_rad });
        }
    }
    acts.extend(of(Kind::Vibration).map(|(_, e)| Act::Tone {
        hz: value(e, "frequency_hz"),
        amplitude: value(e, "amplitude"),
        phase: value(e, "phase_rad"),
    }));
    acts.extend(outside(Strange::SweepingTone).map(|o| Act::Sweep {
        from_hz: o.scale,
        amplitude: o.size,
        length_s,
    }));
    acts.push(Act::Record);
    if !hidden.expected {
        acts.extend(of(Kind::Noise).map(|(k, e)| Act::White(value(e, "std"), dice(*k, "more noise"))));
        acts.extend(Some(declared.quantization).filter(|q| *q > 0.0).map(Act::Round));
        acts.extend(of(Kind::Quantization).map(|(_, e)| Act::Round(value(e, "step"))));
    }
    acts.extend(of(Kind::OutputSaturation).map(|(_, e)| Act::Limit(value(e, "lower"), value(e, "upper"))));
    if !hidden.expected {
        acts.extend(of(Kind::Dropouts).map(|(k, e)| Act::Drop(value(e, "fraction"), dice(*k, "dropouts"))));
        acts.extend(
            of(Kind::Outliers).map(|(k, e)| {
                Act::Outlier(value(e, "fraction"), value(e, "magnitude"), dice(*k, "outliers"))
            }),
        );
    }
    acts
}

/// One sample through all of them; `kept` is the last value before outliers.
fn one(acts: &mut [Act], seen: f64, noise: f64, t: f64, kept: &mut Option<f64>) -> f64 {
    let mut y = seen;
    let mut delivered = None;
    for act in acts {
        match act {
            Act::Scale(factor) => y *= *factor,
            Act::Bias(offset) => y += *offset,
            Act::Drift(rate) => y += *rate * t,
            Act::Tone { hz, amplitude, phase } => {
                y += *amplitude * (TAU * (*hz * t).fract() + *phase).sin();
            }
            Act::Square(size) => y += *size * y * y,
            Act::Sweep { from_hz, amplitude, length_s } => {
                // The frequency grows in proportion to time, from f to 3 f.
                y += *amplitude * (TAU * *from_hz * t * (1.0 + t / *length_s)).sin();
            }
            Act::Record => y += noise,
            Act::White(std, dice) => y += *std * dice.normal(),
            Act::Round(step) if *step > 0.0 => y = *step * (y / *step).round(),
            Act::Round(_) => {}
            Act::Limit(lower, upper) => y = y.max(*lower).min(*upper),
            Act::Drop(fraction, dice) => {
                if dice.chance(*fraction) {
                    y = kept.unwrap_or(y);
                }
            }
            Act::Outlier(fraction, magnitude, dice) => {
                delivered.get_or_insert(y);
                let side = dice.sign();
                if dice.chance(*fraction) {
                    y += side * *magnitude;
                }
            }
        }
    }
    *kept = Some(delivered.unwrap_or(y));
    y
}
