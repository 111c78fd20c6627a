//! The known model of the vehicle, and the Kalman filter model for the errors of its simulation.
//!
//! The simulation reproduces everything that the vehicle file declares, linear or not. The remaining errors
//! are those of its states, of turbulence, of sensors with lag and delay, and of tones of unknown phase; they
//! obey the linear model.
//!
//! A filter without process noise has infinite memory. This filter has the process noise that limits its
//! memory like that of a mean over [`Knowledge::memory_s`]. The innovations of a vehicle that obeys its file
//! then have at no frequency more power than the white noise that the tests assume, since assumed but absent
//! noise is missing from their spectrum. The thresholds are therefore conservative.

use nalgebra::DMatrix;
use whirlstand_control::kalman::{FilterModel, KalmanFilter};
use whirlstand_control::riccati::dare;
use whirlstand_control::{SampledModel, SampledPlant};
use whirlstand_vehicle::{Effect, Engine, Kind, LinearModel, Output, Vehicle};

use crate::error::MirrorError;
use crate::lateness::{Lateness, jitter_s};

/// Noise that is assumed for a sensor that declares none, SI units; the same small value as in the filter of
/// the loop.
const LEAST_NOISE: f64 = 1e-6;

/// Memory in time constants of the slowest decaying pole, and (`MEMORY_S`) its limits, s. Ten time constants
/// contain the whole response of the motion to an effect; the limits bound the memory and the initial phase
/// for vehicles that only integrate.
const MEMORY: f64 = 10.0;
const MEMORY_S: (f64, f64) = (5.0, 30.0);

/// Memory of the phase of a real vehicle's vibration, s.
const TONE_S: f64 = 1.0;

/// Decay rate below which a pole counts as an integrator, 1/s.
const INTEGRATES: f64 = 0.02;

/// Knowledge of the vehicle before the flight.
#[derive(Debug, Clone)]
pub struct Knowledge {
    /// The vehicle with all declared effects.
    pub vehicle: Vehicle,
    /// Period of the loop, s.
    pub period_s: f64,
    /// State of the engine at the start, which sets the amplitude of declared vibrations.
    pub engine: Engine,
    /// Whether a real vehicle is measured. Its vibrations have an unknown phase, while those of a simulation
    /// have the phase in the file, and its measurements are older than the step in which they arrive.
    pub real: bool,
    /// Memory of the filter, s.
    pub memory_s: f64,
    /// Time constant of the fastest pole, s.
    pub fastest_s: f64,
    /// Standard deviation of each output's noise, SI.
    pub noise: Vec<f64>,
    /// Typical magnitudes of the states.
    pub scales: Vec<f64>,
    /// Whether the values of each output have turned out to be rounded.
    pub rounded: Vec<bool>,
}

impl Knowledge {
    /// Knowledge of `vehicle` with all its declared effects, disturbances included.
    ///
    /// # Errors
    /// [`MirrorError`] for a vehicle that has no sampled model.
    pub fn new(vehicle: &Vehicle, period_s: f64, engine: Engine, real: bool) -> Result<Self, MirrorError> {
        let count = vehicle.outputs.len();
        if count == 0 || count > 64 {
            return Err(MirrorError::Outputs { vehicle: vehicle.name.clone(), count });
        }
        let poles = vehicle.poles().unwrap_or_default();
        let decays = poles.iter().map(|p| -p.re).filter(|r| *r > INTEGRATES);
        let slowest = decays.fold(f64::INFINITY, f64::min);
        let fastest = poles.iter().map(|p| p.norm()).fold(0.0, f64::max);
        let linear = LinearModel::new(vehicle)?;
        let plant = SampledPlant::of(&linear, period_s)?;
        let spread = |place: &str| outliers(&vehicle.effects, place);
        let noise = vehicle.outputs.iter().zip(&linear.variance);
        Ok(Self {
            vehicle: vehicle.clone(),
            period_s,
            engine,
            real,
            memory_s: (MEMORY / slowest).clamp(MEMORY_S.0, MEMORY_S.1),
            fastest_s: (1.0 / fastest).clamp(4.0 * period_s, 1.0),
            noise: noise
                .map(|(o, added)| o.sensor_std(Engine::Off, *added + spread(&o.name)).max(LEAST_NOISE))
                .collect(),
            scales: plant.scales()[..vehicle.states.len()].to_vec(),
            rounded: vec![false; count],
        })
    }

    /// Engine state for the simulation of the vehicle.
    pub fn simulated_engine(&self) -> Engine {
        if self.real { Engine::Off } else { self.engine }
    }

    /// The estimator of the measurement age of a real vehicle; `None` for a simulation.
    pub(crate) fn lateness(&self, filter: &KalmanFilter) -> Result<Option<Lateness>, MirrorError> {
        let linear = LinearModel::new(&self.vehicle)?;
        // A lag or a mode of an actuator delays the effect of an input but keeps its final value, so it is
        // left out of `b`.
        let b = &self.vehicle.b;
        let c = linear.c.columns(0, linear.own).into_owned();
        let shaken = self.unpredictable(jitter_s(self.period_s));
        Ok(self.real.then(|| Lateness::new(filter, (b, &c), shaken, self.period_s)))
    }

