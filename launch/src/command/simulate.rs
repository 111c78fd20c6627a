//! `whirlstand simulate`: the open-loop response of a vehicle to recorded inputs.

use std::process::ExitCode;

use whirlstand_logs::resample::held;
use whirlstand_logs::{Clock, Record};
use whirlstand_msgs::units::clean;
use whirlstand_vehicle::{Simulator, Vehicle};

use super::vehicles::find;
use crate::cli::SimulateArgs;
use crate::error::Failure;

/// Most steps of a simulation: more than a day at 100 Hz, and less than a gigabyte of memory with ten
/// signals.
const MOST_STEPS: f64 = 1e7;

/// Runs the command.
pub(crate) fn simulate(args: &SimulateArgs) -> Result<ExitCode, Failure> {
    let vehicle = find(&args.vehicle)?;
    let record = super::log::read_for(&args.input, &args.map, &vehicle)?;
    let period_s = period(&record, args.rate)?;
    let (clock, commands) = commands(&vehicle, &record, period_s)?;
    let response = respond(&vehicle, &clock, commands, args)?;
    whirlstand_logs::write_csv(&response, &args.output).map_err(Failure::mend)?;
    crate::style::say(&format!(
        "{}: {} steps of {} s under {} written to {}",
        vehicle.name,
        response.len(),
        clean(period_s),
        vehicle.inputs.iter().map(|u| u.name.as_str()).collect::<Vec<_>>().join(", "),
        args.output.display()
    ));
    Ok(ExitCode::SUCCESS)
}

/// The vehicle's inputs in the record, in the vehicle's order and in SI.
fn inputs<'r>(vehicle: &Vehicle, record: &'r Record) -> Result<Vec<&'r [f64]>, Failure> {
    let input = |u: &whirlstand_vehicle::Input| {
        let signal = record.signal(&u.name).map_err(|e| {
            Failure::Mend(format!(
                "{e}; name the column of the input {} with --map {}=COLUMN",
                u.name, u.name
            ))
        })?;
        if !signal.values.iter().any(|v| v.is_finite()) {
            return Err(Failure::Mend(format!("{}: the input {} has no values", record.origin, u.name)));
        }
        Ok(signal.values.as_slice())
    };
    vehicle.inputs.iter().map(input).collect()
}

/// Period of the simulation, s: of the requested rate, or the record's own.
pub(super) fn period(record: &Record, rate: Option<f64>) -> Result<f64, Failure> {
    if let Some(rate) = rate {
        return if rate > 0.0 && rate.is_finite() {
            Ok(1.0 / rate)
        } else {
            Err(Failure::Mend(format!("--rate {rate}: a rate above 0 Hz is expected")))
        };
    }
    let period = record.period().ok_or_else(|| {
        Failure::Mend(format!("{}: a record with at least two points in time is expected", record.origin))
    })?;
    // A clock in whole milliseconds gives 0.01 s as 0.010000000000000009.
    Ok((period * 1e9).round() * 1e-9)
}

/// The vehicle's inputs in each period from the record's first point on. A gap in the record holds the last value;
/// before its first value an input is at rest.
pub(super) fn commands(
    vehicle: &Vehicle,
    record: &Record,
    period_s: f64,
) -> Result<(Clock, Vec<Vec<f64>>), Failure> {
    let start = record.time.first().copied().unwrap_or(0.0);
    let steps = (record.duration() / period_s).floor() + 1.0;
    if steps > MOST_STEPS {
        return Err(Failure::Mend(format!(
            "{}: {} s in steps of {} s are {steps:.0} steps, but at most {MOST_STEPS:.0} are simulated: choose a \
             lower --rate, or a shorter part of the record",
            record.origin,
            clean(record.duration()),
            clean(period_s)
        )));
    }
    let clock = Clock::over(start, start + record.duration(), period_s).map_err(Failure::mend)?;
    let columns = inputs(vehicle, record)?;
    let columns = vehicle.inputs.iter().zip(columns);
    let columns =
        columns.map(|(input, values)| held(&record.time, values, &clock, input.neutral())).collect();
    Ok((clock, columns))
}

/// Steps the vehicle over the clock. The input of a step is already applied when that step is measured: an
/// output with feedthrough shows it at once, as in the plant.
fn respond(
    vehicle: &Vehicle,
    clock: &Clock,
    commands: Vec<Vec<f64>>,
    args: &SimulateArgs,
) -> Result<Record, Failure> {
    let simulator = match args.noise {
        true => Simulator::new(vehicle, clock.period, args.seed),
        false => Simulator::expected(vehicle, clock.period),
    };
    let mut simulator = simulator.map_err(Failure::mend)?;
    let mut u = vec![0.0; commands.len()];
    let mut measured = vec![Vec::with_capacity(clock.points); vehicle.outputs.len()];
    for step in 0..clock.points {
        u.iter_mut().zip(&commands).for_each(|(u, column)| *u = column[step]);
        simulator.apply(&u);
        let y = simulator.measure();
        if let Some(i) = y.iter().position(|y| !y.is_finite()) {
            return Err(Failure::Run(format!(
                "{}: {} overflows from {} s on: the vehicle is unstable or the input too large",
                vehicle.name,
                vehicle.outputs[i].name,
                clean(clock.at(step))
            )));
        }
        measured.iter_mut().zip(y).for_each(|(column, y)| column.push(*y));
        simulator.advance();
    }
    let mut response = Record::new(vehicle.name.clone(), clock.times()).map_err(Failure::run)?;
    for (input, values) in vehicle.inputs.iter().zip(commands) {
        response.push(&input.name, input.unit.si_symbol(), values).map_err(Failure::run)?;
    }
    for (output, values) in vehicle.outputs.iter().zip(measured) {
        response.push(&output.name, output.unit.si_symbol(), values).map_err(Failure::run)?;
    }
    Ok(response)
}
