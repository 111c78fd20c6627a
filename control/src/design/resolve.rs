//! Resolves options to numbers: names to indices, defaults from the plant.

use whirlstand_linalg::{C64, eigenvalues};

use super::DesignError;
use crate::options::{Selector, Weights};
use crate::place::uncontrollability;
use crate::sampled_plant::SampledPlant;

/// Index of the selected state.
fn state(plant: &SampledPlant, option: &'static str, selector: &Selector) -> Result<usize, DesignError> {
    index(option, selector, plant.own_names())
}

fn index(option: &'static str, selector: &Selector, names: &[String]) -> Result<usize, DesignError> {
    match selector {
        Selector::Index(i) if *i < names.len() => Ok(*i),
        Selector::Index(i) => Err(DesignError::Index { option, index: *i, count: names.len() }),
        Selector::Name(name) => names
            .iter()
            .position(|n| n == name)
            .ok_or_else(|| DesignError::UnknownName { option, name: name.clone(), known: names.join(", ") }),
    }
}

/// Indices of the integrated states, each once.
pub fn integral(plant: &SampledPlant, selectors: &[Selector]) -> Result<Vec<usize>, DesignError> {
    let mut indices = Vec::with_capacity(selectors.len());
    for s in selectors {
        let i = state(plant, "integral", s)?;
        if !indices.contains(&i) {
            indices.push(i);
        }
    }
    if indices.len() > plant.input_count() {
        return Err(DesignError::Count {
            option: "integral",
            got: indices.len(),
            wanted: plant.input_count(),
        });
    }
    Ok(indices)
}

/// One weight per name, from `weights` where given, else from `defaults`.
pub fn weights(
    option: &'static str,
    weights: Option<&Weights>,
    names: &[String],
    defaults: Vec<f64>,
    allow_zero: bool,
) -> Result<Vec<f64>, DesignError> {
    let mut values = defaults;
    match weights {
        None => {}
        Some(Weights::Uniform(v)) => values.fill(*v),
        Some(Weights::List(list)) if list.len() == values.len() => values.clone_from(list),
        Some(Weights::List(list)) => {
            return Err(DesignError::Count { option, got: list.len(), wanted: values.len() });
        }
        Some(Weights::ByName(map)) => {
            for (name, value) in map {
                values[index(option, &Selector::Name(name.clone()), names)?] = *value;
            }
        }
    }
    let needed = if allow_zero { "zero or positive" } else { "positive" };
    match values.iter().find(|v| !v.is_finite() || **v < 0.0 || (!allow_zero && **v == 0.0)) {
        Some(value) => Err(DesignError::Value { option, value: *value, needed }),
        None => Ok(values),
    }
}

/// A number that must be positive.
pub fn positive(option: &'static str, value: Option<f64>, default: f64) -> Result<f64, DesignError> {
    match value {
        None => Ok(default),
        Some(v) if v.is_finite() && v > 0.0 => Ok(v),
        Some(value) => Err(DesignError::Value { option, value, needed: "positive" }),
    }
}

/// Bryson's weight of each state, times `rates` for a rate or speed whose integral is a state too: the
/// integral's weight provides damping, and more of it only slows the response.
pub fn bryson(plant: &SampledPlant, rates: f64) -> Vec<f64> {
    let mut weights: Vec<f64> = plant.scales()[..plant.own_count()].iter().map(|s| 1.0 / (s * s)).collect();
    for (rate, _) in plant.kinematic_rows().into_iter().flatten() {
        weights[rate] = rates / (plant.scales()[rate] * plant.scales()[rate]);
    }
    weights
}

/// Default natural frequency of a loop around this plant: twice the geometric mean of those of its
/// modes away from the origin, within what the period allows, and at most one over the longest delay,
/// above which no loop crosses over (Skogestad and Postlethwaite, "Multivariable Feedback Control", 2nd
/// edition 2005, section 5.7); rad/s.
pub fn bandwidth(plant: &SampledPlant) -> Result<f64, DesignError> {
    let modes: Vec<f64> = eigenvalues(&plant.own_a())?.iter().map(|p| p.norm()).collect();
    let fastest = modes.iter().copied().fold(0.0, f64::max);
    let mut top = 0.05 * std::f64::consts::TAU / plant.period_s();
    let latest = plant.delays_s().iter().copied().fold(0.0, f64::max);
    if latest > 0.0 {
        top = top.min(1.0 / latest);
    }
    if fastest <= 0.0 {
        return Ok(top.min(2.0));
    }
    let moving: Vec<f64> = modes.into_iter().filter(|w| *w > 1e-3 * fastest).collect();
    let mean = moving.iter().map(|w| w.ln()).sum::<f64>() / moving.len() as f64;
    Ok((2.0 * mean.exp()).min(top))
}

/// Poles of lags and modes on the inputs, in the s plane.
pub fn actuator_poles(plant: &SampledPlant) -> Result<Vec<C64>, DesignError> {
    let (own, count) = (plant.own_count(), plant.state_count() - plant.own_count());
    match count {
        0 => Ok(Vec::new()),
        _ => Ok(eigenvalues(&plant.a().view((own, own), (count, count)).into_owned())?),
    }
}

/// The plant's own poles made faster and damped, in the s plane: a pole slower than `bandwidth` moves half
/// the way to it on a logarithmic scale, one at the origin to a quarter of it, as an outer loop around the
/// others; damping becomes at least `damping`. An uncontrollable mode is unchanged. `extra` poles as slow as
/// those of the outer loop are added for integrators. All poles are distinct.
pub fn default_poles(
    plant: &SampledPlant,
    bandwidth: f64,
    damping: f64,
    extra: usize,
) -> Result<Vec<C64>, DesignError> {
    let modes = uncontrollability(&plant.own_a(), &plant.own_b())?;
    // Fixed poles first, so that the others can be placed apart from them.
    let stays = |distance: f64| distance < 1e-12;
    let mut poles: Vec<C64> = modes.iter().filter(|m| stays(m.1)).map(|m| m.0).collect();
    poles.extend(actuator_poles(plant)?);
    let mut add = |frequency: f64, zeta: f64| {
        let mut w = frequency;
        let make = |w: f64| C64::new(-zeta * w, w * (1.0 - zeta * zeta).max(0.0).sqrt());
        while poles.iter().any(|p: &C64| (make(w) - p).norm() < 0.08 * w) {
            w *= 1.1;
        }
        let p = make(w);
        poles.push(p);
        if p.im != 0.0 {
            poles.push(p.conj());
        }
    };
    for (p, _) in modes.iter().filter(|m| !stays(m.1)) {
        let w = match p.norm() {
            w if w <= 1e-3 * bandwidth => 0.25 * bandwidth,
            w => w.max((w * bandwidth).sqrt()),
        };
        if p.im > 0.0 {
            add(w, (-p.re / p.norm()).max(damping));
        } else if p.im == 0.0 {
            add(w, 1.0);
        }
    }
    for _ in 0..extra {
        add(0.25 * bandwidth, 1.0);
    }
    Ok(poles)
}
