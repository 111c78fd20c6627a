//! A unit as numbers: what leads to SI, and what kind of quantity it measures.

use super::dimension::{Dimension, NONE, TIME};

/// A unit: how to reach SI, and what kind of quantity it measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    pub(super) factor: f64,
    pub(super) offset: f64,
    pub(super) dimension: Dimension,
}

impl Unit {
    /// The pure number.
    pub const ONE: Self = Self { factor: 1.0, offset: 0.0, dimension: NONE };
    /// The second.
    pub const SECOND: Self = Self { factor: 1.0, offset: 0.0, dimension: TIME };

    /// The coherent SI unit of a dimension.
    pub const fn coherent(dimension: Dimension) -> Self {
        Self { factor: 1.0, offset: 0.0, dimension }
    }

    /// This unit times a power of another, zero points aside; `None` when an exponent leaves the range of i8.
    pub fn times(&self, other: &Self, power: i8) -> Option<Self> {
        let dimension = self.dimension.times(other.dimension, power)?;
        // A quotient, so that a unit over itself is exactly one.
        let factor = match power {
            ..0 => self.factor / other.factor.powi(-i32::from(power)),
            _ => self.factor * other.factor.powi(power.into()),
        };
        Some(Self { factor, offset: 0.0, dimension })
    }

    /// The value in SI of `value` in this unit.
    pub fn to_si(&self, value: f64) -> f64 {
        // A unit of SI leaves every bit as it is, NaN payloads and signed zeros too.
        if self.is_si() { value } else { value * self.factor + self.offset }
    }

    /// The value in this unit of `value` in SI.
    pub fn from_si(&self, value: f64) -> f64 {
        if self.is_si() { value } else { (value - self.offset) / self.factor }
    }

    /// True when values need no conversion.
    pub fn is_si(&self) -> bool {
        self.factor == 1.0 && self.offset == 0.0
    }

    /// How many SI units this one is, the zero point aside: what a slope or a standard deviation is multiplied by.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// What kind of quantity the unit measures.
    pub fn dimension(&self) -> Dimension {
        self.dimension
    }

    /// The coherent SI unit of the same dimension, empty for a pure number.
    pub fn si_symbol(&self) -> String {
        self.dimension.to_string()
    }
}
