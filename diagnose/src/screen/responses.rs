//! Responses of a predictor that follows a record to each of its columns separately.
//!
//! A filter with fixed gains is linear in its inputs. Its innovations are therefore the sum of its responses
//! to every measured channel and every input alone. With these kept apart, the innovations of a record whose
//! columns have other units are a weighted sum of the same responses, without another run.

use whirlstand_vehicle::{Kind, Simulator, Vehicle};

use crate::data::record::Data;
use crate::model::observer::Observer;

/// Innovations of every channel by source: its good samples after the transients. Sources are the channels,
/// then the inputs.
#[derive(Debug, Clone)]
pub(super) struct Responses {
    /// Columns by channel, then by source.
    pub channels: Vec<Vec<Vec<f64>>>,
}

impl Responses {
    /// Responses of a filter with memory `memory_s`; the first `skip` steps of every record are left out, in
    /// which the initial state decays. `None` when no filter can follow the record.
    pub fn new(vehicle: &Vehicle, data: &Data, memory_s: f64, skip: usize) -> Option<Self> {
        let observer = Observer::new(vehicle, data, &vec![memory_s; vehicle.states.len()])?;
        let base = run(vehicle, data, &observer, None, skip)?;
        let sources = data.channels.len() + data.m;
        let mut channels = vec![Vec::with_capacity(sources); data.channels.len()];
        for source in 0..sources {
            let mut own = run(vehicle, data, &observer, Some(source), skip)?;
            for ((column, base), all) in own.iter_mut().zip(&base).zip(&mut channels) {
                column.iter_mut().zip(base).for_each(|(e, b)| *e -= b);
                all.push(std::mem::take(column));
            }
        }
        Some(Self { channels })
    }
}

/// The vehicle without limits of its inputs: a column in another unit may be far beyond them.
pub(super) fn without_limits(vehicle: &Vehicle) -> Vehicle {
    let mut open = vehicle.clone();
    for input in &mut open.inputs {
        (input.lower, input.upper, input.rate_limit) = (f64::NEG_INFINITY, f64::INFINITY, f64::INFINITY);
    }
    open
}

/// The vehicle with only its linear effects and without limits: scaled inputs must not saturate.
pub(super) fn linear(vehicle: &Vehicle) -> Vehicle {
    let mut open = without_limits(vehicle);
    open.source_text.clear();
    open.effects.retain(|e| {
        matches!(
            e.kind(),
            Kind::InputDelay
                | Kind::ActuatorLag
                | Kind::InputGain
                | Kind::InputBias
                | Kind::InputCoupling
                | Kind::ParameterChange
                | Kind::UnmodelledMode
                | Kind::SensorBias
                | Kind::SensorScale
                | Kind::SensorDelay
                | Kind::SensorLag
                | Kind::Misalignment
        )
    });
    open
}

/// Innovations when only one source is non-zero and all others are at rest.
fn run(
    vehicle: &Vehicle,
    data: &Data,
    observer: &Observer,
    source: Option<usize>,
    skip: usize,
) -> Option<Vec<Vec<f64>>> {
    let p = data.channels.len();
    let rest: Vec<f64> = vehicle.inputs.iter().map(|i| i.neutral()).collect();
    let (mut errors, mut change) = (vec![0.0; p], vec![0.0; vehicle.states.len()]);
    let mut out = vec![Vec::with_capacity(data.steps); p];
    let begin = |step: usize| {
        let mut simulator = Simulator::expected(vehicle, data.period_s).ok()?;
        simulator.begin_at(data.clock(step));
        Some(simulator)
    };
    let mut simulator = begin(0)?;
    let (mut command, mut since) = (rest.clone(), 0);
    for k in 0..data.steps {
        if data.starts.contains(&k) {
            simulator = begin(k)?;
            since = k;
        }
        if let Some(j) = source.and_then(|s| s.checked_sub(p)) {
            command[j] = data.commands(k)[j];
        }
        simulator.apply(&command);
        let y = simulator.measure();
        for (i, channel) in data.channels.iter().enumerate() {
            errors[i] = 0.0;
            let Some(measured) = channel.measured_at(k) else { continue };
            errors[i] = if source == Some(i) { measured } else { 0.0 } - y[channel.output];
            if k >= since + skip {
                out[i].push(errors[i]);
            }
        }
        observer.change(k, &errors, &mut change);
        simulator.correct(&change);
        simulator.advance();
    }
    let finite = !simulator.diverged() && out.iter().flatten().all(|e| e.is_finite());
    finite.then_some(out)
}
