//! Design of sliding mode: the surface, the reaching law, and the linear law within the boundary layer.

use nalgebra::DMatrix;

use super::linear_law::LinearLaw;
use super::reduced::{Reduced, ReducedLoop, integral_input, split};
use super::report::pole;
use super::sliding_law::{SlidingLaw, Switching};
use super::{DesignError, resolve};
use crate::options::SmcOptions;
use crate::sampled_plant::SampledPlant;
use crate::smc::{Shaping, Surface};

/// Shaping of the sliding surface: by its poles or by a cost.
fn shaping(plant: &SampledPlant, o: &SmcOptions, integral: &[usize]) -> Result<Shaping, DesignError> {
    let (n, m, dt) = (plant.state_count(), plant.input_count(), plant.period_s());
    match (&o.poles, &o.q) {
        (Some(_), Some(_)) => Err(DesignError::Conflict { first: "poles", second: "q" }),
        (Some(poles), None) => {
            let wanted = n + integral.len() - m.min(n);
            if poles.len() != wanted {
                return Err(DesignError::Count { option: "poles", got: poles.len(), wanted });
            }
            Ok(Shaping::Poles(poles.iter().map(|p| pole(*p, dt)).collect()))
        }
        (None, q) => {
            let mut q =
                resolve::weights("q", q.as_ref(), plant.own_names(), resolve::bryson(plant, 0.1), true)?;
            // The surface is shaped by the states that the inputs move first, which are the actuators.
            q.extend(plant.scales()[plant.own_count()..].iter().map(|s| 1.0 / (s * s)));
            let extra: Vec<f64> = integral.iter().map(|&i| 0.25 * q[i]).collect();
            q.extend(extra);
            Ok(Shaping::Cost(DMatrix::from_diagonal(&nalgebra::DVector::from_vec(q)) * dt))
        }
    }
}

/// Parameters of the reaching law: switching gain and boundary layer of each input, and the rate of the
/// exponential part, 1/s.
pub struct Switched {
    pub gain: Vec<f64>,
    pub layer: Vec<f64>,
    pub rate: f64,
}

/// The parameters from the options, with the defaults.
pub fn switched(plant: &SampledPlant, o: &SmcOptions) -> Result<Switched, DesignError> {
    let bandwidth = resolve::bandwidth(plant)?;
    let rate = resolve::positive("reaching_rate", o.reaching_rate, bandwidth)?;
    let authority = plant.inputs().iter().map(|i| 0.2 * i.authority()).collect();
    let names = plant.input_names();
    let gain = resolve::weights("switching_gain", o.switching_gain.as_ref(), names, authority, false)?;
    let layer_rate = (4.0 * bandwidth + rate).min(0.5 / plant.period_s());
    let narrow = gain.iter().map(|g| g / (layer_rate - rate).max(0.1 * layer_rate)).collect();
    let layer = resolve::weights("boundary_layer", o.boundary_layer.as_ref(), names, narrow, false)?;
    Ok(Switched { gain, layer, rate })
}

/// Designs sliding mode with a surface by minimum cost or by poles.
pub fn smc(
    plant: &SampledPlant,
    o: &SmcOptions,
    integral: &[usize],
) -> Result<(LinearLaw, SlidingLaw, Option<ReducedLoop>), DesignError> {
    let dt = plant.period_s();
    let reduced = Reduced::to_the_latest(plant, integral);
    let shaping = shaping(plant, o, integral)?;
    let mut surface = Surface::design(&reduced.phi, &reduced.gamma, dt, &shaping)?;
    let on_reduced = surface.clone();
    (surface.c, surface.equivalent) = (reduced.whole(&surface.c), reduced.whole(&surface.equivalent));
    let Switched { gain, layer, rate } = switched(plant, o)?;
    let c = &surface.c;
    let reaching = Reaching { gain: &gain, layer: &layer, rate };
    let (law, switching, reaching) = if o.super_twisting {
        super_twisting(plant, integral, &surface, &reaching)?
    } else {
        constant_plus_proportional(plant, integral, &surface, &reaching)?
    };
    let sliding = SlidingLaw {
        surface: c.clone(),
        equivalent: surface.equivalent.clone(),
        surface_poles: surface.poles.iter().map(|p| [p.re, p.im]).collect(),
        switching,
        reaching,
        matched_disturbance: gain,
    };
    let reduced = sliding_loop(plant, integral, &reduced, &on_reduced, &sliding.switching);
    Ok((law, sliding, reduced))
}

