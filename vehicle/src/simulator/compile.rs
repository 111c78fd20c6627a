//! The linear part of a vehicle with its linear effects, as one augmented state-space system.
//!
//! z = [x; actuator lags and modes; sensor lags; oscillators], driven by v, the inputs behind their delays. All
//! linear effects become entries of A, B, C, D, so that the matrix exponential treats them exactly.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, RowDVector};

use super::switch::Switch;
use crate::effects::{Effect, Kind, Matrix, Place};
use crate::error::SimulatorError;
use crate::model::Vehicle;

/// A signal as a linear form in z and v.
#[derive(Debug, Clone)]
pub struct Form {
    pub z: RowDVector<f64>,
    pub v: RowDVector<f64>,
}

/// A sparse [`Form`] for evaluation.
#[derive(Debug, Clone)]
pub struct Row {
    pub(super) z: Vec<(usize, f64)>,
    pub(super) v: Vec<(usize, f64)>,
}

impl Row {
    pub fn new(form: &Form) -> Self {
        let sparse =
            |row: &RowDVector<f64>| row.iter().copied().enumerate().filter(|(_, v)| *v != 0.0).collect();
        Self { z: sparse(&form.z), v: sparse(&form.v) }
    }

    /// Adds the coefficients to a row of dense matrices over z and over v.
    pub fn spread(&self, row: usize, z: &mut DMatrix<f64>, v: &mut DMatrix<f64>) {
        self.z.iter().for_each(|(i, c)| z[(row, *i)] += c);
        self.v.iter().for_each(|(i, c)| v[(row, *i)] += c);
    }

    /// Values over the steps of a block, where the values of every entry of z and of v are contiguous,
    /// `stride` apart between entries.
    #[inline(always)]
    pub fn values(&self, stride: usize, z: &[f64], v: &[f64], out: &mut [f64]) {
        let dot = |terms: &[(usize, f64)], x: &[f64], out: &mut [f64]| {
            for (i, c) in terms {
                let entry = &x[i * stride..][..out.len()];
                out.iter_mut().zip(entry).for_each(|(o, x)| *o += c * x);
            }
        };
        out.fill(0.0);
        dot(&self.z, z, out);
        if !self.v.is_empty() {
            let mut direct = [0.0; super::rows::BLOCK];
            let direct = &mut direct[..out.len()];
            dot(&self.v, v, direct);
            out.iter_mut().zip(direct).for_each(|(o, d)| *o += *d);
        }
    }

    #[inline]
    pub fn value(&self, z: &[f64], v: &[f64]) -> f64 {
        let dot = |terms: &[(usize, f64)], x: &[f64]| terms.iter().map(|(i, c)| c * x[*i]).sum::<f64>();
        dot(&self.z, z) + if self.v.is_empty() { 0.0 } else { dot(&self.v, v) }
    }
}

/// Steady state of a filter state: `gain` times a signal.
#[derive(Debug, Clone)]
pub struct Rest {
    pub state: usize,
    pub gain: f64,
    pub signal: Row,
    /// True when the filter is off: its state follows the signal.
    pub follows: bool,
}

/// A sine on a state's derivative: z[sine] = amplitude sin(omega t + phase), z[sine + 1] the cosine.
#[derive(Debug, Clone)]
pub struct Oscillator {
    pub state: usize,
    pub sine: usize,
    pub frequency_hz: f64,
    pub phase_rad: f64,
    pub amplitude: f64,
    pub switch: Switch,
}

/// The augmented system.
#[derive(Debug, Clone)]
pub struct System {
    /// Number of the vehicle's own states, which are the first of z.
    pub n: usize,
    /// A and B over z and v, one pair before and after each mode transition.
    pub stages: Vec<(DMatrix<f64>, DMatrix<f64>)>,
    /// Times of the mode transitions, ascending, s.
    pub transitions_s: Vec<f64>,
    /// Rows of the outputs, without and with the sensors' lags.
    pub outputs: Vec<(Row, Row)>,
    /// Steady states of filter states, in an order in which each depends only on earlier ones.
    pub rests: Vec<Rest>,
    pub oscillators: Vec<Oscillator>,
    /// Actuator lags: index of the effect and of its state.
    pub lags: Vec<(usize, usize)>,
}

/// Collects the augmented states, whose number grows with every filter; v is fixed.
struct Builder {
    nz: usize,
    m: usize,
    /// dz/dt of the filter states, by state.
    filters: Vec<(usize, Form)>,
    rests: Vec<(usize, f64, Form, bool)>,
    lags: Vec<(usize, usize)>,
}

impl Builder {
    fn zero(&self) -> Form {
        Form { z: RowDVector::zeros(self.nz), v: RowDVector::zeros(self.m) }
    }

    fn state(&self, index: usize) -> Form {
        let mut form = self.zero();
        form.z[index] = 1.0;
        form
    }

    fn add_state(&mut self) -> usize {
        self.nz += 1;
        self.nz - 1
    }

