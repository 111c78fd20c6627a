//! What is told of the steps of flights side by side.

use whirlstand_msgs::Setpoint;

/// One step of K flights, SI; each row of all of them.
pub struct FlownStep<'a, const K: usize> {
    /// Bench time, ns.
    pub stamp_ns: u64,
    /// The true states.
    pub x: &'a [[f64; K]],
    /// The inputs in force.
    pub u: &'a [[f64; K]],
    /// Flags of `Truth`.
    pub flags: &'a [u32; K],
    /// What disturbs the derivative of each state.
    pub disturbance: &'a [[f64; K]],
    /// What the laws were asked for.
    pub setpoint: &'a Setpoint,
    /// The filters' normalised innovations squared.
    pub nis: &'a [f64; K],
    /// Their degrees of freedom.
    pub dof: u32,
    /// The standard deviations that the filters claim.
    pub std: &'a [f64],
    /// Whether the filters say that they have converged.
    pub converged: bool,
}

/// What the nodes of the flight counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NodeCounts {
    /// Steps without a usable command.
    pub misses: u64,
    /// What plant, estimator and controller refused.
    pub rejected: [u64; 3],
}
