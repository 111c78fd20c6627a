//! `whirlstand simulate`: the open-loop response of a vehicle to recorded inputs.

use std::process::ExitCode;

use whirlstand_logs::Record;
use whirlstand_vehicle::{Simulator, Vehicle};

use super::vehicles::find;
use crate::cli::SimulateArgs;
use crate::error::Failure;

/// Runs the command.
pub(crate) fn simulate(args: &SimulateArgs) -> Result<ExitCode, Failure> {
    let vehicle = find(&args.vehicle)?;
    let record = super::log::read(&args.input, &args.map)?;
    let inputs = inputs(&vehicle, &record)?;
    let period_s = period(&record, args.rate)?;
    let response = respond(&vehicle, &record, &inputs, period_s, args)?;
    whirlstand_logs::write_csv(&response, &args.output).map_err(Failure::mend)?;
    eprintln!(
        "{}: {} steps of {} s under {} written to {}",
        vehicle.name,
        response.len(),
        period_s,
        vehicle.inputs.iter().map(|u| u.name.as_str()).collect::<Vec<_>>().join(", "),
        args.output.display()
    );
    Ok(ExitCode::SUCCESS)
}

/// The vehicle's inputs in the record, in the vehicle's order and in SI.
pub(super) fn inputs<'r>(vehicle: &Vehicle, record: &'r Record) -> Result<Vec<&'r [f64]>, Failure> {
    let input = |u: &whirlstand_vehicle::Input| {
        let signal = record.signal(&u.name).map_err(|e| {
            Failure::Mend(format!(
                "{e}; name the column of the input {} with --map {}=COLUMN",
                u.name, u.name
            ))
        })?;
        if !signal.values.iter().any(|v| v.is_finite()) {
            return Err(Failure::Mend(format!(
                "{}: the input {} has no value at all",
                record.origin, u.name
            )));
        }
        Ok(signal.values.as_slice())
    };
    vehicle.inputs.iter().map(input).collect()
}

/// Period of the simulation, s: of the rate that was asked for, or the record's median step.
pub(super) fn period(record: &Record, rate: Option<f64>) -> Result<f64, Failure> {
    if let Some(rate) = rate {
        return if rate > 0.0 && rate.is_finite() {
            Ok(1.0 / rate)
        } else {
            Err(Failure::Mend(format!("--rate {rate}: a rate above 0 Hz is expected")))
        };
    }
    let mut steps: Vec<f64> = record.time.windows(2).map(|t| t[1] - t[0]).collect();
    if steps.is_empty() {
        return Err(Failure::Mend(format!(
            "{}: a record with at least two points in time is expected",
            record.origin
        )));
    }
    steps.sort_by(f64::total_cmp);
    // A clock that counts whole milliseconds gives 0.01 s as 0.010000000000000009.
    Ok((steps[steps.len() / 2] * 1e9).round() * 1e-9)
}

/// Steps the vehicle over the record. At each step the newest recorded input applies, as a sampled input does, and is in
/// force when that step is measured: an output with feedthrough shows it at once, as the plant's does.
fn respond(
    vehicle: &Vehicle,
    record: &Record,
    inputs: &[&[f64]],
    period_s: f64,
    args: &SimulateArgs,
) -> Result<Record, Failure> {
    let simulator = match args.noise {
        true => Simulator::new(vehicle, period_s, args.seed),
        false => Simulator::expected(vehicle, period_s),
    };
    let mut simulator = simulator.map_err(Failure::mend)?;
    let start = record.time.first().copied().unwrap_or(0.0);
    let count = (record.duration() / period_s * (1.0 + 1e-12)).floor() as usize + 1;
    let mut u: Vec<f64> = vehicle.inputs.iter().map(whirlstand_vehicle::Input::neutral).collect();
    let mut applied = vec![Vec::with_capacity(count); u.len()];
    let mut measured = vec![Vec::with_capacity(count); vehicle.outputs.len()];
    let mut next = 0;
    for step in 0..count {
        let t = start + step as f64 * period_s;
        while next < record.time.len() && record.time[next] <= t + 1e-9 * period_s {
            for (u, column) in u.iter_mut().zip(inputs) {
                // A gap in the record holds the last value.
                if column[next].is_finite() {
                    *u = column[next];
                }
            }
            next += 1;
        }
        simulator.apply(&u);
        measured.iter_mut().zip(simulator.measure()).for_each(|(column, y)| column.push(*y));
        applied.iter_mut().zip(&u).for_each(|(column, u)| column.push(*u));
        simulator.advance();
    }
    let time = (0..count).map(|step| start + step as f64 * period_s).collect();
    let mut response = Record::new(vehicle.name.clone(), time).map_err(Failure::run)?;
    for (input, values) in vehicle.inputs.iter().zip(applied) {
        response.push(&input.name, input.unit.si_symbol(), values).map_err(Failure::run)?;
    }
    for (output, values) in vehicle.outputs.iter().zip(measured) {
        response.push(&output.name, output.unit.si_symbol(), values).map_err(Failure::run)?;
    }
    Ok(response)
}