    /// The signal after a first-order lag, unchanged where the lag does not act.
    fn lag(&mut self, signal: Form, time_constant_s: f64, acts: bool) -> Form {
        if time_constant_s == 0.0 {
            return signal;
        }
        let s = self.add_state();
        if !acts {
            self.rests.push((s, 1.0, signal.clone(), true));
            return signal;
        }
        let mut derivative = self.grown(&signal);
        derivative.z[s] -= 1.0;
        derivative.z /= time_constant_s;
        derivative.v /= time_constant_s;
        self.filters.push((s, derivative));
        self.rests.push((s, 1.0, signal, false));
        self.state(s)
    }

    /// The signal after gain w^2 / (s^2 + 2 z w s + w^2), unchanged where the mode does not act.
    fn mode(&mut self, signal: Form, effect: &Effect, acts: bool) -> Form {
        let w = TAU * effect.get("frequency_hz");
        let (damping, gain) = (effect.get("damping_ratio"), effect.get("gain"));
        // The second state is the velocity over w, which keeps the entries of similar size.
        let position = self.add_state();
        let velocity = self.add_state();
        if !acts {
            self.rests.push((position, 1.0, signal.clone(), true));
            self.rests.push((velocity, 0.0, self.zero(), true));
            return signal;
        }
        let mut velocity_form = self.state(velocity);
        velocity_form.z *= w;
        let mut acceleration = self.grown(&signal);
        acceleration.z *= w * gain;
        acceleration.v *= w * gain;
        acceleration.z[position] -= w;
        acceleration.z[velocity] -= 2.0 * damping * w;
        self.filters.push((position, velocity_form));
        self.filters.push((velocity, acceleration));
        self.rests.push((position, gain, signal, false));
        self.rests.push((velocity, 0.0, self.zero(), false));
        self.state(position)
    }

    fn grown(&self, form: &Form) -> Form {
        Form { z: form.z.clone().resize_horizontally(self.nz, 0.0), v: form.v.clone() }
    }

    /// Sum of coefficients times forms.
    fn combine<'a>(&self, terms: impl Iterator<Item = (f64, &'a Form)>) -> Form {
        let mut sum = self.zero();
        for (coefficient, form) in terms.filter(|(c, _)| *c != 0.0) {
            let form = self.grown(form);
            sum.z += form.z * coefficient;
            sum.v += form.v * coefficient;
        }
        sum
    }
}

impl System {
    /// Compiles `vehicle` with its effects and their places; effects with a window act where `acts` is true.
    pub fn new(
        vehicle: &Vehicle,
        effects: &[(Effect, Place)],
        acts: &[bool],
    ) -> Result<Self, SimulatorError> {
        let (n, m) = vehicle.b.shape();
        let changed = with_changes(vehicle, effects, acts);
        let mut builder = Builder { nz: n, m, filters: Vec::new(), rests: Vec::new(), lags: Vec::new() };
        let signals = actuators(&mut builder, effects, acts);
        let outputs = sensors(&mut builder, &changed, &signals, effects, acts);
        let oscillators = oscillators(&mut builder, effects);
        let (models, transitions_s) = models(vehicle, &changed, effects, acts)?;
        let stages = models.iter().map(|(a, b)| stage(&builder, &oscillators, &signals, a, b)).collect();
        let row = |form: &Form| Row::new(&builder.grown(form));
        let rest = |(state, gain, signal, follows): &(usize, f64, Form, bool)| Rest {
            state: *state,
            gain: *gain,
            signal: row(signal),
            follows: *follows,
        };
        Ok(Self {
            n,
            stages,
            transitions_s,
            outputs: outputs.iter().map(|(ideal, lagged)| (row(ideal), row(lagged))).collect(),
            rests: builder.rests.iter().map(rest).collect(),
            oscillators,
            lags: builder.lags,
        })
    }

    /// Number of augmented states.
    pub fn size(&self) -> usize {
        self.stages[0].0.nrows()
    }
}

/// The vehicle with the changes of its matrices that act.
fn with_changes(vehicle: &Vehicle, effects: &[(Effect, Place)], acts: &[bool]) -> Vehicle {
    let mut changed = vehicle.clone();
    for ((effect, place), _) in effects.iter().zip(acts).filter(|(_, acts)| **acts) {
        if let Place::Entry(matrix, i, j) = *place {
            let matrix = match matrix {
                Matrix::A => &mut changed.a,
                Matrix::B => &mut changed.b,
                Matrix::C => &mut changed.c,
                Matrix::D => &mut changed.d,
            };
            let entry = &mut matrix[(i, j)];
            *entry = effect.parameter("value").unwrap_or(*entry * effect.parameter("factor").unwrap_or(1.0));
        }
    }
    changed
}

