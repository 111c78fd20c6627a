//! Poles in the form used in reports.

use serde::Serialize;
use whirlstand_linalg::C64;

/// Relative rounding error of a pole's power over the registers of a loop.
const ROUNDING: f64 = 1e-10;

/// One pole, discrete and continuous.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pole {
    /// Position in the z plane, `[re, im]`.
    pub discrete: [f64; 2],
    /// The continuous pole s with `z = exp(s T)`, `[re, im]` in 1/s; absent at the origin of the z plane.
    pub continuous: Option<[f64; 2]>,
    /// Natural frequency, rad/s.
    pub frequency_rad_s: Option<f64>,
    /// Damping ratio, one for a decaying real pole.
    pub damping: Option<f64>,
}

impl Pole {
    /// A pole in the z plane, sampled every `period_s`.
    pub fn discrete(z: C64, period_s: f64) -> Self {
        // A pole this close to the origin is a pure delay, up to rounding.
        let s = (z.norm() > 1e-6).then(|| z.ln() / period_s);
        Self::both(z, s)
    }

    /// A pole in the s plane, sampled every `period_s`.
    pub fn continuous(s: C64, period_s: f64) -> Self {
        Self::both((s * period_s).exp(), Some(s))
    }

    fn both(z: C64, s: Option<C64>) -> Self {
        Self {
            discrete: [z.re, z.im],
            continuous: s.map(|s| [s.re, s.im]),
            frequency_rad_s: s.map(|s| s.norm()),
            damping: s.filter(|s| s.norm() > 0.0).map(|s| -s.re / s.norm()),
        }
    }
}

/// The z-plane pole of a continuous one given as `[re, im]` in 1/s.
pub fn pole(s: [f64; 2], period_s: f64) -> C64 {
    (C64::new(s[0], s[1]) * period_s).exp()
}

/// Replaces poles that rounding cannot distinguish from those of a register of that length by the latter.
pub fn round_delays(poles: &mut [C64], registers: usize) {
    if registers > 0 {
        let blurred = ROUNDING.powf(1.0 / registers as f64);
        poles.iter_mut().filter(|p| p.norm() < blurred).for_each(|p| *p = C64::new(0.0, 0.0));
    }
}
