//! From the motion to what the sensors report.

use std::f64::consts::TAU;

use super::compile::{Row, System};
use super::disturbances::consumer;
use super::tap::Tap;
use crate::effects::{Effect, Kind, Place};
use crate::model::{Engine, Output, Vehicle};
use crate::random::Stream;

/// Rounds to a multiple of the step.
pub fn quantize(value: f64, step: f64) -> f64 {
    if step == 0.0 { value } else { step * libm::round(value / step) }
}

#[derive(Debug, Clone)]
struct Tone {
    frequency_hz: f64,
    amplitude: f64,
    phase_rad: f64,
}

/// Declared vibration: harmonics of one of the sensors' common frequencies.
#[derive(Debug, Clone)]
struct EngineTone {
    frequency: usize,
    /// Relative amplitude times cosine and sine of each harmonic's phase.
    harmonics: Vec<[f64; 2]>,
    amplitudes: [f64; 3],
}

#[derive(Debug, Clone)]
struct Sensor {
    /// The motion, without and with the sensor's own lag.
    ideal: Row,
    lagged: Row,
    tap: Option<Tap>,
    every: u64,
    /// The step from which on a new value is due.
    due: u64,
    gain: f64,
    offset: f64,
    drift: f64,
    tones: Vec<Tone>,
    engine: Option<EngineTone>,
    noise: Vec<(f64, Stream)>,
    rounding: Vec<f64>,
    limits: Vec<(f64, f64)>,
    dropouts: Vec<(f64, Stream)>,
    outliers: Vec<(f64, f64, Stream)>,
    /// Last value before outliers: what a dropout repeats.
    delivered: Option<f64>,
    /// Scale, offset and drift are all there is while the engine is off.
    plain: bool,
}

/// All sensors of a vehicle.
#[derive(Debug, Clone)]
pub struct Sensors {
    period_s: f64,
    sensors: Vec<Sensor>,
    /// Distinct frequencies of declared vibrations, Hz, and sine and cosine of their phase at the present step.
    frequencies: Vec<(f64, f64, f64)>,
    /// True when a sensor looks back in time.
    delayed: bool,
    /// Pairs of outputs that turn into each other: indices, cosine, sine.
    turned: Vec<(usize, usize, f64, f64)>,
    motion: Vec<f64>,
    values: Vec<f64>,
    fresh: Vec<bool>,
    /// The step that `values` belong to.
    measured: Option<u64>,
}

impl Sensors {
    /// `seed` is `None` for expected values: no randomness, no rounding, every output fresh at every step.
    pub fn new(
        vehicle: &Vehicle,
        system: &System,
        effects: &[(Effect, Place)],
        period_s: f64,
        seed: Option<u64>,
    ) -> Self {
        let mut frequencies: Vec<(f64, f64, f64)> = Vec::new();
        let rows = vehicle.outputs.iter().zip(&system.outputs);
        let mut sensors: Vec<Sensor> =
            rows.map(|(output, rows)| declared(output, rows, &mut frequencies, seed)).collect();
        let mut turned = Vec::new();
        let mut delays = vec![0.0; sensors.len()];
        for (index, (effect, place)) in effects.iter().enumerate() {
            match *place {
                Place::OutputPair(i, j) => {
                    let (sine, cosine) = libm::sincos(effect.get("angle_rad"));
                    turned.push((i, j, cosine, sine));
                    let rate = |i: usize| vehicle.output_index(&format!("{}_rate", vehicle.outputs[i].name));
                    if let (Some(i), Some(j)) = (rate(i), rate(j)) {
                        turned.push((i, j, cosine, sine));
                    }
                }
                Place::Output(i) if effect.kind() == Kind::SensorDelay => delays[i] += effect.get("delay_s"),
                Place::Output(i) => {
                    let stream = seed.map(|seed| Stream::new(seed, &consumer(effects, index)));
                    sensors[i].add(effect, stream);
                }
                _ => {}
            }
        }
        for (sensor, delay_s) in sensors.iter_mut().zip(delays) {
            sensor.tap = Tap::new(delay_s, period_s);
        }
        let p = sensors.len();
        for sensor in &mut sensors {
            sensor.plain = sensor.is_plain();
        }
        Self {
            period_s,
            delayed: sensors.iter().any(|s| s.tap.is_some()),
            sensors,
            frequencies,
            turned,
            motion: vec![0.0; p],
            values: vec![0.0; p],
            fresh: vec![false; p],
            measured: None,
        }
    }

