//! Closed-loop flight: the commands of the control law depend on the sensors, with a delay of one sample.

use whirlstand_vehicle::{Effect, Place, Vehicle};

use super::chain::Chain;
use super::commands::Commands;
use super::error::BlindError;
use super::hidden::Hidden;
use super::law::Law;
use super::motion::{Flight, cuts, ordered};
use super::sense::Sensors;
use super::signal::Signal;
use super::truth_model::TruthModel;

/// The commands of a control law in a flight from `x0` with hidden effects; `noise` is the sensor noise
/// (samples x outputs).
///
/// Replaying these commands in open loop gives the same record, so closed-loop records are processed like all
/// others.
pub(crate) fn commands(
    vehicle: &Vehicle,
    mut law: Law,
    reference: &Commands,
    x0: &[f64],
    noise: &[f64],
    hidden: Hidden<'_>,
) -> Result<Commands, BlindError> {
    let (samples, period_s, p) = (reference.samples(), reference.period_s, vehicle.outputs.len());
    let model = TruthModel::new(vehicle, reference, hidden)?;
    let mut chains = chains(vehicle, hidden)?;
    let mut inputs: Vec<Signal> =
        model.inputs.iter().map(|s| Signal::edges(&[], 0.0).resting(s.rest())).collect();
    let mut times = cuts(&model, period_s, samples);
    ordered(&mut times, samples as f64 * period_s);
    let mut sensors = Sensors::new(vehicle, samples, period_s, hidden)?;
    let mut flight = Flight::new(&model, x0, period_s, samples);
    let mut given = Commands { period_s, inputs: vec![Vec::with_capacity(samples); chains.len()] };
    // For each input, the index of the first signal piece that has not begun.
    let mut next_piece = vec![0; chains.len()];
    let mut next_time = 0;
    for k in 0..samples {
        let (start, end) = (k as f64 * period_s, (k + 1) as f64 * period_s);
        let aim: Vec<f64> = reference.inputs.iter().map(|u| u[k]).collect();
        let command = law.command(&aim);
        for ((column, u), (chain, signal)) in
            given.inputs.iter_mut().zip(&command).zip(chains.iter_mut().zip(&mut inputs))
        {
            column.push(*u);
            signal.append(&chain.pass(&[*u], start, period_s));
        }
        // Times just before the end of the period count as the first times of the next period.
        let before = |t: f64| t < end - 1e-10;
        let mut now = Vec::new();
        while times.get(next_time).is_some_and(|t| before(*t)) {
            now.push(times[next_time]);
            next_time += 1;
        }
        for (signal, next) in inputs.iter().zip(&mut next_piece) {
            while signal.pieces().get(*next).is_some_and(|piece| before(piece.from)) {
                now.push(signal.pieces()[*next].from);
                *next += 1;
            }
        }
        ordered(&mut now, end);
        for (index, cut) in now.iter().enumerate() {
            flight.pass(*cut, &inputs)?;
            flight.advance(now.get(index + 1).copied().unwrap_or(end));
        }
        let mut row = flight.motion.sensed[k * p..(k + 1) * p].to_vec();
        sensors.sample(k, &mut row, Some(&noise[k * p..(k + 1) * p]));
        law.measure(&command, &row);
    }
    Ok(given)
}

/// The path of each command to the vehicle.
fn chains<'a>(vehicle: &'a Vehicle, hidden: Hidden<'a>) -> Result<Vec<Chain<'a>>, BlindError> {
    let mut placed: Vec<(&Effect, Place)> = Vec::new();
    for effect in vehicle.effects.iter().chain(hidden.effects) {
        placed.push((effect, effect.resolve(vehicle).map_err(BlindError::effect)?));
    }
    let of = |i: usize| {
        let own: Vec<&Effect> =
            placed.iter().filter(|(_, p)| *p == Place::Input(i)).map(|(e, _)| *e).collect();
        Chain::new(vehicle, i, &own, hidden.outside)
    };
    Ok((0..vehicle.inputs.len()).map(of).collect())
}
