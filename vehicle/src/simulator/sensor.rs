//! One sensor: from the true output to the reported value.

use std::f64::consts::TAU;

use super::compile::Row;
use super::switch::Switch;
use super::tap::Tap;
use crate::effects::{Effect, Kind};
use crate::model::{Engine, Output};
use crate::normals::Normals;
use crate::random::Stream;

/// Rounds to a multiple of the step.
pub fn quantize(value: f64, step: f64) -> f64 {
    if step == 0.0 { value } else { step * libm::round(value / step) }
}

/// Scale, bias and drift effects of a sensor with a time window.
#[derive(Debug, Clone)]
struct Passing {
    switch: Switch,
    gain: f64,
    offset: f64,
    drift: f64,
}

#[derive(Debug, Clone)]
struct Tone {
    switch: Switch,
    frequency_hz: f64,
    amplitude: f64,
    /// Sine and cosine of the phase.
    phase: (f64, f64),
}

/// Declared vibration: harmonics of one of the sensors' common frequencies.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct EngineTone {
    frequency: usize,
    /// Relative amplitude times cosine and sine of each harmonic's phase.
    harmonics: Vec<[f64; 2]>,
    amplitudes: [f64; 3],
}

impl EngineTone {
    /// Current contribution, if any.
    #[inline(always)]
    pub(super) fn value(&self, engine: Engine, frequencies: &[(f64, f64, f64)]) -> Option<f64> {
        let amplitude = self.amplitudes[engine as usize];
        let (_, sine, cosine) = frequencies[self.frequency];
        (amplitude != 0.0).then(|| amplitude * harmonics(&self.harmonics, sine, cosine))
    }
}

#[derive(Debug, Clone)]
pub(super) struct Sensor {
    /// Rows of the motion, without and with the sensor's own lag.
    pub(super) ideal: Row,
    pub(super) lagged: Row,
    /// Stored past values for delays, and the index of the delay in force.
    pub(super) taps: Vec<Tap>,
    pub(super) tap: Option<usize>,
    pub(super) every: u64,
    /// Step from which a new value is due.
    pub(super) due: u64,
    pub(super) gain: f64,
    pub(super) offset: f64,
    pub(super) drift: f64,
    passing: Vec<Passing>,
    tones: Vec<Tone>,
    pub(super) engine: Option<EngineTone>,
    /// Declared noise, then that of effects; likewise for rounding.
    pub(super) noise: Vec<(f64, Normals)>,
    more_noise: Vec<(Switch, f64, Stream)>,
    pub(super) rounding: Vec<f64>,
    more_rounding: Vec<(Switch, f64)>,
    limits: Vec<(Switch, f64, f64)>,
    dropouts: Vec<(Switch, f64, Stream)>,
    outliers: Vec<(Switch, f64, f64, Stream)>,
    /// Last value before outliers, which a dropout repeats.
    delivered: Option<f64>,
    /// True when only scale, offset and drift act while the engine is off.
    pub(super) plain: bool,
}

/// The sensor of a vehicle file, without effects.
pub(super) fn declared(
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
    let normals = |seed| Normals::new(Stream::new(seed, &format!("noise/{}", output.name)));
    let noise = seed.filter(|_| output.noise > 0.0).map(|seed| (output.noise, normals(seed)));
    Sensor {
        ideal: ideal.clone(),
        lagged: lagged.clone(),
        taps: Vec::new(),
        tap: None,
        every: if seed.is_some() { u64::from(output.every) } else { 1 },
        due: 0,
        gain: 1.0,
        offset: output.bias,
        drift: 0.0,
        passing: Vec::new(),
        tones: Vec::new(),
        engine,
        noise: noise.into_iter().collect(),
        rounding: Some(output.quantization).filter(|q| seed.is_some() && *q > 0.0).into_iter().collect(),
        more_noise: Vec::new(),
        more_rounding: Vec::new(),
        limits: Vec::new(),
        dropouts: Vec::new(),
        outliers: Vec::new(),
        delivered: None,
        plain: false,
    }
}

impl Sensor {
    /// Adds an effect; random effects and rounding act only with a stream.
    pub(super) fn add(&mut self, effect: &Effect, switch: Switch, stream: Option<Stream>) {
        let always = effect.window().is_always();
        let one = Passing { switch: switch.clone(), gain: 1.0, offset: 0.0, drift: 0.0 };
        match (effect.kind(), stream) {
            (Kind::SensorBias, _) if always => self.offset += effect.get("offset"),
            (Kind::SensorDrift, _) if always => self.drift += effect.get("rate_per_s"),
            (Kind::SensorScale, _) if always => self.gain *= effect.get("factor"),
            (Kind::SensorBias, _) => self.passing.push(Passing { offset: effect.get("offset"), ..one }),
            (Kind::SensorDrift, _) => self.passing.push(Passing { drift: effect.get("rate_per_s"), ..one }),
            (Kind::SensorScale, _) => self.passing.push(Passing { gain: effect.get("factor"), ..one }),
            (Kind::Vibration, _) => self.tones.push(Tone {
                switch,
                frequency_hz: effect.get("frequency_hz"),
                amplitude: effect.get("amplitude"),
                phase: libm::sincos(effect.get("phase_rad")),
            }),
            (Kind::OutputSaturation, _) => {
                self.limits.push((switch, effect.get("lower"), effect.get("upper")));
            }
            (Kind::Noise, Some(stream)) => self.more_noise.push((switch, effect.get("std"), stream)),
            (Kind::Quantization, Some(_)) => self.more_rounding.push((switch, effect.get("step"))),
            (Kind::Dropouts, Some(stream)) => self.dropouts.push((switch, effect.get("fraction"), stream)),
            (Kind::Outliers, Some(stream)) => {
                self.outliers.push((switch, effect.get("fraction"), effect.get("magnitude"), stream));
            }
            _ => {}
        }
    }

