//! A unit as numbers: conversion to SI, and dimension.

use super::dimension::{Dimension, NONE, SAMPLES, TIME};

/// A unit: its conversion to SI, and its dimension.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    pub(super) factor: f64,
    pub(super) offset: f64,
    pub(super) dimension: Dimension,
}

impl Unit {
    /// The dimensionless unit one.
    pub const ONE: Self = Self { factor: 1.0, offset: 0.0, dimension: NONE };
    /// The second.
    pub const SECOND: Self = Self { factor: 1.0, offset: 0.0, dimension: TIME };
    /// The count of samples.
    pub const SAMPLES: Self = Self { factor: 1.0, offset: 0.0, dimension: SAMPLES };

    /// The coherent SI unit of a dimension.
    pub const fn coherent(dimension: Dimension) -> Self {
        Self { factor: 1.0, offset: 0.0, dimension }
    }

    /// This unit times a power of another, without zero points; `None` when an exponent leaves the range of
    /// i8.
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
        // A value in SI is unchanged in every bit, NaN payloads and signed zeros included.
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

    /// SI value of one unit without the zero point: the factor of a slope or a standard deviation.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// Dimension of the unit.
    pub fn dimension(&self) -> Dimension {
        self.dimension
    }

    /// The coherent SI unit of the same dimension; empty for a dimensionless number.
    pub fn si_symbol(&self) -> String {
        self.dimension.to_string()
    }
}
