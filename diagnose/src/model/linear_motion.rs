//! Responses of a vehicle to forces on its states by the recursion of its linear motion, many forces side by side.

use multiversion::multiversion;
use nalgebra::{DMatrix, RowDVector};
use whirlstand_vehicle::{Effect, Kind, LinearModel, Place, Vehicle, discretise};

use crate::data::record::Data;
use crate::thresholds::SHORT_KICK;

/// Number of forces side by side: their arithmetic uses the full vector width instead of waiting for one recursion.
pub(super) const LANES: usize = 16;
type Lane = [f64; LANES];

/// Entries of a row that are not zero.
type Row = Vec<(usize, f64)>;

/// Motion due to forces on the states of a vehicle, beside the motion over a record: linear, or linear along the record's
/// trajectory where a smooth force depends on a state.
#[derive(Debug)]
pub(super) struct LinearMotion<'d> {
    data: &'d Data,
    /// Transition over a step, row after row.
    transition: Vec<Row>,
    /// Response of all states to a constant force on each of the vehicle's own over one step.
    push: DMatrix<f64>,
    /// For each channel what it shows.
    shown: Vec<Vec<Reading>>,
    kicks: Vec<Kick>,
}

/// A part of what a channel shows: outputs that are equally late.
#[derive(Debug)]
struct Reading {
    /// Number of steps after which it is shown.
    late: usize,
    states: Row,
    /// Response to a constant force on each own state since the step, where a delay is no multiple of the period.
    forces: Vec<f64>,
}

/// A smooth force's tangent along the trajectory, as half of its impulse over a step, before and after the linear motion:
/// the error is of second order in the period (Strang, SIAM J. Numer. Anal. 5, 1968).
#[derive(Debug)]
struct Kick {
    from: usize,
    onto: usize,
    /// Change of `onto` by a change of `from`, one per step.
    half: Vec<f64>,
}

/// What an effect does to the response to a force.
enum Role {
    /// It adds the same with and without the force, or acts on commands.
    None,
    Linear,
    /// A force that depends smoothly on a state.
    Smooth,
    /// The response depends on its size.
    Beyond,
}

impl Role {
    fn of(effect: &Effect) -> Self {
        let own = match effect.kind() {
            Kind::InputDelay
            | Kind::ActuatorLag
            | Kind::InputGain
            | Kind::GainDrift
            | Kind::InputBias
            | Kind::DeadZone
            | Kind::InputSaturation
            | Kind::RateLimit
            | Kind::Backlash
            | Kind::InputCoupling
            | Kind::UnmodelledMode => return Self::None,
            Kind::StepDisturbance | Kind::PulseDisturbance | Kind::PeriodicDisturbance | Kind::Turbulence => {
                return Self::None;
            }
            Kind::SensorBias | Kind::SensorDrift | Kind::Vibration => return Self::None,
            // Expected values have neither noise nor rounding.
            Kind::Noise | Kind::Quantization | Kind::Dropouts | Kind::Outliers => return Self::None,
            Kind::ParameterChange
            | Kind::SensorScale
            | Kind::SensorDelay
            | Kind::SensorLag
            | Kind::Misalignment => Self::Linear,
            Kind::QuadraticDrag | Kind::CubicStiffness => Self::Smooth,
            Kind::CoulombFriction | Kind::ModeTransition | Kind::OutputSaturation => Self::Beyond,
        };
        if effect.window().is_always() { own } else { Self::Beyond }
    }
}