    /// Value of the motion before the delay, where there is one.
    #[inline(always)]
    pub(super) fn late(&self) -> Option<f64> {
        self.tap.map(|at| self.taps[at].value())
    }

    /// Index of the stored values for an output of this delay, which are kept from now on.
    pub(super) fn keep(&mut self, delay_s: f64, period_s: f64) -> Option<usize> {
        let tap = Tap::new(delay_s, period_s)?;
        let known = self.taps.iter().position(|t| t.looks_like(&tap));
        Some(known.unwrap_or_else(|| {
            self.taps.push(tap);
            self.taps.len() - 1
        }))
    }

    /// Switches an effect; true if it is one of these and switchable.
    pub(super) fn switch(&mut self, effect: usize, on: bool) -> bool {
        let passing = self.passing.iter_mut().map(|p| &mut p.switch);
        let tones = self.tones.iter_mut().map(|tone| &mut tone.switch);
        let noise = self.more_noise.iter_mut().map(|(switch, ..)| switch);
        let rounding = self.more_rounding.iter_mut().map(|(switch, _)| switch);
        let limits = self.limits.iter_mut().map(|(switch, ..)| switch);
        let dropouts = self.dropouts.iter_mut().map(|(switch, ..)| switch);
        let outliers = self.outliers.iter_mut().map(|(switch, ..)| switch);
        let all = passing.chain(tones).chain(noise).chain(rounding).chain(limits).chain(dropouts);
        all.chain(outliers).any(|switch| switch.set(effect, on))
    }

    pub(super) fn is_plain(&self) -> bool {
        self.is_as_declared() && self.noise.is_empty() && self.rounding.is_empty()
    }

    /// True when only scale, offset, drift and the vehicle file's own errors act.
    pub(super) fn is_as_declared(&self) -> bool {
        self.tones.is_empty()
            && self.passing.is_empty()
            && self.more_noise.is_empty()
            && self.more_rounding.is_empty()
            && self.limits.is_empty()
            && self.dropouts.is_empty()
            && self.outliers.is_empty()
    }

    pub(super) fn value(
        &mut self,
        motion: f64,
        t: f64,
        engine: Engine,
        frequencies: &[(f64, f64, f64)],
    ) -> f64 {
        let (mut gain, mut offset) = (self.gain, self.offset);
        for passing in self.passing.iter().filter(|p| p.switch.is_on(t)) {
            gain *= passing.gain;
            offset += passing.offset + passing.drift * passing.switch.since(t);
        }
        let mut value = gain * motion + offset + self.drift * t;
        for tone in self.tones.iter().filter(|tone| tone.switch.is_on(t)) {
            let (sine, cosine) = phase(tone.frequency_hz, t);
            let (phase_sine, phase_cosine) = tone.phase;
            value += tone.amplitude * (sine * phase_cosine + cosine * phase_sine);
        }
        if let Some(vibration) = self.engine.as_ref().and_then(|tone| tone.value(engine, frequencies)) {
            value += vibration;
        }
        for (std, normals) in &mut self.noise {
            value += *std * normals.next();
        }
        // Random numbers are always drawn, so that every sample uses the same number of them.
        for (switch, std, stream) in &mut self.more_noise {
            let normal = stream.normal();
            if switch.is_on(t) {
                value += *std * normal;
            }
        }
        for step in &self.rounding {
            value = quantize(value, *step);
        }
        for (_, step) in self.more_rounding.iter().filter(|(switch, _)| switch.is_on(t)) {
            value = quantize(value, *step);
        }
        for (_, lower, upper) in self.limits.iter().filter(|(switch, ..)| switch.is_on(t)) {
            value = value.max(*lower).min(*upper);
        }
        for (switch, fraction, stream) in &mut self.dropouts {
            if stream.chance(*fraction) && switch.is_on(t) {
                value = self.delivered.unwrap_or(value);
            }
        }
        self.delivered = Some(value);
        for (switch, fraction, magnitude, stream) in &mut self.outliers {
            let (hit, positive) = (stream.chance(*fraction), stream.chance(0.5));
            if hit && switch.is_on(t) {
                value += if positive { *magnitude } else { -*magnitude };
            }
        }
        value
    }
}

/// Sine and cosine of 2 pi f t.
pub(super) fn phase(frequency_hz: f64, t: f64) -> (f64, f64) {
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