    /// Offsets inside every step at which a delayed output must be looked at.
    pub fn cuts_s(&self) -> impl Iterator<Item = f64> + '_ {
        self.sensors.iter().filter_map(|s| Some(s.tap.as_ref()?.offset_s)).filter(|o| *o > 0.0)
    }

    pub fn has_delay(&self) -> bool {
        self.delayed
    }

    /// The past becomes what the outputs are now.
    pub fn fill_past(&mut self, z: &[f64], v: &[f64]) {
        for sensor in &mut self.sensors {
            let value = sensor.lagged.value(z, v);
            if let Some(tap) = &mut sensor.tap {
                tap.fill(value);
            }
        }
        self.measured = None;
    }

    /// Lets delayed outputs remember what they are at this offset of a step.
    pub fn remember(&mut self, offset_s: f64, z: &[f64], v: &[f64]) {
        if !self.delayed {
            return;
        }
        let tolerance = 2.0 * super::inputs::TIME_TOLERANCE * self.period_s;
        for sensor in &mut self.sensors {
            if let Some(tap) = &mut sensor.tap
                && (tap.offset_s - offset_s).abs() <= tolerance
            {
                let value = sensor.lagged.value(z, v);
                tap.push(value);
            }
        }
    }

    /// What the outputs would be without any sensor.
    pub fn ideal(&self, z: &[f64], v: &[f64], out: &mut [f64]) {
        for (value, sensor) in out.iter_mut().zip(&self.sensors) {
            *value = sensor.ideal.value(z, v);
        }
    }

    /// Measures at a step; a second call at the same step changes nothing.
    pub fn measure(&mut self, step: u64, engine: Engine, z: &[f64], v: &[f64]) -> &[f64] {
        if self.measured == Some(step) {
            return &self.values;
        }
        self.measured = Some(step);
        for (motion, sensor) in self.motion.iter_mut().zip(&self.sensors) {
            *motion = sensor.tap.as_ref().map_or_else(|| sensor.lagged.value(z, v), Tap::value);
        }
        for &(i, j, cosine, sine) in &self.turned {
            let (first, second) = (self.motion[i], self.motion[j]);
            self.motion[i] = cosine * first + sine * second;
            self.motion[j] = cosine * second - sine * first;
        }
        let t = step as f64 * self.period_s;
        if engine != Engine::Off {
            for (frequency_hz, sine, cosine) in &mut self.frequencies {
                (*sine, *cosine) = phase(*frequency_hz, t);
            }
        }
        for (index, sensor) in self.sensors.iter_mut().enumerate() {
            // The first measurement is fresh at whatever step it is; later ones fall on multiples of the divider.
            self.fresh[index] = step >= sensor.due;
            if self.fresh[index] {
                sensor.due =
                    if sensor.every == 1 { step + 1 } else { (step / sensor.every + 1) * sensor.every };
                self.values[index] = if sensor.plain && engine == Engine::Off {
                    sensor.gain * self.motion[index] + sensor.offset + sensor.drift * t
                } else {
                    sensor.value(self.motion[index], t, engine, &self.frequencies)
                };
            }
        }
        &self.values
    }

    pub fn fresh(&self) -> &[bool] {
        &self.fresh
    }
}

fn declared(
    output: &Output,
    (ideal, lagged): &(Row, Row),
    frequencies: &mut Vec<(f64, f64, f64)>,
    seed: Option<u64>,
) -> Sensor {
    let engine = output.vibration.as_ref().map(|v| {
        let known = frequencies.iter().position(|(f, _, _)| *f == v.frequency_hz);
        let frequency = known.unwrap_or_else(|| {
            frequencies.push((v.frequency_hz, 0.0, 1.0));
            frequencies.len() - 1
        });
        let phases = v.harmonics.iter().zip(1u32..).map(|(relative, h)| {
            let (sine, cosine) = libm::sincos(f64::from(h) * v.phase_rad);
            [relative * cosine, relative * sine]
        });
        let amplitudes = [Engine::Off, Engine::On, Engine::Flying].map(|engine| v.amplitude(engine));
        EngineTone { frequency, harmonics: phases.collect(), amplitudes }
    });
    let stream = |seed| Stream::new(seed, &format!("noise/{}", output.name));
    let noise = seed.filter(|_| output.noise > 0.0).map(|seed| (output.noise, stream(seed)));
    Sensor {
        ideal: ideal.clone(),
        lagged: lagged.clone(),
        tap: None,
        every: if seed.is_some() { u64::from(output.every) } else { 1 },
        due: 0,
        gain: 1.0,
        offset: output.bias,
        drift: 0.0,
        tones: Vec::new(),
        engine,
        noise: noise.into_iter().collect(),
        rounding: Some(output.quantization).filter(|q| seed.is_some() && *q > 0.0).into_iter().collect(),
        limits: Vec::new(),
        dropouts: Vec::new(),
        outliers: Vec::new(),
        delivered: None,
        plain: false,
    }
}

