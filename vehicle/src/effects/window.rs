//! Time windows of effects.

/// Keys of a window in files.
pub(super) const KEYS: [&str; 2] = ["from_s", "until_s"];

/// A time window on the simulator's clock, from `from_s` (inclusive) to `until_s` (exclusive).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Window {
    /// Beginning, s; unbounded without it.
    pub from_s: Option<f64>,
    /// End, s; unbounded without it.
    pub until_s: Option<f64>,
}

impl Window {
    /// True for an unbounded window.
    pub fn is_always(&self) -> bool {
        *self == Self::default()
    }

    /// True when the time `t` is in the window.
    pub fn holds(&self, t: f64) -> bool {
        self.from_s.is_none_or(|from| t >= from) && self.until_s.is_none_or(|until| t < until)
    }

    /// The given ends, with the names of their keys.
    pub(crate) fn ends(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        KEYS.into_iter().zip([self.from_s, self.until_s]).filter_map(|(key, end)| Some((key, end?)))
    }

    /// Error of the window, if any, with its key.
    pub(super) fn fault(&self) -> Option<(&'static str, String)> {
        if let Some((key, end)) = self.ends().find(|(_, end)| !(end.is_finite() && *end >= 0.0)) {
            return Some((key, format!("must be at least 0 s, but is {end} s")));
        }
        let (from, until) = (self.from_s?, self.until_s?);
        (from >= until).then(|| (KEYS[1], format!("is {until} s, but must be after from_s = {from} s")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_has_its_beginning_and_not_its_end() {
        let window = Window { from_s: Some(1.0), until_s: Some(2.0) };
        assert_eq!([0.99, 1.0, 1.99, 2.0].map(|t| window.holds(t)), [false, true, true, false]);
        assert!(Window::default().holds(7.0) && Window::default().is_always());
        assert_eq!(window.fault(), None);
        let turned = Window { from_s: Some(2.0), until_s: Some(2.0) };
        assert_eq!(turned.fault().unwrap().0, "until_s");
        let negative = Window { from_s: Some(-1.0), until_s: None };
        assert!(negative.fault().is_some());
    }
}
