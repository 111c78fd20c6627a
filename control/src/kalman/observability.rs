//! Observability test of the states to be estimated.

use nalgebra::DMatrix;
use whirlstand_vehicle::LinearModel;

use super::error::EstimatorError;
use super::offsets::Offsets;
use super::sensors::Sensors;
use crate::sampled_plant::SampledPlant;

/// Steady-state outputs as a function of the own states, p x n; an output with a lag has the value before the
/// lag.
pub fn shown_at_rest(linear: &LinearModel) -> DMatrix<f64> {
    let (own, first, size) = (linear.own, linear.own + linear.actuators, linear.a.nrows());
    let mut c = linear.c.clone();
    // A lag may follow another lag: as many passes as there are lags resolve any chain.
    for _ in first..size {
        for z in first..size {
            let through = c.column(z).into_owned();
            c.column_mut(z).fill(0.0);
            for j in (0..size).filter(|j| *j != z && linear.a[(z, *j)] != 0.0) {
                let follows = -linear.a[(z, j)] / linear.a[(z, z)];
                c.column_mut(j).axpy(follows, &through, 1.0);
            }
        }
    }
    c.columns(0, own).into_owned()
}

/// Popov-Belevitch-Hautus observability test at every eigenvalue on or outside the unit circle.
pub fn check_observable(
    plant: &SampledPlant,
    sensors: &Sensors,
    f: &DMatrix<f64>,
    h: &DMatrix<f64>,
    used: &[usize],
    Offsets { biased, trimmed }: &Offsets<'_>,
) -> Result<(), EstimatorError> {
    let n = plant.own_count();
    let scale = |j: usize| match j.checked_sub(n) {
        None => plant.scales()[j],
        Some(k) if k < biased.len() => sensors.std[biased[k]],
        Some(k) => trimmed[k - biased.len()].1,
    };
    let size = f.nrows();
    let scaled_f = DMatrix::from_fn(size, size, |i, j| f[(i, j)] * scale(j) / scale(i));
    let scaled_h =
        DMatrix::from_fn(used.len(), size, |i, j| h[(used[i], j)] * scale(j) / sensors.std[used[i]]);
    let modes = crate::place::uncontrollability(&scaled_f.transpose(), &scaled_h.transpose())
        .map_err(|e| EstimatorError::Sensors(e.to_string()))?;
    let hidden = modes.iter().find(|(mode, distance)| mode.norm() > 1.0 - 1e-9 && *distance < 1e-12);
    if hidden.is_none() {
        return Ok(());
    }
    let outputs = used.iter().map(|&i| sensors.names[i].as_str()).collect::<Vec<_>>().join(", ");
    let biases = biased.iter().map(|&i| format!("the bias of {}", sensors.names[i]));
    let offsets = trimmed.iter().map(|(i, ..)| format!("the offset of {}", plant.input_names()[*i]));
    let with: Vec<String> = biases.chain(offsets).collect();
    let what = match with.is_empty() {
        true => "the full state".to_owned(),
        false => format!("the state together with {}", with.join(" and ")),
    };
    Err(EstimatorError::Unobservable { what, outputs })
}