impl Sensor {
    /// Adds an effect; random ones and rounding only act with a stream.
    fn add(&mut self, effect: &Effect, stream: Option<Stream>) {
        match (effect.kind(), stream) {
            (Kind::SensorBias, _) => self.offset += effect.get("offset"),
            (Kind::SensorDrift, _) => self.drift += effect.get("rate_per_s"),
            (Kind::SensorScale, _) => self.gain *= effect.get("factor"),
            (Kind::Vibration, _) => self.tones.push(Tone {
                frequency_hz: effect.get("frequency_hz"),
                amplitude: effect.get("amplitude"),
                phase_rad: effect.get("phase_rad"),
            }),
            (Kind::OutputSaturation, _) => self.limits.push((effect.get("lower"), effect.get("upper"))),
            (Kind::Noise, Some(stream)) => self.noise.push((effect.get("std"), stream)),
            (Kind::Quantization, Some(_)) => self.rounding.push(effect.get("step")),
            (Kind::Dropouts, Some(stream)) => self.dropouts.push((effect.get("fraction"), stream)),
            (Kind::Outliers, Some(stream)) => {
                self.outliers.push((effect.get("fraction"), effect.get("magnitude"), stream));
            }
            _ => {}
        }
    }

    fn is_plain(&self) -> bool {
        self.tones.is_empty()
            && self.noise.is_empty()
            && self.rounding.is_empty()
            && self.limits.is_empty()
            && self.dropouts.is_empty()
            && self.outliers.is_empty()
    }

    fn value(&mut self, motion: f64, t: f64, engine: Engine, frequencies: &[(f64, f64, f64)]) -> f64 {
        let mut value = self.gain * motion + self.offset + self.drift * t;
        for tone in &self.tones {
            let (sine, cosine) = phase(tone.frequency_hz, t);
            let (phase_sine, phase_cosine) = libm::sincos(tone.phase_rad);
            value += tone.amplitude * (sine * phase_cosine + cosine * phase_sine);
        }
        if let Some(tone) = &self.engine {
            let amplitude = tone.amplitudes[engine as usize];
            if amplitude != 0.0 {
                let (_, sine, cosine) = frequencies[tone.frequency];
                value += amplitude * harmonics(&tone.harmonics, sine, cosine);
            }
        }
        for (std, stream) in &mut self.noise {
            value += *std * stream.normal();
        }
        for step in &self.rounding {
            value = quantize(value, *step);
        }
        for (lower, upper) in &self.limits {
            value = value.max(*lower).min(*upper);
        }
        for (fraction, stream) in &mut self.dropouts {
            // The chance is drawn in any case, so that every sample takes the same numbers.
            if stream.chance(*fraction) {
                value = self.delivered.unwrap_or(value);
            }
        }
        self.delivered = Some(value);
        for (fraction, magnitude, stream) in &mut self.outliers {
            let (hit, positive) = (stream.chance(*fraction), stream.chance(0.5));
            if hit {
                value += if positive { *magnitude } else { -*magnitude };
            }
        }
        value
    }
}

/// Sine and cosine of 2 pi f t.
fn phase(frequency_hz: f64, t: f64) -> (f64, f64) {
    let turns = frequency_hz * t;
    libm::sincos(TAU * (turns - turns.floor()))
}

/// Sum over h of c sin(h a) + s cos(h a), from sine and cosine of a by rotation.
fn harmonics(coefficients: &[[f64; 2]], sine: f64, cosine: f64) -> f64 {
    let (mut s, mut c) = (sine, cosine);
    let mut sum = 0.0;
    for [with_sine, with_cosine] in coefficients {
        sum += with_sine * s + with_cosine * c;
        (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantization_rounds_to_the_nearest_multiple() {
        for (value, expected) in [(0.26, 0.25), (0.38, 0.5), (-0.38, -0.5), (-0.1, 0.0)] {
            assert_eq!(quantize(value, 0.25), expected);
        }
        assert_eq!(quantize(0.123, 0.0), 0.123);
    }

    #[test]
    fn harmonics_are_their_sum_of_sines() {
        let phase = 0.4f64;
        let relative = [1.0, 0.5, 0.25, 0.1];
        let coefficients: Vec<[f64; 2]> = relative
            .iter()
            .zip(1u32..)
            .map(|(r, h)| [r * (f64::from(h) * phase).cos(), r * (f64::from(h) * phase).sin()])
            .collect();
        for a in [0.0f64, 0.3, 2.0, 5.9] {
            let expected: f64 =
                relative.iter().zip(1u32..).map(|(r, h)| r * (f64::from(h) * (a + phase)).sin()).sum();
            assert!((harmonics(&coefficients, a.sin(), a.cos()) - expected).abs() < 1e-14);
        }
    }
}
