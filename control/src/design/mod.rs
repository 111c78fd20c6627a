//! Design of a law for a plant, with the figures of its closed loop.
//!
//! All laws are designed for the sampled plant and for a loop in which the command computed from `x_k` acts
//! over `[t_k+1, t_k+2)`. They feed back the exact prediction `x_k+1 = phi x_k + gamma u_k` (u_k is the
//! command in force), so that the delay does not move the poles of the undelayed design; it adds one pole at
//! the origin per input. Reported poles and margins are those of the delayed loop.
//!
//! A plant with longer input delays ([`SampledPlant::delays_s`]) has past commands as states, and the laws
//! feed back these as well: the regulator by its equation, pole placement by a prediction over each input's
//! own delay, sliding mode by one prediction over the longest delay.

mod ahead;
mod controllability;
mod dwell;
mod error;
mod estimated;
mod linear_law;
mod placement;
mod reduced;
mod regulator;
mod report;
mod resolve;
mod sliding;
mod sliding_law;
mod written_out;

pub use error::DesignError;
pub use estimated::{EstimatedLoop, EstimatedLoopError, LoopFigures};
pub use linear_law::LinearLaw;
use report::round_delays;
pub use report::{Pole, pole};
pub use sliding_law::{SlidingLaw, Switching};

use nalgebra::DMatrix;
use serde::Serialize;
use whirlstand_linalg::{C64, Schur, complex, eigenvalues, pseudo_inverse, singular_values};

use crate::margins::{LoopMargins, MultivariableMargins, ReturnRatio};
use crate::options::{AntiWindup, LawOptions};
use crate::sampled_plant::SampledPlant;

/// A designed law with the figures of its loop.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Design {
    /// Schema identifier, `whirlstand.design.v1`.
    pub schema: &'static str,
    /// Kind of law: `lqr`, `ppc` or `smc`.
    pub law: &'static str,
    /// The plant of the design.
    pub plant: SampledPlant,
    /// The options of the design.
    pub options: LawOptions,
    /// Indices of the states whose error is integrated.
    pub integral: Vec<usize>,
    /// The feedback; for sliding mode, the linear law within the boundary layer.
    pub linear: LinearLaw,
    /// Back-calculation matrix, q x m: pseudo-inverse of the integrals' gain, from the part of the demand
    /// beyond the limits to the change of the integrals that removes it.
    #[serde(skip)]
    pub integral_tracking: DMatrix<f64>,
    /// The sliding surface and its reaching law, for sliding mode only.
    pub sliding: Option<SlidingLaw>,
    /// Poles of the plant alone.
    pub open_loop_poles: Vec<Pole>,
    /// Poles of the closed loop with its delay.
    pub closed_loop_poles: Vec<Pole>,
    /// Condition number of the unit eigenvectors of the loop without its delay, states in units of their scales.
    pub eigenvector_condition: f64,
    /// Margins at each input, the other loops closed, in the order of the inputs.
    pub loop_margins: Vec<LoopMargins>,
    /// Margins at all inputs at once.
    pub multivariable_margins: MultivariableMargins,
    /// Behaviour of integrators at the limits.
    pub anti_windup: AntiWindup,
    /// Figures of the loop with its filter; absent until requested ([`EstimatedLoop::new`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with_estimator: Option<LoopFigures>,
    /// Effects of the vehicle that the design does not contain.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
}

/// An effect of the vehicle that the design does not contain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Name of the effect.
    pub effect: String,
    /// Place of the effect.
    #[serde(rename = "where")]
    pub place: String,
    /// Reason, as a sentence.
    pub why: String,
}

