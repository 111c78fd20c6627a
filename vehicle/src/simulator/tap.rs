//! Past values of an output, for sensors with a delay.

use super::inputs::split;

/// Stored values of an output for one delay.
#[derive(Debug, Clone)]
pub struct Tap {
    /// Offset within a step at which the output is sampled, s.
    pub offset_s: f64,
    /// Number of samples by which the sensor looks back, 1 being the last one.
    back: usize,
    ring: Vec<f64>,
    newest: usize,
}

impl Tap {
    /// `None` without a delay.
    pub fn new(delay_s: f64, period_s: f64) -> Option<Self> {
        let (whole, fraction) = split(delay_s, period_s);
        // At t_k the output at t_k - whole T - fraction is needed, which lies in the previous step.
        let (offset_s, back) =
            if fraction == 0.0 { (0.0, whole as usize) } else { (period_s - fraction, whole as usize + 1) };
        (back > 0).then(|| Self { offset_s, back, ring: vec![0.0; back], newest: 0 })
    }

    /// True when it has the same delay.
    pub fn looks_like(&self, other: &Self) -> bool {
        (self.offset_s, self.back) == (other.offset_s, other.back)
    }

    /// Stores the output at the tap's offset.
    pub fn push(&mut self, value: f64) {
        self.newest = if self.newest + 1 == self.back { 0 } else { self.newest + 1 };
        self.ring[self.newest] = value;
    }

    /// The output one delay ago.
    pub fn value(&self) -> f64 {
        // The ring is exactly as long as the delay: the oldest entry is the next to be overwritten.
        self.ring[if self.newest + 1 == self.back { 0 } else { self.newest + 1 }]
    }

    /// Sets all past values to this value.
    pub fn fill(&mut self, value: f64) {
        self.ring.fill(value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tap_looks_back_exactly_its_delay() {
        for whole in 1..5usize {
            let mut tap = Tap::new(whole as f64 * 0.1, 0.1).unwrap();
            assert_eq!(tap.offset_s, 0.0);
            for k in 0..20 {
                tap.push(f64::from(k));
                // Read at t_{k+1}, after the push at t_k.
                if k as usize + 1 >= whole {
                    assert_eq!(tap.value(), f64::from(k + 1) - whole as f64);
                }
            }
        }
        assert!(Tap::new(0.0, 0.1).is_none());
        let tap = Tap::new(0.13, 0.1).unwrap();
        assert!((tap.offset_s - 0.07).abs() < 1e-12);
        assert_eq!(tap.back, 2);
    }
}
