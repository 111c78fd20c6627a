//! The candidate causes: every effect that fits the vehicle, with initial values.
//!
//! The initial values follow from the captured motion: an effect that changes nothing in it cannot be
//! distinguished from no effect.

use whirlstand_vehicle::{Effect, Kind, Matrix, Vehicle, builtin_names};

use crate::capture::Capture;
use crate::known::Knowledge;
use crate::replay::{Belief, REACH_S};

/// An unknown parameter that is estimated, with its limits.
#[derive(Debug, Clone, Copy)]
pub struct Open {
    pub name: &'static str,
    pub lower: f64,
    pub upper: f64,
    /// Step of the value for finite differences.
    pub small: f64,
}

/// An effect at a location, with unknown parameter values.
#[derive(Debug, Clone)]
pub struct Candidate {
    pub kind: Kind,
    pub place: String,
    text: Option<String>,
    pub open: Vec<Open>,
    fixed: Vec<(&'static str, f64)>,
    pub starts: Vec<Vec<f64>>,
    /// For an effect with memory: the index of its input, and the limits of the unknown value that the effect
    /// held at its onset and that its motion depends on.
    pub memory: Option<(usize, Open)>,
}

impl Candidate {
    /// Whether the other candidate is the same effect at the same location with other unknown parameters,
    /// such as one-sided and two-sided limits.
    pub fn is_same(&self, other: &Self) -> bool {
        self.kind == other.kind && self.place == other.place && self.text == other.text
    }

    /// Whether the response depends on the effect's state at the onset for longer than the motion's memory.
    pub fn remembers(&self) -> bool {
        matches!(self.kind, Kind::Backlash | Kind::RateLimit)
    }

    /// All estimated parameters: the effect's own, then that of `memory`.
    pub fn parameters(&self) -> impl Iterator<Item = &Open> {
        self.open.iter().chain(self.memory.iter().map(|(_, open)| open))
    }

    /// The hypothesis that the effect acts from step `since` on with these values, one for each of
    /// [`Self::parameters`].
    pub fn belief(&self, values: &[f64], since: u64) -> Option<Belief> {
        let stood = self.memory.as_ref().and_then(|_| values.last().copied());
        Some(Belief { effect: self.effect(values)?, since, stood })
    }

    /// The effect with these values; `None` when they are invalid.
    pub fn effect(&self, values: &[f64]) -> Option<Effect> {
        if let Some(to) = &self.text {
            return Effect::mode_transition(0.0, to).ok();
        }
        let open = self.open.iter().zip(values).map(|(o, v)| (o.name, *v));
        let all: Vec<(&str, f64)> = open.chain(self.fixed.iter().copied()).collect();
        let effect = Effect::new(self.kind, &self.place, &all).ok()?;
        let reversed = effect.parameter("lower").zip(effect.parameter("upper")).is_some_and(|(l, u)| l >= u);
        (!reversed).then_some(effect)
    }
}

/// Magnitudes of the captured motion.
struct Sizes {
    inputs: Vec<f64>,
    /// Least and greatest value of each input, and (`rates`) its fastest change, 1/s.
    span: Vec<(f64, f64)>,
    rates: Vec<f64>,
    states: Vec<f64>,
    slopes: Vec<f64>,
}

impl Sizes {
    fn of(capture: &Capture, known: &Knowledge, from: u64, to: u64) -> Self {
        let (n, m) = (known.scales.len(), known.vehicle.inputs.len());
        let mut all = Self {
            inputs: vec![0.0; m],
            span: vec![(f64::INFINITY, f64::NEG_INFINITY); m],
            rates: vec![0.0; m],
            states: vec![0.0; n],
            slopes: vec![0.0; n],
        };
        for step in from..to {
            let (u, x) = (capture.sample(step).u, capture.state(step));
            for (i, &u) in u.iter().enumerate() {
                all.inputs[i] = all.inputs[i].max(u.abs());
                all.span[i] = (all.span[i].0.min(u), all.span[i].1.max(u));
                if step > from {
                    let change = u - capture.sample(step - 1).u[i];
                    all.rates[i] = all.rates[i].max(change.abs() / known.period_s);
                }
            }
            let slopes = &known.vehicle.a * nalgebra::DVector::from_column_slice(x)
                + &known.vehicle.b * nalgebra::DVector::from_column_slice(u);
            for i in 0..n {
                all.states[i] += x[i] * x[i];
                all.slopes[i] += slopes[i] * slopes[i];
            }
        }
        let count = (to - from).max(1) as f64;
        all.states.iter_mut().chain(&mut all.slopes).for_each(|v| *v = (*v / count).sqrt());
        all
    }
}

struct Builder<'a> {
    known: &'a Knowledge,
    sizes: Sizes,
    all: Vec<Candidate>,
}

fn open(name: &'static str, lower: f64, upper: f64, small: f64) -> Open {
    Open { name, lower, upper, small }
}