/// The loop within the boundary layer on the reduced state, followed by the state of super-twisting.
fn sliding_loop(
    plant: &SampledPlant,
    integral: &[usize],
    reduced: &Reduced,
    surface: &Surface,
    switching: &Switching,
) -> Option<ReducedLoop> {
    let slope = |i: usize| match switching {
        Switching::ConstantPlusProportional { rate, gain, layer } => rate + gain[i] / layer[i],
        Switching::SuperTwisting { k1, layer, .. } => k1[i] / layer[i].sqrt(),
    };
    let mut total = surface.equivalent.clone();
    for i in 0..plant.input_count() {
        let row = total.row(i) + surface.c.row(i) * slope(i);
        total.set_row(i, &row);
    }
    let mut closed = reduced.closed(plant, integral, &total)?;
    if let Switching::SuperTwisting { k2, layer, .. } = switching {
        let (count, m) = (closed.matrix.nrows(), plant.input_count());
        closed.matrix = closed.matrix.resize(count + m, count + m, 0.0);
        closed.matrix.view_mut((0, count), (count, m)).copy_from(&reduced.gamma);
        for i in 0..m {
            let slope = -plant.period_s() * k2[i] / layer[i];
            closed.matrix.view_mut((count + i, 0), (1, count)).copy_from(&(surface.c.row(i) * slope));
            closed.matrix[(count + i, count + i)] = 1.0;
        }
        closed.scales.extend(plant.inputs().iter().map(|l| l.authority()));
    }
    Some(closed)
}

/// Parameters of the reaching law, one value per input.
struct Reaching<'a> {
    gain: &'a [f64],
    layer: &'a [f64],
    rate: f64,
}

/// Second-order sliding: the law, its switching, and the reaching condition as text.
fn super_twisting(
    plant: &SampledPlant,
    integral: &[usize],
    surface: &Surface,
    Reaching { gain, layer, .. }: &Reaching<'_>,
) -> Result<(LinearLaw, Switching, String), DesignError> {
    let dt = plant.period_s();
    let k1: Vec<f64> = gain.iter().map(|g| 1.5 * g.sqrt()).collect();
    let k2: Vec<f64> = gain.iter().map(|g| 1.1 * g).collect();
    let mut total = surface.equivalent.clone();
    for i in 0..plant.input_count() {
        let slope = k1[i] / layer[i].sqrt();
        if slope * dt > 1.0 {
            return Err(DesignError::Reaching {
                why: format!(
                    "k1 T / sqrt(layer) = {:.3} at {} is above one, so the surface would be overshot within a period; \
                     widen `boundary_layer` or lower `switching_gain`",
                    slope * dt,
                    plant.input_names()[i]
                ),
            });
        }
        let row = total.row(i) + surface.c.row(i) * slope;
        total.set_row(i, &row);
    }
    let law = twisting_law(plant, integral, &total, &surface.c, &k2, layer);
    Ok((
        law,
        Switching::SuperTwisting { k1, k2, layer: layer.to_vec() },
        "second order: with k1 = 1.5 sqrt(g) and k2 = 1.1 g, s and its rate reach zero in finite time against \
         matched disturbances that change by less than g per second (Levant 1993)"
            .to_owned(),
    ))
}

/// First-order sliding with a boundary layer: the law, its switching, and the reaching condition as text.
fn constant_plus_proportional(
    plant: &SampledPlant,
    integral: &[usize],
    surface: &Surface,
    Reaching { gain, layer, rate }: &Reaching<'_>,
) -> Result<(LinearLaw, Switching, String), DesignError> {
    let mut total = surface.equivalent.clone();
    let mut worst: f64 = 0.0;
    for i in 0..plant.input_count() {
        let slope = rate + gain[i] / layer[i];
        worst = worst.max(slope * plant.period_s());
        let row = total.row(i) + surface.c.row(i) * slope;
        total.set_row(i, &row);
    }
    if worst > 1.0 {
        return Err(DesignError::Reaching {
            why: format!(
                "(rate + gain / layer) T = {worst:.3} is above one, so the surface would be overshot within a period \
                 and the command would chatter; widen `boundary_layer` or lower `switching_gain`"
            ),
        });
    }
    Ok((
        split(plant, integral, &total),
        Switching::ConstantPlusProportional { rate: *rate, gain: gain.to_vec(), layer: layer.to_vec() },
        format!(
            "|s| falls in every period outside the boundary layer, without overshoot: (rate + gain / layer) T = \
             {worst:.4} <= 1, against any matched disturbance below the switching gain"
        ),
    ))
}

/// The super-twisting law within its layer: one additional state per surface, driven by the surface.
fn twisting_law(
    plant: &SampledPlant,
    integral: &[usize],
    total: &DMatrix<f64>,
    c: &DMatrix<f64>,
    k2: &[f64],
    layer: &[f64],
) -> LinearLaw {
    let (n, m, q, dt) = (plant.size(), plant.input_count(), integral.len(), plant.period_s());
    let mut memory = DMatrix::identity(q + m, q + m);
    let mut memory_input = DMatrix::zeros(q + m, n);
    memory_input.rows_mut(0, q).copy_from(&integral_input(plant, integral));
    for i in 0..m {
        let slope = -dt * k2[i] / layer[i];
        memory_input.set_row(q + i, &(c.row(i).columns(0, n) * slope));
        memory.view_mut((q + i, 0), (1, q)).copy_from(&(c.row(i).columns(n, q) * slope));
    }
    let mut memory_gain = DMatrix::zeros(m, q + m);
    memory_gain.columns_mut(0, q).copy_from(&total.columns(n, q));
    memory_gain.columns_mut(q, m).copy_from(&-DMatrix::<f64>::identity(m, m));
    LinearLaw { gain: total.columns(0, n).into_owned(), memory_gain, memory, memory_input }
}
