//! Onsets with which the search for a cause begins.

/// Onsets before the likeliest one, for effects with memory, as shares of the time since then (at most one
/// second): the initial state of a backlash depends on the input at the onset.
const EARLIER: [f64; 4] = [0.0625, 0.125, 0.25, 0.5];

/// Onsets after the likeliest one, as shares of the time from it to the alarm: a small change of the innovations
/// by chance places it too early, and a candidate whose effect began later explains little from there.
const LATER: [f64; 3] = [0.25, 0.5, 0.75];

/// Number of steps that an effect must have acted.
const LEAST: u64 = 8;

/// What is known of the onset of a change, in steps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Onset {
    /// The likeliest onset.
    pub since: u64,
    /// Number of steps from there to the alarm.
    pub took: u64,
}

impl Onset {
    /// The onsets for effects with memory, or without, on data from step `first` to before step `end`; `second` is
    /// the number of steps in a second.
    pub fn grid(self, remembers: bool, (first, end): (u64, u64), second: u64) -> Vec<u64> {
        let Self { since, took } = self;
        let span = (end - since).min(second) as f64;
        let earlier = EARLIER.iter().filter(|_| remembers).map(|share| (share * span) as u64);
        let earlier = earlier.map(|back| since.saturating_sub(back).max(first + 1).min(since));
        let later = LATER.iter().map(|share| since + (share * took as f64) as u64);
        let later = later.filter(|onset| onset + LEAST < end);
        let mut all: Vec<u64> = earlier.chain([since.max(first + 1).min(since)]).chain(later).collect();
        all.sort_unstable();
        all.dedup();
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn onsets_lie_in_the_data_and_up_to_the_alarm() {
        let onset = Onset { since: 1000, took: 400 };
        assert_eq!(onset.grid(false, (0, 2000), 200), [1000, 1100, 1200, 1300]);
        assert_eq!(onset.grid(true, (960, 1150), 200), [961, 963, 982, 991, 1000, 1100]);
        // After a gap the data begin with the change, and may end before the alarm's distance.
        assert_eq!(onset.grid(false, (1000, 1050), 200), [1000]);
        assert_eq!(Onset { took: 0, ..onset }.grid(false, (0, 2000), 200), [1000]);
    }
}
