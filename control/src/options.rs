//! Options of a law, from a launch file or a caller. Every key has a default that follows from the plant.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// A law and its options; in a launch file, the key `law` selects the law.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "law", rename_all = "lowercase")]
pub enum LawOptions {
    /// Linear-quadratic regulator.
    Lqr(LqrOptions),
    /// Pole-placement control.
    Ppc(PpcOptions),
    /// Sliding-mode control.
    Smc(SmcOptions),
}

impl LawOptions {
    /// The law of that name (`lqr`, `ppc` or `smc`) with default options.
    pub fn named(law: &str) -> Option<Self> {
        match law {
            "lqr" => Some(Self::Lqr(LqrOptions::default())),
            "ppc" => Some(Self::Ppc(PpcOptions::default())),
            "smc" => Some(Self::Smc(SmcOptions::default())),
            _ => None,
        }
    }

    /// Name of the law: `lqr`, `ppc` or `smc`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Lqr(_) => "lqr",
            Self::Ppc(_) => "ppc",
            Self::Smc(_) => "smc",
        }
    }
}

/// A state or an input, by name or by index from zero.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Selector {
    /// Index from zero.
    Index(usize),
    /// Name in the vehicle file.
    Name(String),
}

/// One number for every state or input: a list in order, or by name (those not named keep their default).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Weights {
    /// The same number for all states or inputs.
    Uniform(f64),
    /// A list in the vehicle's order.
    List(Vec<f64>),
    /// Values by name.
    ByName(BTreeMap<String, f64>),
}

/// Behaviour of an integrator while an input is at its limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AntiWindup {
    /// The integrator is driven back by the demand beyond the limit.
    #[default]
    BackCalculation,
    /// The integrator is held.
    Conditional,
}

/// Options of the linear-quadratic regulator.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LqrOptions {
    /// Diagonal of the state weight Q (continuous time). Default: 1 / scale^2 of each state (Bryson), a hundredth of
    /// that for rates and speeds whose integral is a state too.
    pub q: Option<Weights>,
    /// Diagonal of the input weight R (continuous time). Default: 1 / authority^2 of each input.
    pub r: Option<Weights>,
    /// States whose error is integrated.
    pub integral: Vec<Selector>,
    /// Weight of each integral. Default: (0.5 / s)^2 times the weight of its state.
    pub integral_q: Option<Vec<f64>>,
    /// Behaviour of integrators at the limits.
    pub anti_windup: AntiWindup,
}

/// Options of pole placement.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PpcOptions {
    /// Closed-loop poles in continuous time, `[re, im]` in 1/s, one per state and per integral. Default: the
    /// plant's own, drawn towards `bandwidth` and damped at least by `damping`.
    pub poles: Option<Vec<[f64; 2]>>,
    /// Natural frequency, rad/s, towards which the default poles are drawn: slower ones half the way on a
    /// logarithmic scale, those at the origin to a quarter of it. Default: twice the geometric mean of the
    /// plant's own.
    pub bandwidth: Option<f64>,
    /// Smallest damping ratio of the default poles. Default: 0.8.
    pub damping: Option<f64>,
    /// States whose error is integrated.
    pub integral: Vec<Selector>,
    /// Behaviour of integrators at the limits.
    pub anti_windup: AntiWindup,
}

/// Options of sliding-mode control.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SmcOptions {
    /// Diagonal of the state weight that shapes the surface. Default: as for LQR, but a tenth for rates and
    /// speeds. Excludes `poles`.
    pub q: Option<Weights>,
    /// Poles on the surface in continuous time, `[re, im]` in 1/s: as many as states and integrals less inputs.
    pub poles: Option<Vec<[f64; 2]>>,
    /// Exponential part of the reaching law, 1/s. Default: the default bandwidth of pole placement.
    pub reaching_rate: Option<f64>,
    /// Switching gain of each surface in units of the inputs: the largest matched disturbance that is
    /// rejected. Default: a fifth of the input's authority.
    pub switching_gain: Option<Weights>,
    /// Half-width of the boundary layer around each surface, in input units times s. Default: such that within it
    /// the surface is approached at four times the bandwidth and `reaching_rate` together.
    pub boundary_layer: Option<Weights>,
    /// Second-order sliding by the super-twisting algorithm in place of the constant-plus-proportional law.
    pub super_twisting: bool,
    /// States whose error is integrated.
    pub integral: Vec<Selector>,
    /// Behaviour of integrators at the limits.
    pub anti_windup: AntiWindup,
}