impl<'d> LinearMotion<'d> {
    /// `None` where an effect's part in a response depends on the size of a force, or a smooth force changes the motion
    /// within a step. `trajectory` gives the states over the record, one vector per state.
    pub fn new(
        vehicle: &Vehicle,
        data: &'d Data,
        trajectory: impl FnOnce() -> Option<Vec<Vec<f64>>>,
    ) -> Option<Self> {
        let (mut linear, mut smooth) = (Vec::new(), Vec::new());
        for effect in &vehicle.effects {
            match Role::of(effect) {
                Role::None => {}
                Role::Linear => linear.push(effect.clone()),
                Role::Smooth => smooth.push(effect),
                Role::Beyond => return None,
            }
        }
        let kicks = if smooth.is_empty() {
            Vec::new()
        } else {
            let states = trajectory()?;
            smooth
                .into_iter()
                .map(|effect| Kick::new(effect, vehicle, data.period_s, &states))
                .collect::<Option<_>>()?
        };
        let model = LinearModel::new(&Vehicle { effects: linear, ..vehicle.clone() }).ok()?;
        let entry = DMatrix::identity(model.a.nrows(), vehicle.states.len());
        let (phi, push) = discretise(&model.a, &entry, data.period_s).ok()?;
        let row = |row: RowDVector<f64>| -> Row {
            row.iter().copied().enumerate().filter(|(_, entry)| *entry != 0.0).collect()
        };
        let reading = |output: usize, delay_s: f64| -> Option<Reading> {
            let mut seen = RowDVector::zeros(model.a.nrows());
            for (i, _) in model.output_delays_s.iter().enumerate().filter(|(_, own)| **own == delay_s) {
                seen += model.c.row(i) * model.mix[(output, i)];
            }
            let late = (delay_s / data.period_s - 1e-9).ceil().max(0.0);
            let since = (late * data.period_s - delay_s).max(0.0);
            let (phi, push) = discretise(&model.a, &entry, since).ok()?;
            let forces = (&seen * push).iter().copied().collect();
            Some(Reading { late: late as usize, states: row(seen * phi), forces })
        };
        let mut delays_s = model.output_delays_s.clone();
        delays_s.sort_by(f64::total_cmp);
        delays_s.dedup();
        let shown = |output: usize| -> Option<Vec<Reading>> {
            let all = delays_s.iter().map(|delay_s| reading(output, *delay_s));
            let all: Vec<Reading> = all.collect::<Option<_>>()?;
            Some(all.into_iter().filter(|reading| !reading.states.is_empty()).collect())
        };
        Some(Self {
            data,
            transition: phi.row_iter().map(|of_state| row(of_state.into_owned())).collect(),
            push,
            shown: data.channels.iter().map(|channel| shown(channel.output)).collect::<Option<_>>()?,
            kicks,
        })
    }

    /// Responses of all samples to at most [`LANES`] forces: for each its state, and its index among `forces`.
    pub fn responses(&self, forced: &[(usize, usize)], forces: &[&[f64]]) -> Vec<Vec<f64>> {
        let forces: Vec<&[f64]> = forced.iter().map(|(_, i)| forces[*i]).collect();
        let states: Vec<usize> = forced.iter().map(|(state, _)| *state).collect();
        let mut responses = vec![vec![0.0; self.data.samples()]; forced.len()];
        respond(self, &states, &forces, &mut responses);
        responses
    }
}

impl Kick {
    fn new(effect: &Effect, vehicle: &Vehicle, period_s: f64, states: &[Vec<f64>]) -> Option<Self> {
        let by = effect.parameter("coefficient")?;
        let (from, onto, slope): (usize, usize, fn(f64) -> f64) = match effect.resolve(vehicle).ok()? {
            Place::State(state) => (state, state, |x| -2.0 * x.abs()),
            Place::StatePair(from, onto) => (from, onto, |x| -3.0 * x * x),
            _ => return None,
        };
        // A stiffness moves its own state by way of a rate, and a kick less by the period.
        let (reach, half): (f64, fn(f64) -> f64) =
            if from == onto { (1.0, f64::exp_m1) } else { (period_s, |change| change) };
        let impulse = |x: &f64| 0.5 * period_s * by * slope(*x);
        let impulses: Vec<f64> = states[from].iter().map(impulse).collect();
        let short = impulses.iter().all(|impulse| reach * impulse.abs() < SHORT_KICK);
        short.then(|| Self { from, onto, half: impulses.into_iter().map(half).collect() })
    }
}

/// A sum and the terms of a row. By value: the sum stays in registers.
#[inline(always)]
fn plus(mut sum: Lane, terms: &[(usize, f64)], x: &[Lane]) -> Lane {
    for (j, by) in terms {
        let x = &x[*j];
        for lane in 0..LANES {
            sum[lane] += by * x[lane];
        }
    }
    sum
}

/// The product of each lane.
#[inline(always)]
fn times(by: &Lane, force: &Lane) -> Lane {
    let mut product = [0.0; LANES];
    for lane in 0..LANES {
        product[lane] = by[lane] * force[lane];
    }
    product
}