/// Signals that drive B: v with coupling, then lags and modes.
fn actuators(builder: &mut Builder, effects: &[(Effect, Place)], acts: &[bool]) -> Vec<Form> {
    let m = builder.m;
    let mut signals: Vec<Form> = (0..m)
        .map(|i| {
            let mut form = builder.zero();
            form.v[i] = 1.0;
            form
        })
        .collect();
    for ((effect, place), acts) in effects.iter().zip(acts) {
        if let (Place::InputPair(from, onto), true) = (*place, *acts) {
            signals[onto].v[from] += effect.get("coefficient");
        }
    }
    for kind in [Kind::ActuatorLag, Kind::UnmodelledMode] {
        for (i, signal) in signals.iter_mut().enumerate() {
            let here = |(e, p): &(Effect, Place)| e.kind() == kind && *p == Place::Input(i);
            let all = effects.iter().zip(acts).enumerate();
            for (index, ((effect, _), acts)) in all.filter(|(_, (e, _))| here(e)) {
                let before = std::mem::replace(signal, builder.zero());
                let state = builder.nz;
                *signal = match kind {
                    Kind::ActuatorLag => builder.lag(before, effect.get("time_constant_s"), *acts),
                    _ => builder.mode(before, effect, *acts),
                };
                if kind == Kind::ActuatorLag && builder.nz > state {
                    builder.lags.push((index, state));
                }
            }
        }
    }
    signals
}

/// The outputs, without and with the sensors' lags.
fn sensors(
    builder: &mut Builder,
    changed: &Vehicle,
    signals: &[Form],
    effects: &[(Effect, Place)],
    acts: &[bool],
) -> Vec<(Form, Form)> {
    let mut outputs = Vec::new();
    for i in 0..changed.outputs.len() {
        let mut ideal = builder.combine(signals.iter().enumerate().map(|(j, u)| (changed.d[(i, j)], u)));
        for k in 0..changed.a.nrows() {
            ideal.z[k] += changed.c[(i, k)];
        }
        let mut lagged = ideal.clone();
        for ((effect, place), acts) in effects.iter().zip(acts) {
            if effect.kind() == Kind::SensorLag && *place == Place::Output(i) {
                lagged = builder.lag(lagged, effect.get("time_constant_s"), *acts);
            }
        }
        outputs.push((ideal, lagged));
    }
    outputs
}

/// The sines on derivatives, each with two states.
fn oscillators(builder: &mut Builder, effects: &[(Effect, Place)]) -> Vec<Oscillator> {
    let mut oscillators = Vec::new();
    for (index, (effect, place)) in effects.iter().enumerate() {
        let (Kind::PeriodicDisturbance, Place::State(state)) = (effect.kind(), *place) else { continue };
        let sine = builder.add_state();
        builder.add_state();
        oscillators.push(Oscillator {
            state,
            sine,
            frequency_hz: effect.get("frequency_hz"),
            phase_rad: effect.get("phase_rad"),
            amplitude: effect.get("amplitude"),
            switch: Switch::new(index, effect),
        });
    }
    oscillators
}

/// A and B before and after each mode transition, with the times of these, ascending, s.
type Models = (Vec<(DMatrix<f64>, DMatrix<f64>)>, Vec<f64>);

/// The models between the mode transitions of the vehicle, of which the first is `changed`. A transition with a window acts
/// during a whole combination, or not at all.
fn models(
    vehicle: &Vehicle,
    changed: &Vehicle,
    effects: &[(Effect, Place)],
    acts: &[bool],
) -> Result<Models, SimulatorError> {
    let (mut transitions, mut chosen) = (Vec::new(), None);
    let all = effects.iter().zip(acts).filter(|((effect, _), _)| effect.kind() == Kind::ModeTransition);
    for ((effect, _), acts) in all {
        match effect.window().is_always() {
            true => transitions.push(effect),
            false if *acts => chosen = Some(effect),
            false => {}
        }
    }
    transitions.sort_by(|a, b| a.get("at_s").total_cmp(&b.get("at_s")));
    let mut models = vec![(changed.a.clone(), changed.b.clone())];
    for effect in &transitions {
        models.push(vehicle.successor(effect)?);
    }
    if let Some(effect) = chosen {
        models.fill(vehicle.successor(effect)?);
    }
    Ok((models, transitions.iter().map(|effect| effect.get("at_s")).collect()))
}

fn stage(
    builder: &Builder,
    oscillators: &[Oscillator],
    signals: &[Form],
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
) -> (DMatrix<f64>, DMatrix<f64>) {
    let (n, m) = b.shape();
    let mut az = DMatrix::zeros(builder.nz, builder.nz);
    let mut bz = DMatrix::zeros(builder.nz, m);
    az.view_mut((0, 0), (n, n)).copy_from(a);
    for i in 0..n {
        let drive = builder.combine((0..m).map(|j| (b[(i, j)], &signals[j])));
        for k in 0..builder.nz {
            az[(i, k)] += drive.z[k];
        }
        bz.row_mut(i).copy_from(&drive.v);
    }
    for (state, derivative) in &builder.filters {
        let derivative = builder.grown(derivative);
        az.row_mut(*state).copy_from(&derivative.z);
        bz.row_mut(*state).copy_from(&derivative.v);
    }
    for o in oscillators {
        let w = TAU * o.frequency_hz;
        az[(o.state, o.sine)] += 1.0;
        az[(o.sine, o.sine + 1)] = w;
        az[(o.sine + 1, o.sine)] = -w;
    }
    (az, bz)
}
