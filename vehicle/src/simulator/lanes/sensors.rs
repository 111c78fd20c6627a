//! Sensors of several vehicles simulated side by side.

#![expect(clippy::needless_range_loop, reason = "a loop over lanes indexes several rows alike")]

use super::normals::NormalLanes;
use crate::model::Engine;
use crate::simulator::Simulator;
use crate::simulator::sensor::{EngineTone, Sensor, phase, quantize};

/// Terms of a row: index of the entry, and its coefficient in every vehicle.
type Terms<const K: usize> = Vec<(usize, [f64; K])>;

/// The sensors of K vehicles.
#[derive(Debug, Clone)]
pub struct SensorLanes<const K: usize> {
    period_s: f64,
    engine: Engine,
    frequencies: Vec<(f64, f64, f64)>,
    sensors: Vec<Lanes<K>>,
    values: Vec<[f64; K]>,
    /// Bit i: output i is new.
    pub fresh: u64,
    measured: Option<u64>,
}

/// One output of K vehicles.
#[derive(Debug, Clone)]
struct Lanes<const K: usize> {
    z: Terms<K>,
    v: Terms<K>,
    every: u64,
    due: u64,
    reports: Reports<K>,
}

/// Sensor model from the motion to the reported value.
#[derive(Debug, Clone)]
enum Reports<const K: usize> {
    /// The sensor of the vehicle file, with scale, offset and drift.
    Declared {
        gain: [f64; K],
        offset: [f64; K],
        drift: [f64; K],
        tone: Option<EngineTone>,
        noise: Vec<([f64; K], NormalLanes<K>)>,
        rounding: Vec<[f64; K]>,
    },
    /// Sensors with other effects: evaluated one vehicle after the other.
    OneByOne(Vec<Sensor>),
}

impl<const K: usize> SensorLanes<K> {
    /// Sensors of K vehicles; `None` where one has a delay or misalignment, or the vibrations differ.
    pub fn new(singles: &[Simulator]) -> Option<Self> {
        let first = &singles[0].sensors;
        let other = |s: &Simulator| {
            let s = &s.sensors;
            s.delayed || !s.turned.is_empty() || s.frequencies != first.frequencies
        };
        if singles.iter().any(other) {
            return None;
        }
        let of = |i: usize| singles.iter().map(move |s| &s.sensors.sensors[i]);
        let sensors =
            (0..first.sensors.len()).map(|i| Lanes::new(of(i).collect())).collect::<Option<Vec<_>>>()?;
        Some(Self {
            period_s: singles[0].period_s,
            engine: singles[0].engine,
            frequencies: first.frequencies.clone(),
            values: vec![[0.0; K]; sensors.len()],
            sensors,
            fresh: 0,
            measured: None,
        })
    }

    /// Measures at a step; a second call at the same step changes nothing.
    #[inline(always)]
    pub fn measure(&mut self, z: &[[f64; K]], v: &[[f64; K]], step: u64) -> &[[f64; K]] {
        if self.measured == Some(step) {
            return &self.values;
        }
        self.measured = Some(step);
        let t = step as f64 * self.period_s;
        if self.engine != Engine::Off {
            for (frequency_hz, sine, cosine) in &mut self.frequencies {
                (*sine, *cosine) = phase(*frequency_hz, t);
            }
        }
        self.fresh = 0;
        for (i, (sensor, value)) in self.sensors.iter_mut().zip(&mut self.values).enumerate() {
            if step >= sensor.due {
                sensor.due =
                    if sensor.every == 1 { step + 1 } else { (step / sensor.every + 1) * sensor.every };
                self.fresh |= 1 << i;
                *value = sensor.motion(z, v);
                sensor.reports.report(value, t, self.engine, &self.frequencies);
            }
        }
        &self.values
    }
}

impl<const K: usize> Lanes<K> {
    /// `None` where the sensors do not measure the same entries, or their tones and kinds of noise differ.
    fn new(singles: Vec<&Sensor>) -> Option<Self> {
        let first = *singles.first()?;
        let terms = |row: fn(&Sensor) -> &Vec<(usize, f64)>| -> Option<Terms<K>> {
            let entries = |s: &Sensor| row(s).iter().map(|(i, _)| *i).collect::<Vec<_>>();
            let same = singles.iter().all(|s| entries(s) == entries(first));
            let coefficients = |at: usize| std::array::from_fn(|l| row(singles[l])[at].1);
            same.then(|| {
                entries(first).into_iter().enumerate().map(|(at, i)| (i, coefficients(at))).collect()
            })
        };
        let (z, v) = (terms(|s| &s.lagged.z)?, terms(|s| &s.lagged.v)?);
        let each = |value: fn(&Sensor) -> f64| std::array::from_fn(|l| value(singles[l]));
        let declared = |s: &&Sensor| {
            s.is_as_declared()
                && s.noise.len() == first.noise.len()
                && s.rounding.len() == first.rounding.len()
        };
        if singles.iter().any(|s| s.engine != first.engine || s.due != first.due) {
            return None;
        }
        let reports = if singles.iter().all(declared) {
            let noise = (0..first.noise.len()).map(|i| {
                let streams = singles.iter().map(|s| s.noise[i].1.clone()).collect();
                (std::array::from_fn(|l| singles[l].noise[i].0), NormalLanes::new(streams))
            });
            let rounding = 0..first.rounding.len();
            Reports::Declared {
                gain: each(|s| s.gain),
                offset: each(|s| s.offset),
                drift: each(|s| s.drift),
                tone: first.engine.clone(),
                noise: noise.collect(),
                rounding: rounding.map(|i| std::array::from_fn(|l| singles[l].rounding[i])).collect(),
            }
        } else {
            Reports::OneByOne(singles.into_iter().cloned().collect())
        };
        Some(Self { z, v, every: first.every, due: first.due, reports })
    }

    /// Value of the motion, as [`crate::simulator::compile::Row::value`].
    #[inline(always)]
    fn motion(&self, z: &[[f64; K]], v: &[[f64; K]]) -> [f64; K] {
        let dot = |terms: &Terms<K>, x: &[[f64; K]]| {
            // Initial value of a sum.
            let mut sum = [std::iter::empty::<f64>().sum(); K];
            for (i, c) in terms {
                let x = &x[*i];
                for l in 0..K {
                    sum[l] += c[l] * x[l];
                }
            }
            sum
        };
        let mut motion = dot(&self.z, z);
        let direct = if self.v.is_empty() { [0.0; K] } else { dot(&self.v, v) };
        for l in 0..K {
            motion[l] += direct[l];
        }
        motion
    }
}

impl<const K: usize> Reports<K> {
    #[inline(always)]
    fn report(&mut self, value: &mut [f64; K], t: f64, engine: Engine, frequencies: &[(f64, f64, f64)]) {
        match self {
            Self::Declared { gain, offset, drift, tone, noise, rounding } => {
                for l in 0..K {
                    value[l] = gain[l] * value[l] + offset[l] + drift[l] * t;
                }
                if let Some(vibration) = tone.as_ref().and_then(|tone| tone.value(engine, frequencies)) {
                    for l in 0..K {
                        value[l] += vibration;
                    }
                }
                for (std, normals) in noise {
                    let normal = normals.next();
                    for l in 0..K {
                        value[l] += std[l] * normal[l];
                    }
                }
                for step in rounding {
                    for l in 0..K {
                        value[l] = quantize(value[l], step[l]);
                    }
                }
            }
            Self::OneByOne(sensors) => {
                for (sensor, value) in sensors.iter_mut().zip(value) {
                    *value = sensor.value(*value, t, engine, frequencies);
                }
            }
        }
    }
}
