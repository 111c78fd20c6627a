//! The table of unit symbols and prefixes.

use std::f64::consts::PI;

use super::dimension::{
    ACCELERATION, ANGLE, Dimension, ENERGY, FLUX, FORCE, FREQUENCY, LENGTH, NONE, POWER, PRESSURE, RATE,
    RESISTANCE, SAMPLES, SPEED, TEMPERATURE, TIME, VOLTAGE,
};
use super::unit::Unit;

/// A symbol of the table: factor and offset to SI, dimension, and whether SI prefixes may stand before it.
pub struct Symbol {
    pub names: &'static [&'static str],
    factor: f64,
    offset: f64,
    dimension: Dimension,
    prefixed: bool,
}

const fn symbol(names: &'static [&'static str], factor: f64, dimension: Dimension) -> Symbol {
    Symbol { names, factor, offset: 0.0, dimension, prefixed: false }
}

const fn si(names: &'static [&'static str], factor: f64, dimension: Dimension) -> Symbol {
    Symbol { names, factor, offset: 0.0, dimension, prefixed: true }
}

/// All symbols. Factors: BIPM SI brochure, 9th edition (2019), tables 4, 7 and 8; foot, knot and pound-force from
/// NIST SP 811.
pub const SYMBOLS: &[Symbol] = &[
    symbol(&["1", "-", ""], 1.0, NONE),
    symbol(&["%", "percent"], 0.01, NONE),
    si(&["rad", "radian", "radians"], 1.0, ANGLE),
    symbol(&["deg", "°", "degree", "degrees"], PI / 180.0, ANGLE),
    symbol(&["cdeg", "centideg"], PI / 18_000.0, ANGLE),
    symbol(&["rev", "turn", "turns"], 2.0 * PI, ANGLE),
    symbol(&["rpm", "RPM"], PI / 30.0, RATE),
    si(&["s", "sec", "second", "seconds"], 1.0, TIME),
    symbol(&["min", "minute", "minutes"], 60.0, TIME),
    symbol(&["h", "hour", "hours"], 3600.0, TIME),
    si(&["Hz"], 1.0, FREQUENCY),
    symbol(&["sample", "samples"], 1.0, SAMPLES),
    si(&["m", "metre", "meter", "metres", "meters"], 1.0, LENGTH),
    symbol(&["ft", "feet", "foot"], 0.3048, LENGTH),
    symbol(&["in", "inch"], 0.0254, LENGTH),
    symbol(&["kt", "kn", "knot", "knots"], 1852.0 / 3600.0, SPEED),
    symbol(&["g", "gee"], 9.80665, ACCELERATION),
    symbol(&["kg"], 1.0, Dimension([1, 0, 0, 0, 0, 0, 0])),
    symbol(&["lb"], 0.453_592_37, Dimension([1, 0, 0, 0, 0, 0, 0])),
    si(&["N"], 1.0, FORCE),
    symbol(&["lbf"], 4.448_221_615_260_5, FORCE),
    si(&["Pa"], 1.0, PRESSURE),
    symbol(&["bar"], 1e5, PRESSURE),
    symbol(&["mbar"], 1e2, PRESSURE),
    si(&["J"], 1.0, ENERGY),
    si(&["W"], 1.0, POWER),
    si(&["A"], 1.0, Dimension([0, 0, 0, 1, 0, 0, 0])),
    si(&["V"], 1.0, VOLTAGE),
    si(&["ohm", "Ohm", "Ω"], 1.0, RESISTANCE),
    si(&["T"], 1.0, FLUX),
    symbol(&["G", "gauss", "Gauss"], 1e-4, FLUX),
    symbol(&["K", "kelvin"], 1.0, TEMPERATURE),
    Symbol {
        names: &["degC", "°C", "celsius"],
        factor: 1.0,
        offset: 273.15,
        dimension: TEMPERATURE,
        prefixed: false,
    },
];

const PREFIXES: &[(&str, f64)] =
    &[("n", 1e-9), ("u", 1e-6), ("µ", 1e-6), ("m", 1e-3), ("c", 1e-2), ("h", 1e2), ("k", 1e3), ("M", 1e6)];

/// The unit of a symbol, with or without a prefix.
pub fn lookup(name: &str) -> Option<Unit> {
    let find = |name: &str, prefixed: bool| {
        SYMBOLS.iter().find(|s| s.names.contains(&name) && (!prefixed || s.prefixed && !name.is_empty()))
    };
    if let Some(s) = find(name, false) {
        return Some(Unit { factor: s.factor, offset: s.offset, dimension: s.dimension });
    }
    PREFIXES.iter().find_map(|(prefix, scale)| {
        let s = find(name.strip_prefix(prefix)?, true)?;
        Some(Unit { factor: scale * s.factor, offset: 0.0, dimension: s.dimension })
    })
}