    /// Variance of each output from the part of declared vibrations that is unpredictable when sample times
    /// have a standard deviation of `jitter_s`: the phase of a tone is then uncertain by w = 2 pi f
    /// `jitter_s`, so that exp(-w^2) of its power remains predictable.
    fn unpredictable(&self, jitter_s: f64) -> Vec<f64> {
        let left = |amplitude: f64, frequency_hz: f64| {
            let phase = std::f64::consts::TAU * frequency_hz * jitter_s;
            -0.5 * amplitude * amplitude * (-phase * phase).exp_m1()
        };
        let of = |output: &Output| {
            let own = output.vibration.iter().flat_map(|v| {
                let harmonics = v.harmonics.iter().zip(1u32..);
                harmonics.map(move |(h, k)| (h * v.flying, f64::from(k) * v.frequency_hz))
            });
            let effects = self.vehicle.effects.iter();
            let effects = effects.filter(|e| e.kind() == Kind::Vibration && e.place() == output.name);
            let tones =
                effects.filter_map(|e| Some((e.parameter("amplitude")?, e.parameter("frequency_hz")?)));
            own.chain(tones).map(|(amplitude, frequency_hz)| left(amplitude, frequency_hz)).sum()
        };
        self.vehicle.outputs.iter().map(of).collect()
    }

    /// Number of samples within the memory.
    pub fn samples(&self) -> f64 {
        self.memory_s / self.period_s
    }

    /// The filter's model, and the initial standard deviations of its states; the vehicle's own states come
    /// first.
    ///
    /// # Errors
    /// [`MirrorError`] when the states are not detectable from the measurements.
    pub(crate) fn filter(&self) -> Result<(FilterModel, Vec<f64>), MirrorError> {
        let linear = self.with_turbulence(LinearModel::new(&self.vehicle)?);
        let sampled = SampledModel::new(&linear, self.period_s)?;
        let layout = &sampled.layout;
        let (size, p) = (layout.size(), self.noise.len());
        let kept: Vec<usize> = (0..layout.own).chain(layout.known()..size).collect();
        let mut density = DMatrix::zeros(linear.a.nrows(), linear.a.nrows());
        let drift = self.process_noise()?;
        for (i, value) in drift.iter().chain(&linear.turbulence[self.scales.len()..]).enumerate() {
            density[(i, i)] = value * value;
        }
        let gathered = sampled.noise(&density)?;
        let tones = self.tones(&linear);
        let (n, count) = (kept.len(), kept.len() + 2 * tones.len());
        let mut f = DMatrix::identity(count, count);
        let mut q = DMatrix::zeros(count, count);
        let mut h = DMatrix::zeros(p, count);
        for (i, &a) in kept.iter().enumerate() {
            for (j, &b) in kept.iter().enumerate() {
                (f[(i, j)], q[(i, j)]) = (sampled.f[(a, b)], gathered[(a, b)]);
            }
            h.set_column(i, &sampled.h.column(a));
        }
        // The initial standard deviation of each state is ten times its typical magnitude; that of turbulence
        // is its declared standard deviation.
        let largest = self.scales.iter().copied().fold(0.0, f64::max);
        let mut initial: Vec<f64> = self.scales.iter().map(|s| 10.0 * s).collect();
        initial.resize(linear.own, 0.0);
        initial.resize(n, 10.0 * largest);
        for (k, (std, _)) in turbulence(&self.vehicle).map(|(_, std, w)| (std, w)).enumerate() {
            initial[self.scales.len() + k] = std;
        }
        for (k, &(output, frequency_hz)) in tones.iter().enumerate() {
            let at = n + 2 * k;
            let (sine, cosine) = (std::f64::consts::TAU * frequency_hz * self.period_s).sin_cos();
            f.view_mut((at, at), (2, 2)).copy_from_slice(&[cosine, -sine, sine, cosine]);
            h[(output, at)] = 1.0;
            for i in at..at + 2 {
                // The tone's memory is that of the states; for a real vehicle it is at most a second, because
                // the phase jumps wherever the number of samples between two steps differs by one.
                let memory_s = if self.real { TONE_S.min(self.memory_s) } else { self.memory_s };
                q[(i, i)] = (self.noise[output] * self.period_s / memory_s).powi(2);
                initial.push(30.0 * self.noise[output]);
            }
        }
        let variance = self.noise.iter().map(|s| s * s).collect();
        let (g, d) = (DMatrix::zeros(count, 1), DMatrix::zeros(p, 1));
        Ok((FilterModel { f, g, h, d, q, variance }, initial))
    }