impl Design {
    /// Designs the law given by `options`.
    ///
    /// # Errors
    /// [`DesignError`], which names the option, the state or the pole that prevents the design.
    pub fn new(plant: &SampledPlant, options: &LawOptions) -> Result<Self, DesignError> {
        let (integral, linear, sliding, reduced, anti_windup) = match options {
            LawOptions::Lqr(o) => {
                let integral = resolve::integral(plant, &o.integral)?;
                controllability::check(plant, &integral)?;
                let (linear, reduced) = regulator::lqr(plant, o, &integral)?;
                (integral, linear, None, reduced, o.anti_windup)
            }
            LawOptions::Ppc(o) => {
                let integral = resolve::integral(plant, &o.integral)?;
                controllability::check(plant, &integral)?;
                let (linear, reduced) = placement::ppc(plant, o, &integral)?;
                (integral, linear, None, reduced, o.anti_windup)
            }
            LawOptions::Smc(o) => {
                let integral = resolve::integral(plant, &o.integral)?;
                controllability::check(plant, &integral)?;
                let (linear, sliding, reduced) = sliding::smc(plant, o, &integral)?;
                (integral, linear, Some(sliding), reduced, o.anti_windup)
            }
        };
        let period = plant.period_s();
        let poles = closed_loop_poles(plant, &linear, reduced.as_ref())?;
        if let Some(unstable) = poles.iter().find(|p| p.norm().is_nan() || p.norm() >= 1.0) {
            return Err(DesignError::Unstable { pole: *unstable });
        }
        let ratio = linear.return_ratio(plant);
        let integral_gain = linear.memory_gain.columns(0, integral.len()).into_owned();
        let loop_margins = (0..plant.input_count()).map(|i| ratio.loop_margins(i)).collect();
        let open = eigenvalues(plant.a())?;
        Ok(Self {
            schema: "whirlstand.design.v1",
            law: options.name(),
            plant: plant.clone(),
            options: options.clone(),
            open_loop_poles: open.iter().map(|p| Pole::continuous(*p, period)).collect(),
            closed_loop_poles: poles.iter().map(|p| Pole::discrete(*p, period)).collect(),
            eigenvector_condition: match &reduced {
                None => eigenvector_condition(&scaled(plant, &integral, linear.undelayed(plant)))?,
                Some(reduced) => eigenvector_condition(&reduced.scaled())?,
            },
            loop_margins,
            multivariable_margins: ratio.multivariable()?,
            integral_tracking: pseudo_inverse(&integral_gain, 1e-12)?,
            integral,
            linear,
            sliding,
            anti_windup,
            with_estimator: None,
            left_out: Vec::new(),
        })
    }

    /// The return ratio from which the margins are computed.
    pub fn return_ratio(&self) -> ReturnRatio {
        self.linear.return_ratio(&self.plant)
    }
}

/// Poles of the delayed loop. Those of input delays are set to the origin and not computed: eigenvalues of a
/// register of length n have an error of the n-th root of rounding.
fn closed_loop_poles(
    plant: &SampledPlant,
    linear: &LinearLaw,
    reduced: Option<&reduced::ReducedLoop>,
) -> Result<Vec<C64>, DesignError> {
    let Some(reduced) = reduced else { return Ok(eigenvalues(&linear.closed_loop(plant))?) };
    let mut poles = eigenvalues(&reduced.matrix)?;
    round_delays(&mut poles, reduced.registers);
    let all = plant.size() + plant.input_count() + linear.memory.nrows();
    poles.resize(all, C64::new(0.0, 0.0));
    Ok(poles)
}

/// The loop without delay, with states divided by their scales, integrals by those over one second, and the
/// state of super-twisting by the authority of its input.
fn scaled(plant: &SampledPlant, integral: &[usize], mut loop_: DMatrix<f64>) -> DMatrix<f64> {
    let integrals = integral.iter().map(|&i| plant.scales()[i]);
    let twisting = plant.inputs().iter().map(|i| i.authority());
    for (j, scale) in plant.scales().iter().copied().chain(integrals).chain(twisting).enumerate() {
        if j < loop_.nrows() {
            loop_.column_mut(j).scale_mut(scale);
            loop_.row_mut(j).scale_mut(1.0 / scale);
        }
    }
    loop_
}

/// Condition number of the unit eigenvectors of `a`; infinite when they are dependent.
fn eigenvector_condition(a: &DMatrix<f64>) -> Result<f64, DesignError> {
    let schur = Schur::new(&complex(a))?;
    let n = a.nrows();
    // Eigenvectors of the triangular factor by back substitution; unitary factors do not change the
    // condition.
    let mut v = DMatrix::zeros(n, n);
    for k in 0..n {
        let lambda = schur.s[(k, k)];
        v[(k, k)] = C64::new(1.0, 0.0);
        for i in (0..k).rev() {
            let mut sum = C64::new(0.0, 0.0);
            for j in i + 1..=k {
                sum += schur.s[(i, j)] * v[(j, k)];
            }
            let mut gap = lambda - schur.s[(i, i)];
            let floor = f64::EPSILON * a.norm();
            if gap.norm() < floor {
                gap = C64::new(floor, 0.0);
            }
            v[(i, k)] = sum / gap;
        }
        let norm = v.column(k).norm();
        v.column_mut(k).iter_mut().for_each(|x| *x /= norm);
    }
    let s = singular_values(&v)?;
    Ok(s.max() / s.min())
}
