//! Comparison of measured data with the simulation: determines the size of the difference, not its cause.

mod comparison;
mod figures;
pub mod gaps;
pub mod grid;
mod simulate;
mod text;

pub use comparison::*;
pub use figures::spectrum;

use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

/// Compares the simulation of `vehicle`, driven by the inputs in `record`, with the outputs in `record`.
///
/// # Errors
/// [`CompareError`], which names the missing and the available signals.
pub fn compare(
    record: &Record,
    vehicle: &Vehicle,
    options: &CompareOptions,
) -> Result<Comparison, CompareError> {
    let grid = grid::grid(record, vehicle, options)?;
    for (values, &i) in grid.measured.iter().zip(&grid.outputs) {
        if !values.iter().any(|v| v.is_finite()) {
            return Err(CompareError::NoValue {
                origin: record.origin.clone(),
                name: vehicle.outputs[i].name.clone(),
            });
        }
    }
    let run = simulate::free_run(&grid, vehicle)?;
    let errors = simulate::predictions(&grid, vehicle, &run, options.horizon_s)?;
    let m = vehicle.inputs.len();
    let inputs = vehicle.inputs.iter().enumerate().map(|(j, input)| {
        let values = grid.inputs.iter().skip(j).step_by(m).copied().collect();
        (input.name.clone(), input.unit.shown(), values)
    });
    let series = Series {
        t: grid.t.clone(),
        inputs: inputs.collect(),
        outputs: (0..grid.outputs.len())
            .map(|j| OutputSeries {
                name: vehicle.outputs[grid.outputs[j]].name.clone(),
                measured: grid.measured[j].clone(),
                simulated: run.outputs[j].clone(),
                prediction_error: errors[j].clone(),
            })
            .collect(),
    };
    let outputs = series.outputs.iter().zip(&grid.outputs).map(|(signals, &i)| {
        let output = &vehicle.outputs[i];
        let figures = figures::figures(&grid, signals, run.diverged, output.noise, output.unit.shown());
        (output.name.clone(), figures)
    });
    let mut comparison = Comparison {
        schema: COMPARISON_SCHEMA.into(),
        verdict: String::new(),
        record: record.origin.clone(),
        vehicle: vehicle.name.clone(),
        from_s: grid.start_s,
        until_s: grid.t[grid.t.len() - 1],
        period_s: grid.period_s,
        samples: grid.t.len(),
        horizon_s: options.horizon_s,
        diverged: run.diverged,
        initial_state_method: "least squares over the compared part".into(),
        initial_state: vehicle
            .states
            .iter()
            .map(|s| s.name.clone())
            .zip(run.initial.iter().copied())
            .collect(),
        outputs: outputs.collect(),
        not_compared: (0..vehicle.outputs.len())
            .filter(|i| !grid.outputs.contains(i))
            .map(|i| vehicle.outputs[i].name.clone())
            .collect(),
        remarks: text::remarks(&grid, vehicle),
        series,
    };
    comparison.remarks.extend(text::size(&comparison));
    comparison.verdict = text::verdict(&comparison);
    Ok(comparison)
}