    /// Adds turbulence as first-order shaped noise, with states after those of the vehicle.
    fn with_turbulence(&self, linear: LinearModel) -> LinearModel {
        let own = linear.own;
        let gusts: Vec<_> = turbulence(&self.vehicle).collect();
        let count = gusts.len();
        if count == 0 {
            return LinearModel { turbulence: vec![0.0; own], ..linear };
        }
        let mut a = linear.a.insert_rows(own, count, 0.0).insert_columns(own, count, 0.0);
        let mut density = vec![0.0; own + count];
        for (k, (state, std, corner)) in gusts.into_iter().enumerate() {
            a[(state, own + k)] = 1.0;
            a[(own + k, own + k)] = -corner;
            density[own + k] = std * (2.0 * corner).sqrt();
        }
        LinearModel {
            own: own + count,
            a,
            b: linear.b.insert_rows(own, count, 0.0),
            c: linear.c.insert_columns(own, count, 0.0),
            turbulence: density,
            ..linear
        }
    }

    /// Tones of unknown phase: output index and frequency after aliasing, Hz.
    fn tones(&self, linear: &LinearModel) -> Vec<(usize, f64)> {
        if !self.real {
            return Vec::new();
        }
        let declared =
            self.vehicle.outputs.iter().enumerate().filter_map(|(i, o)| Some((i, o.vibration.as_ref()?)));
        let harmonics = declared.flat_map(|(i, v)| {
            let order = v.harmonics.iter().enumerate().filter(|(_, h)| **h != 0.0);
            order.map(move |(k, _)| (i, (k + 1) as f64 * v.frequency_hz))
        });
        // Sampling aliases frequencies above half its rate into the band below.
        let rate = 1.0 / self.period_s;
        let folded = |(output, f): (usize, f64)| (output, (f - rate * (f / rate).round()).abs());
        linear.tones.iter().copied().chain(harmonics).map(folded).filter(|(_, f)| *f > 0.0).collect()
    }

    /// Density of the process noise on each of the vehicle's own states: the largest for which the prediction
    /// variance does not exceed that of n parameters estimated from the samples within the memory.
    fn process_noise(&self) -> Result<Vec<f64>, MirrorError> {
        let plain = Vehicle { effects: Vec::new(), ..self.vehicle.clone() };
        let linear = LinearModel::new(&plain)?;
        let sampled = SampledModel::new(&linear, self.period_s)?;
        let n = self.scales.len();
        let shape = DMatrix::from_fn(n, n, |i, j| {
            let forced = i == j && self.vehicle.kinematic_row(i).is_none();
            if forced { self.scales[i] * self.scales[i] } else { 0.0 }
        });
        let shape = sampled.noise(&shape)?;
        let every = self.vehicle.outputs.iter().map(|o| f64::from(o.every.max(1)));
        let variance: Vec<f64> = self.noise.iter().zip(every).map(|(s, e)| s * s * e).collect();
        let r = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&variance));
        let (f, h) = (sampled.f.transpose(), sampled.h.transpose());
        let allowed = n as f64 / self.samples();
        let spread = |size: f64| {
            let x = dare(&f, &h, &(&shape * (size * size)), &r, None)?.x;
            let seen = &sampled.h * x * h.clone();
            Ok::<f64, whirlstand_control::riccati::RiccatiError>(
                (0..variance.len()).map(|i| seen[(i, i)] / variance[i]).fold(0.0, f64::max),
            )
        };
        let (mut low, mut high) = (1e-9_f64, 1e3_f64);
        for _ in 0..40 {
            let middle = (low * high).sqrt();
            match spread(middle) {
                Ok(s) if s <= allowed => low = middle,
                _ => high = middle,
            }
        }
        spread(low).map_err(|e| MirrorError::Unobservable {
            vehicle: self.vehicle.name.clone(),
            reason: e.to_string(),
        })?;
        Ok((0..n)
            .map(|i| if self.vehicle.kinematic_row(i).is_none() { low * self.scales[i] } else { 0.0 })
            .collect())
    }
}

/// State index, standard deviation and corner frequency in rad/s of every declared turbulence.
fn turbulence(vehicle: &Vehicle) -> impl Iterator<Item = (usize, f64, f64)> + '_ {
    let all = vehicle.effects.iter().filter(|e| e.kind() == Kind::Turbulence);
    all.filter_map(|e| {
        let corner = std::f64::consts::TAU * e.parameter("bandwidth_hz")?;
        Some((vehicle.state_index(e.place())?, e.parameter("std")?, corner))
    })
}

/// Variance of the outliers that are declared for an output.
fn outliers(effects: &[Effect], place: &str) -> f64 {
    let at = effects.iter().filter(|e| e.kind() == Kind::Outliers && e.place() == place);
    let variance = |e: &Effect| Some(e.parameter("fraction")? * e.parameter("magnitude")?.powi(2));
    at.filter_map(variance).sum()
}
