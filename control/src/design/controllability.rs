//! Controllability checks before a design, with errors that name the mode and the states.

use nalgebra::DMatrix;
use whirlstand_linalg::{C64, Svd, complex};

use super::DesignError;
use crate::place::uncontrollability;
use crate::sampled_plant::SampledPlant;

/// Distance to an uncontrollable pair, see [`uncontrollability`], below which a mode counts as uncontrollable.
const NEGLIGIBLE: f64 = 1e-12;

/// Checks that every mode that does not decay is controllable, and that every integral can be held.
pub fn check(plant: &SampledPlant, integral: &[usize]) -> Result<(), DesignError> {
    if let Some((mode, shares)) = lost_mode(plant, &[])? {
        let largest = shares.iter().copied().fold(0.0, f64::max);
        let names = plant.state_names().iter().zip(&shares);
        let states: Vec<&str> = names.filter(|(_, s)| **s > 0.1 * largest).map(|(n, _)| n.as_str()).collect();
        return Err(DesignError::Uncontrollable { mode, states: states.join(", ") });
    }
    for count in 1..=integral.len() {
        if lost_mode(plant, &integral[..count])?.is_some() {
            let state = plant.state_names()[integral[count - 1]].clone();
            return Err(DesignError::Integral { state });
        }
    }
    Ok(())
}

/// An uncontrollable mode of the plant and its integrals that does not decay, with the share of each state in
/// the uncontrollable combination.
fn lost_mode(plant: &SampledPlant, integral: &[usize]) -> Result<Option<(C64, Vec<f64>)>, DesignError> {
    let (n, m, size) = (plant.state_count(), plant.input_count(), plant.state_count() + integral.len());
    // In units of the scales, so that the result depends neither on units nor on weak inputs.
    let scale = |i: usize| plant.scales()[if i < n { i } else { integral[i - n] }];
    let a = DMatrix::from_fn(size, size, |i, j| {
        let entry = match i.checked_sub(n) {
            _ if j >= n => 0.0,
            None => plant.a()[(i, j)],
            Some(k) => f64::from(u8::from(integral[k] == j)),
        };
        entry * scale(j) / scale(i)
    });
    let b = DMatrix::from_fn(size, m, |i, j| {
        if i < n { plant.b()[(i, j)] * plant.inputs()[j].authority() / scale(i) } else { 0.0 }
    });
    let stays = |mode: C64| mode.re >= -1e-9 * a.norm();
    let modes = uncontrollability(&a, &b)?;
    let Some((mode, _)) = modes.into_iter().find(|(mode, d)| *d < NEGLIGIBLE && stays(*mode)) else {
        return Ok(None);
    };
    // The left null vector of [A - s I, B].
    let mut pencil = DMatrix::<C64>::zeros(size, size + m);
    pencil.view_mut((0, 0), (size, size)).copy_from(&complex(&a));
    pencil.view_mut((0, size), (size, m)).copy_from(&complex(&b));
    (0..size).for_each(|i| pencil[(i, i)] -= mode);
    let svd = Svd::new(&pencil)?;
    let shares = svd.u.column(svd.values.imin()).iter().take(n).map(|v| v.norm()).collect();
    Ok(Some((mode, shares)))
}

#[cfg(test)]
mod tests {
    use nalgebra::dmatrix;

    use super::*;
    use crate::{Design, LawOptions, LqrOptions, Selector};

    fn refusal(a: DMatrix<f64>, b: DMatrix<f64>, law: &str) -> String {
        let names = ["angle", "rate", "lost"].map(String::from).to_vec();
        let inputs = (1..=b.ncols()).map(|i| format!("u{i}")).collect();
        let plant = SampledPlant::new(a, b, 0.005).and_then(|p| p.with_names(names, inputs)).expect("sound");
        let options = LawOptions::named(law).expect("known");
        Design::new(&plant, &options).expect_err("cannot be stabilised").to_string()
    }

    #[test]
    fn an_uncontrollable_mode_is_named_with_its_state() {
        let b = dmatrix![0.0; 1.0; 0.0];
        let unstable = dmatrix![0.0, 1.0, 0.0; -1.0, -0.4, 0.3; 0.0, 0.0, 0.5];
        let drifting = dmatrix![0.0, 1.0, 0.0; -1.0, -0.4, 0.3; 0.0, 0.0, 0.0];
        for law in ["lqr", "ppc", "smc"] {
            let message = refusal(unstable.clone(), b.clone(), law);
            assert!(message.contains("mode 0.5") && message.contains("in lost"), "{law}: {message}");
            let message = refusal(drifting.clone(), b.clone(), law);
            assert!(message.contains("mode 0") && message.contains("in lost"), "{law}: {message}");
            let message = refusal(unstable.clone(), DMatrix::zeros(3, 1), law);
            assert!(message.contains("is moved by no input"), "{law}: {message}");
        }
    }

    #[test]
    fn an_uncontrollable_mode_that_decays_stays_and_the_rest_is_controlled() {
        let a = dmatrix![0.0, 1.0, 0.0; -1.0, -0.4, 0.3; 0.0, 0.0, -0.7];
        let plant = SampledPlant::new(a, dmatrix![0.0; 1.0; 0.0], 0.005).expect("sound");
        for law in ["lqr", "ppc", "smc"] {
            let design = Design::new(&plant, &LawOptions::named(law).expect("known"));
            let design = design.unwrap_or_else(|e| panic!("{law}: {e}"));
            let stays = |p: &crate::design::Pole| p.continuous.is_some_and(|s| (s[0] + 0.7).abs() < 1e-6);
            assert!(design.closed_loop_poles.iter().any(stays), "{law}: {:?}", design.closed_loop_poles);
            // The state is a known disturbance, and is compensated by no more than needed.
            let gain = design.linear.gain.map(f64::abs);
            assert!(gain[(0, 2)] <= gain[(0, 0)] + gain[(0, 1)], "{law}: {gain}");
        }
    }

    #[test]
    fn an_integral_that_nothing_can_hold_is_named() {
        let plant =
            SampledPlant::new(dmatrix![0.0, 1.0; -1.0, -0.4], dmatrix![0.0; 1.0], 0.005).expect("sound");
        // At rest a rate is zero, whatever the input: its integral would duplicate the angle.
        let integral = vec![Selector::Name("x2".into())];
        let options = LawOptions::Lqr(LqrOptions { integral, ..LqrOptions::default() });
        let message = Design::new(&plant, &options).expect_err("no integral of a rate").to_string();
        assert!(message.contains("integral of x2"), "{message}");
    }
}
