//! What becomes of a value that has diverged.

/// Magnitude beyond which a state has diverged; it is held there, and the simulator says that it has diverged.
pub const LARGEST: f64 = 1e12;

/// What a value that has diverged is held at; 0 when it is NaN, which may be of either sign.
pub fn held(value: f64) -> f64 {
    if value.is_nan() { 0.0 } else { value.clamp(-LARGEST, LARGEST) }
}