#[inline(always)]
fn kick(kicks: &[Kick], k: usize, x: &mut [Lane]) {
    for Kick { from, onto, half } in kicks {
        x[*onto] = plus(x[*onto], &[(*from, half[k])], x);
    }
}

/// Values that a channel shows, kept until they are written lane by lane, in a row for each.
struct Shown<'l> {
    readings: Vec<(&'l Reading, Lane, Vec<Lane>)>,
    /// Index of the sample of the first kept value.
    at: usize,
    kept: Vec<Lane>,
}

impl<'l> Shown<'l> {
    /// Number of values that are written together.
    const TOGETHER: usize = 32;

    fn new(all: &'l [Reading], states: &[usize]) -> Self {
        let reading =
            |r: &'l Reading| (r, by_lane(states, |state| r.forces[state]), vec![[0.0; LANES]; r.late]);
        let readings = all.iter().map(reading).collect();
        Self { readings, at: 0, kept: Vec::with_capacity(Self::TOGETHER) }
    }

    #[inline(always)]
    fn value(&mut self, k: usize, x: &[Lane], force: &Lane) -> Lane {
        let mut y = [0.0; LANES];
        for (reading, since, past) in &mut self.readings {
            if reading.late == 0 {
                y = plus(y, &reading.states, x);
            } else {
                let shown = &mut past[k % reading.late];
                y = plus(y, &[(0, 1.0)], std::slice::from_ref(shown));
                *shown = plus(times(since, force), &reading.states, x);
            }
        }
        y
    }

    #[inline(always)]
    fn keep(&mut self, sample: usize, y: Lane, responses: &mut [Vec<f64>]) {
        if self.kept.len() == Self::TOGETHER || sample != self.at + self.kept.len() {
            self.write(responses);
            self.at = sample;
        }
        self.kept.push(y);
    }

    fn write(&mut self, responses: &mut [Vec<f64>]) {
        for (lane, response) in responses.iter_mut().enumerate() {
            let samples = &mut response[self.at..self.at + self.kept.len()];
            samples.iter_mut().zip(&self.kept).for_each(|(sample, y)| *sample = y[lane]);
        }
        self.kept.clear();
    }
}

/// A value for the forced state of each lane.
fn by_lane(states: &[usize], of: impl Fn(usize) -> f64) -> Lane {
    let mut lanes = [0.0; LANES];
    lanes.iter_mut().zip(states).for_each(|(lane, state)| *lane = of(*state));
    lanes
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn respond(linear: &LinearMotion<'_>, states: &[usize], forces: &[&[f64]], responses: &mut [Vec<f64>]) {
    let LinearMotion { data, transition, push, shown, kicks } = linear;
    let push: Vec<Lane> = (0..push.nrows()).map(|i| by_lane(states, |state| push[(i, state)])).collect();
    let mut shown: Vec<Shown<'_>> = shown.iter().map(|all| Shown::new(all, states)).collect();
    let mut x = vec![[0.0; LANES]; transition.len()];
    let mut next = x.clone();
    let ranges = data.ranges();
    for k in 0..data.steps {
        if data.starts.contains(&k) {
            x.fill([0.0; LANES]);
            shown.iter_mut().flat_map(|s| &mut s.readings).for_each(|(.., past)| past.fill([0.0; LANES]));
        }
        let mut force = [0.0; LANES];
        for (force, values) in force.iter_mut().zip(forces) {
            *force = values[k];
        }
        kick(kicks, k, &mut x);
        for ((channel, range), shown) in data.channels.iter().zip(&ranges).zip(&mut shown) {
            let y = shown.value(k, &x, &force);
            if let Some(sample) = channel.sample_at(k).map(|s| range.start + s).filter(|s| *s < range.end) {
                shown.keep(sample, y, responses);
            }
        }
        kick(kicks, k, &mut x);
        for ((next, row), push) in next.iter_mut().zip(transition).zip(&push) {
            *next = plus(times(push, &force), row, &x);
        }
        std::mem::swap(&mut x, &mut next);
    }
    shown.iter_mut().for_each(|shown| shown.write(responses));
}
