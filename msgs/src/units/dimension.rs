//! Dimensions of units.

use std::fmt;

/// Number of base dimensions.
pub const BASES: usize = 7;

/// Symbols of the base dimensions, in the order of [`Dimension`].
const BASE_SYMBOLS: [&str; BASES] = ["kg", "m", "s", "A", "K", "rad", "samples"];

/// Exponents of mass, length, time, current, temperature, plane angle and sample count.
///
/// The angle is kept as a dimension of its own, unlike in SI, so that `roll = "5 m"` is an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Dimension(pub(super) [i8; BASES]);

pub const NONE: Dimension = Dimension([0; BASES]);
pub const LENGTH: Dimension = Dimension([0, 1, 0, 0, 0, 0, 0]);
pub const TIME: Dimension = Dimension([0, 0, 1, 0, 0, 0, 0]);
pub const SAMPLES: Dimension = Dimension([0, 0, 0, 0, 0, 0, 1]);
pub const ANGLE: Dimension = Dimension([0, 0, 0, 0, 0, 1, 0]);
pub const RATE: Dimension = Dimension([0, 0, -1, 0, 0, 1, 0]);
pub const FREQUENCY: Dimension = Dimension([0, 0, -1, 0, 0, 0, 0]);
pub const SPEED: Dimension = Dimension([0, 1, -1, 0, 0, 0, 0]);
pub const ACCELERATION: Dimension = Dimension([0, 1, -2, 0, 0, 0, 0]);
pub const FORCE: Dimension = Dimension([1, 1, -2, 0, 0, 0, 0]);
pub const PRESSURE: Dimension = Dimension([1, -1, -2, 0, 0, 0, 0]);
pub const ENERGY: Dimension = Dimension([1, 2, -2, 0, 0, 0, 0]);
pub const POWER: Dimension = Dimension([1, 2, -3, 0, 0, 0, 0]);
pub const VOLTAGE: Dimension = Dimension([1, 2, -3, -1, 0, 0, 0]);
pub const FLUX: Dimension = Dimension([1, 0, -2, -1, 0, 0, 0]);
pub const RESISTANCE: Dimension = Dimension([1, 2, -3, -2, 0, 0, 0]);
pub const TEMPERATURE: Dimension = Dimension([0, 0, 0, 0, 1, 0, 0]);

/// Derived SI symbols that read better than their base units.
const DERIVED: &[(&str, Dimension)] = &[
    ("N", FORCE),
    ("V", VOLTAGE),
    ("W", POWER),
    ("Pa", PRESSURE),
    ("T", FLUX),
    ("ohm", RESISTANCE),
    // Torque of a rotor, by far the more frequent meaning of this dimension on a test rig.
    ("N*m", ENERGY),
];

impl Dimension {
    /// True for a dimensionless number.
    pub fn is_none(&self) -> bool {
        *self == NONE
    }

    /// Exponents of kg, m, s, A, K, rad and samples, in this order.
    pub fn exponents(&self) -> [i8; BASES] {
        self.0
    }

    /// This dimension times a power of another; `None` when an exponent leaves the range of i8.
    pub fn times(self, other: Self, power: i8) -> Option<Self> {
        let mut product = self;
        for (p, o) in product.0.iter_mut().zip(other.0) {
            *p = p.checked_add(o.checked_mul(power)?)?;
        }
        Some(product)
    }
}

/// The coherent SI unit, in the syntax that `Unit` reads; empty for a dimensionless number.
impl fmt::Display for Dimension {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some((symbol, _)) = DERIVED.iter().find(|(_, d)| d == self) {
            return f.write_str(symbol);
        }
        let part = |positive: bool| {
            let sign = if positive { 1 } else { -1 };
            // The angle and the count of samples are named first: rad/s, not s^-1*rad.
            [5, 6, 0, 1, 2, 3, 4]
                .into_iter()
                .filter(move |&i| self.0[i] * sign > 0)
                .map(move |i| match self.0[i] * sign {
                    1 => BASE_SYMBOLS[i].to_string(),
                    power => format!("{}^{power}", BASE_SYMBOLS[i]),
                })
                .collect::<Vec<_>>()
        };
        let (over, under) = (part(true), part(false));
        match (over.is_empty(), under.is_empty()) {
            (true, true) => Ok(()),
            (true, false) => write!(f, "1/{}", under.join("/")),
            (false, true) => f.write_str(&over.join("*")),
            (false, false) => write!(f, "{}/{}", over.join("*"), under.join("/")),
        }
    }
}