impl Builder<'_> {
    fn add(&mut self, kind: Kind, place: &str, open: &[Open], starts: &[&[f64]]) -> &mut Candidate {
        self.all.push(Candidate {
            kind,
            place: place.into(),
            text: None,
            open: open.to_vec(),
            fixed: Vec::new(),
            starts: starts.iter().map(|s| s.to_vec()).collect(),
            memory: None,
        });
        let last = self.all.len() - 1;
        &mut self.all[last]
    }

    fn inputs(&mut self) {
        let period = self.known.period_s;
        let names: Vec<String> = self.known.vehicle.inputs.iter().map(|i| i.name.clone()).collect();
        for (i, name) in names.iter().enumerate() {
            let (low, high) = self.sizes.span[i];
            let (peak, play) = (self.sizes.inputs[i], high - low);
            let unit = if peak > 0.0 { peak } else { 1.0 };
            let far = 20.0 * unit;
            self.add(Kind::InputBias, name, &[open("offset", -far, far, 0.01 * unit)], &[&[0.1 * unit]]);
            if play <= 0.0 {
                continue;
            }
            self.add(Kind::InputGain, name, &[open("factor", -3.0, 5.0, 0.01)], &[&[0.8]]);
            self.add(Kind::GainDrift, name, &[open("rate_per_s", -2.0, 2.0, 1e-3)], &[&[-0.02]]);
            let late = open("delay_s", 0.0, REACH_S, 0.25 * period);
            self.add(Kind::InputDelay, name, &[late], &[&[2.0 * period], &[0.03], &[0.1], &[0.25]]);
            let lag = open("time_constant_s", 0.1 * period, 3.0, 0.1 * period);
            let memory = Some((i, open("stood", low - play, high + play, 1e-2 * play)));
            self.add(Kind::ActuatorLag, name, &[lag], &[&[2.0 * period], &[0.05], &[0.2]]).memory = memory;
            let width = open("width", 0.0, 2.0 * peak, 1e-2 * peak);
            self.add(Kind::DeadZone, name, &[width], &[&[0.1 * peak], &[0.4 * peak]]);
            let width = open("width", 0.0, 2.0 * play, 1e-2 * play);
            let widths = [0.08, 0.15, 0.25, 0.4, 0.6, 0.9].map(|share| [share * play]);
            self.add(Kind::Backlash, name, &[width], &widths.each_ref().map(|w| &w[..])).memory = memory;
            let rate = self.sizes.rates[i];
            let limit = open("limit_per_s", 1e-4 * rate, rate, 1e-3 * rate);
            self.add(Kind::RateLimit, name, &[limit], &[&[0.3 * rate], &[0.05 * rate], &[0.01 * rate]])
                .memory = memory;
            self.saturation(name, low, high);
            for (j, onto) in names.iter().enumerate().filter(|(j, _)| *j != i) {
                let size = self.sizes.inputs[j].max(0.1 * unit) / unit;
                let c = open("coefficient", -20.0 * size, 20.0 * size, 0.01 * size);
                self.add(Kind::InputCoupling, &format!("{name}->{onto}"), &[c], &[&[0.1 * size]]);
            }
        }
    }

    /// Adds an upper limit, a lower limit, and both together.
    fn saturation(&mut self, name: &str, low: f64, high: f64) {
        let play = high - low;
        let at = |share: f64| low + share * play;
        let upper = open("upper", low, high, 5e-3 * play);
        let lower = open("lower", low, high, 5e-3 * play);
        let far = 1e3 * play.max(low.abs()).max(high.abs());
        self.add(Kind::InputSaturation, name, &[upper], &[&[at(0.9)], &[at(0.6)]]).fixed =
            vec![("lower", -far)];
        self.add(Kind::InputSaturation, name, &[lower], &[&[at(0.1)], &[at(0.4)]]).fixed =
            vec![("upper", far)];
        self.add(Kind::InputSaturation, name, &[lower, upper], &[&[at(0.1), at(0.9)], &[at(0.3), at(0.7)]]);
    }

    fn entries(&mut self) {
        let vehicle = &self.known.vehicle;
        let (n, m) = vehicle.b.shape();
        for (matrix, columns) in [(Matrix::A, n), (Matrix::B, m)] {
            for (i, j) in (0..n).flat_map(|i| (0..columns).map(move |j| (i, j))) {
                let (values, reach) = match matrix {
                    Matrix::A => (&vehicle.a, self.sizes.states[j]),
                    _ => (&vehicle.b, self.sizes.inputs[j]),
                };
                let nominal = values[(i, j)];
                let alone =
                    matrix == Matrix::B && vehicle.b.column(j).iter().filter(|v| **v != 0.0).count() < 2;
                // An entry that is alone in its input's column is equivalent to that input's gain.
                if nominal == 0.0 || reach <= 0.0 || alone || vehicle.kinematic_row(i).is_some() {
                    continue;
                }
                let scale = nominal.abs().max(0.1 * self.sizes.slopes[i] / reach);
                let place = format!("{matrix:?}[{},{}]", i + 1, j + 1);
                let value = open("value", nominal - 10.0 * scale, nominal + 10.0 * scale, 0.01 * scale);
                let start = nominal - 0.2 * scale;
                self.all.push(Candidate {
                    kind: Kind::ParameterChange,
                    place,
                    text: None,
                    open: vec![value],
                    fixed: Vec::new(),
                    starts: vec![vec![start]],
                    memory: None,
                });
            }
        }
    }

    fn states(&mut self) {
        let vehicle = self.known.vehicle.clone();
        for (i, state) in vehicle.states.iter().enumerate() {
            let (x, slope) = (self.sizes.states[i], self.sizes.slopes[i]);
            if vehicle.kinematic_row(i).is_some() || slope <= 0.0 || x <= 0.0 {
                continue;
            }
            let name = &state.name;
            let size = open("magnitude", -100.0 * slope, 100.0 * slope, 0.01 * slope);
            self.add(Kind::StepDisturbance, name, &[size], &[&[0.3 * slope]]).fixed = vec![("at_s", 0.0)];
            let long = open("duration_s", self.known.period_s, 10.0, 0.5 * self.known.period_s);
            self.add(Kind::PulseDisturbance, name, &[long, size], &[&[0.2, slope], &[1.0, 0.3 * slope]])
                .fixed = vec![("at_s", 0.0)];
            let level = open("level", 0.0, 50.0 * slope, 0.01 * slope);
            self.add(Kind::CoulombFriction, name, &[level], &[&[0.1 * slope], &[0.5 * slope]]);
            let c = 0.3 * slope / (x * x);
            let drag = open("coefficient", -99.0 * c, 999.0 * c, 0.01 * c);
            self.add(Kind::QuadraticDrag, name, &[drag], &[&[c]]);
            for (j, angle) in vehicle.states.iter().enumerate() {
                let size = self.sizes.states[j];
                if size > 0.0 && vehicle.kinematic_row(j).is_some_and(|(rate, _)| rate == i) {
                    let c = 0.3 * slope / (size * size * size);
                    let spring = open("coefficient", -99.0 * c, 999.0 * c, 0.01 * c);
                    self.add(Kind::CubicStiffness, &format!("{}->{name}", angle.name), &[spring], &[&[c]]);
                }
            }
        }
    }

    fn outputs(&mut self) {
        let period = self.known.period_s;
        let outputs = self.known.vehicle.outputs.clone();
        for (i, output) in outputs.iter().enumerate() {
            let (name, noise) = (&output.name, self.known.noise[i]);
            let far = 1e5 * noise;
            self.add(Kind::SensorBias, name, &[open("offset", -far, far, 0.1 * noise)], &[&[noise]]);
            self.add(Kind::SensorDrift, name, &[open("rate_per_s", -far, far, 0.1 * noise)], &[&[noise]]);
            self.add(Kind::SensorScale, name, &[open("factor", -3.0, 5.0, 0.01)], &[&[0.9]]);
            let late = open("delay_s", 0.0, REACH_S, 0.25 * period);
            self.add(Kind::SensorDelay, name, &[late], &[&[2.0 * period], &[0.03], &[0.1]]);
            let lag = open("time_constant_s", 0.1 * period, 3.0, 0.1 * period);
            self.add(Kind::SensorLag, name, &[lag], &[&[2.0 * period], &[0.05], &[0.2]]);
            for other in &outputs[i + 1..] {
                if output.unit.dimension() == other.unit.dimension() {
                    let angle = open("angle_rad", -1.6, 1.6, 1e-2);
                    let place = format!("{name},{}", other.name);
                    self.add(Kind::Misalignment, &place, &[angle], &[&[0.1]]);
                }
            }
        }
    }

    fn transitions(&mut self) {
        for to in builtin_names().filter(|name| *name != self.known.vehicle.name) {
            self.add(Kind::ModeTransition, "vehicle", &[], &[&[]]).text = Some(to.into());
        }
    }
}

/// All candidates that fit the vehicle, with initial values from the motion from step `from` up to step `to`.
pub fn candidates(known: &Knowledge, capture: &Capture, from: u64, to: u64) -> Vec<Candidate> {
    let sizes = Sizes::of(capture, known, from, to);
    let mut builder = Builder { known, sizes, all: Vec::new() };
    builder.inputs();
    builder.entries();
    builder.states();
    builder.outputs();
    builder.transitions();
    let fits = |vehicle: &Vehicle, c: &Candidate| {
        c.starts.iter().any(|s| c.effect(s).is_some_and(|e| vehicle.clone().add_effect(e).is_ok()))
    };
    builder.all.retain(|c| fits(&known.vehicle, c));
    builder.all
}
