//! Offset of the vehicle's clock, so that the age of a measurement is known and not only its time of arrival.

use std::collections::VecDeque;
use std::time::Duration;

/// Number of `TIMESYNC` exchanges remembered; that with the shortest round trip counts.
const EXCHANGES: usize = 16;

/// Length of a window of arrivals; the minimum over the last two windows counts.
const WINDOW: Duration = Duration::from_secs(5);

/// Difference from the clock of the measurements beyond which a `TIMESYNC` clock is another clock, ns.
const OTHER_CLOCK_NS: i64 = 10_000_000_000;

/// Offset of the vehicle's clock: vehicle minus ours, ns.
#[derive(Debug, Clone, Default)]
pub struct PeerClock {
    /// Offset and round trip of each exchange, ns.
    exchanges: VecDeque<(i64, i64)>,
    /// Minimum of arrival minus stamp, in this window and the previous one, ns. An upper limit of our time
    /// minus the vehicle's.
    least: [Option<i64>; 2],
    window_ends: Duration,
}

impl PeerClock {
    /// Processes an answered `TIMESYNC`: sent at `sent`, stamped by the vehicle with `theirs_ns`, back at
    /// `now`.
    pub fn exchange(&mut self, sent: Duration, theirs_ns: i64, now: Duration) {
        let (sent, now) = (ns(sent), ns(now));
        let round_trip = now - sent;
        if round_trip < 0 {
            return;
        }
        if self.exchanges.len() == EXCHANGES {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back((theirs_ns.saturating_sub(sent + round_trip / 2), round_trip));
    }

    /// Processes the stamp of a measurement that arrives now.
    pub fn arrival(&mut self, stamp_ns: i64, now: Duration) {
        if now >= self.window_ends {
            self.least = [self.least[1], None];
            self.window_ends = now + WINDOW;
        }
        let late = ns(now).saturating_sub(stamp_ns);
        self.least[1] = Some(self.least[1].map_or(late, |least| least.min(late)));
    }

    /// The offset and, from `TIMESYNC`, the round trip, ns; `None` before any data.
    pub fn offset(&self) -> Option<(i64, Option<i64>)> {
        let by_arrival = self.least.iter().flatten().min().map(|late| -late);
        let best = self.exchanges.iter().min_by_key(|(_, round_trip)| *round_trip);
        match (best, by_arrival) {
            (Some((offset, trip)), Some(arrival)) if (offset - arrival).abs() <= OTHER_CLOCK_NS => {
                Some((*offset, Some(*trip)))
            }
            (_, Some(arrival)) => Some((arrival, None)),
            (Some((offset, trip)), None) => Some((*offset, Some(*trip))),
            (None, None) => None,
        }
    }

    /// Time of a stamp by our clock; never later than now.
    pub fn ours(&self, stamp_ns: i64, now: Duration) -> Duration {
        let offset = self.offset().map_or(0, |(offset, _)| offset);
        let ours = u64::try_from(stamp_ns.saturating_sub(offset)).unwrap_or(0);
        Duration::from_nanos(ours).min(now)
    }

    /// Resets after a restart of the vehicle.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

/// Nanoseconds as in the protocol; 292 years fit.
pub fn ns(time: Duration) -> i64 {
    i64::try_from(time.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn the_exchange_with_the_shortest_way_counts() {
        let mut clock = PeerClock::default();
        let theirs = |at_ms: i64| (at_ms + 5000) * 1_000_000;
        clock.exchange(ms(0), theirs(30), ms(40));
        clock.exchange(ms(100), theirs(101), ms(102));
        clock.exchange(ms(200), theirs(205), ms(250));
        assert_eq!(clock.offset(), Some((5_000_000_000, Some(2_000_000))));
        clock.arrival(theirs(300), ms(304));
        assert_eq!(clock.ours(theirs(300), ms(304)), ms(300));
        assert_eq!(clock.ours(theirs(900), ms(304)), ms(304), "nothing was measured in the future");
    }

    #[test]
    fn a_link_that_holds_data_back_shows_as_age() {
        let mut clock = PeerClock::default();
        let theirs = |at_ms: i64| (at_ms + 77) * 1_000_000;
        for at in (0..1000).step_by(5) {
            clock.arrival(theirs(at), ms(at as u64 + 3));
        }
        assert_eq!(clock.ours(theirs(1000), ms(1003)), ms(1003));
        clock.arrival(theirs(1005), ms(1300));
        assert_eq!(ms(1300) - clock.ours(theirs(1005), ms(1300)), ms(292));
        assert!(clock.offset().unwrap().1.is_none());
    }

    #[test]
    fn a_timesync_of_another_clock_is_not_used() {
        let mut clock = PeerClock::default();
        clock.arrival(1_000_000, ms(2));
        clock.exchange(ms(3), 1_700_000_000_000_000_000, ms(4));
        assert_eq!(clock.offset(), Some((-1_000_000, None)));
        clock.reset();
        assert_eq!(clock.offset(), None);
    }
}
