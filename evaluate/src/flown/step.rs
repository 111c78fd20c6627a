//! The data of a step of flights side by side.

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
    /// Disturbance of the derivative of each state.
    pub disturbance: &'a [[f64; K]],
    /// Setpoint of the laws.
    pub setpoint: &'a Setpoint,
    /// The filters' normalised innovations squared.
    pub nis: &'a [f64; K],
    /// Degrees of freedom of the innovations.
    pub dof: u32,
    /// The standard deviations that the filters claim.
    pub std: &'a [f64],
    /// Whether the filters report convergence.
    pub converged: bool,
}

/// Counts of the flight's nodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NodeCounts {
    /// Steps without a usable command.
    pub misses: u64,
    /// Messages that plant, estimator and controller refused.
    pub rejected: [u64; 3],
}
