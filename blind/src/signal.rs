//! Inputs as piecewise linear functions of time, which may jump at their breakpoints.
//!
//! The response of an effect to such a signal is computed piece by piece, so that a delay, a rate limit or a
//! backlash acts at its exact time, independent of the sampling.

/// A linear piece of a signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Piece {
    /// Start, s.
    pub from: f64,
    /// Value at the start.
    pub value: f64,
    /// Slope, per second.
    pub slope: f64,
}

/// A piecewise linear function of time, constant at its rest value before its first breakpoint.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Signal {
    rest: f64,
    pieces: Vec<Piece>,
    /// End of the known part, s.
    until: f64,
}

/// Length below which a piece is a rounding error, s.
const SHORTEST: f64 = 1e-11;
/// Greatest length of the chords that approximate a curve, s.
const CHORD: f64 = 1e-3;

impl Signal {
    /// A sampled signal with zero-order hold.
    pub fn held(values: impl Iterator<Item = f64>, period_s: f64, rest: f64) -> Self {
        let pieces: Vec<Piece> = values
            .enumerate()
            .map(|(k, value)| Piece { from: k as f64 * period_s, value, slope: 0.0 })
            .collect();
        let until = pieces.len() as f64 * period_s;
        Self { rest, pieces, until }
    }

    /// A piecewise constant signal, 0 before the first edge; an edge is a time and the new value.
    pub fn edges(edges: &[(f64, f64)], until: f64) -> Self {
        let pieces = edges.iter().map(|&(from, value)| Piece { from, value, slope: 0.0 }).collect();
        Self { rest: 0.0, pieces, until: until.max(edges.last().map_or(0.0, |e| e.0)) }
    }

    /// The same signal with another value before its first breakpoint.
    pub fn resting(mut self, rest: f64) -> Self {
        self.rest = rest;
        self
    }

    /// Value at the end of the known part.
    pub fn end(&self) -> f64 {
        self.spans().last().map_or(self.rest, |(from, end, value, slope)| value + slope * (end - from))
    }

    /// Appends a signal that is later in time.
    pub fn append(&mut self, next: &Self) {
        self.pieces.extend_from_slice(&next.pieces);
        self.until = next.until;
    }

    /// Value before the record begins.
    pub fn rest(&self) -> f64 {
        self.rest
    }

    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    fn empty(&self, rest: f64) -> Self {
        Self { rest, pieces: Vec::with_capacity(self.pieces.len()), until: self.until }
    }

    fn push(&mut self, from: f64, value: f64, slope: f64) {
        self.pieces.push(Piece { from, value, slope });
    }

    /// Start, end, value and slope of every piece.
    fn spans(&self) -> impl Iterator<Item = (f64, f64, f64, f64)> + '_ {
        let ends = self.pieces.iter().skip(1).map(|p| p.from).chain([self.until]);
        self.pieces.iter().zip(ends).map(|(p, end)| (p.from, end, p.value, p.slope))
    }

    /// The signal times `gain`, plus `offset`.
    pub fn affine(&self, gain: f64, offset: f64) -> Self {
        let map = |p: &Piece| Piece { from: p.from, value: gain * p.value + offset, slope: gain * p.slope };
        Self {
            rest: gain * self.rest + offset,
            pieces: self.pieces.iter().map(map).collect(),
            until: self.until,
        }
    }

    /// A static function of the signal that is linear between the kinks, given as values of its argument.
    pub fn bent(&self, kinks: &[f64], f: impl Fn(f64) -> f64) -> Self {
        let mut out = self.empty(f(self.rest));
        let mut cuts = Vec::new();
        for (from, end, value, slope) in self.spans() {
            cuts.clear();
            cuts.push(from);
            if slope != 0.0 {
                let crossings = kinks.iter().map(|kink| from + (kink - value) / slope);
                cuts.extend(crossings.filter(|t| *t > from + SHORTEST && *t < end - SHORTEST));
                cuts.sort_unstable_by(f64::total_cmp);
            }
            cuts.push(end);
            out.chords(&cuts, |t| f(value + slope * (t - from)), slope != 0.0);
        }
        out
    }

    /// A nonlinear function of time and value, approximated by chords of at most 1 ms.
    pub fn curved(&self, f: impl Fn(f64, f64) -> f64) -> Self {
        let mut out = self.empty(f(0.0, self.rest));
        let mut cuts = Vec::new();
        for (from, end, value, slope) in self.spans() {
            let count = ((end - from) / CHORD).ceil().max(1.0) as usize;
            cuts.clear();
            cuts.extend((0..=count).map(|i| from + (end - from) * i as f64 / count as f64));
            out.chords(&cuts, |t| f(t, value + slope * (t - from)), true);
        }
        out
    }

    fn chords(&mut self, cuts: &[f64], f: impl Fn(f64) -> f64, sloped: bool) {
        for pair in cuts.windows(2) {
            let value = f(pair[0]);
            let slope = if sloped { (f(pair[1]) - value) / (pair[1] - pair[0]) } else { 0.0 };
            self.push(pair[0], value, slope);
        }
    }

    /// Gain drift: u (1 + rate t).
    pub fn drifting(&self, rate_per_s: f64) -> Self {
        if self.pieces.iter().any(|p| p.slope != 0.0) {
            return self.curved(|t, u| u * (1.0 + rate_per_s * t));
        }
        let map = |p: &Piece| Piece {
            from: p.from,
            value: p.value * (1.0 + rate_per_s * p.from),
            slope: p.value * rate_per_s,
        };
        Self { rest: self.rest, pieces: self.pieces.iter().map(map).collect(), until: self.until }
    }

    /// The signal after a rate limiter of `limit` per second.
    pub fn limited(&self, limit: f64) -> Self {
        let mut out = self.empty(self.rest);
        let mut position = self.rest;
        for (from, end, value, slope) in self.spans() {
            let target = |t: f64| value + slope * (t - from);
            let mut t = from;
            while t < end - SHORTEST {
                let gap = target(t) - position;
                if gap == 0.0 && slope.abs() <= limit {
                    out.push(t, target(t), slope);
                    position = target(end);
                    break;
                }
                let side = if gap == 0.0 { slope.signum() } else { gap.signum() };
                let own = side * limit;
                let closing = (own - slope) * side;
                let meet = if closing > 0.0 { t + gap.abs() / closing } else { f64::INFINITY };
                out.push(t, position, own);
                if meet <= end {
                    // The value is set exactly at the meeting time: a remaining gap would be closed in ever
                    // shorter steps.
                    t = meet.max(t + SHORTEST);
                    position = target(t);
                } else {
                    position += own * (end - t);
                    t = end;
                }
            }
        }
        out
    }

    /// The signal after a backlash with a gap of `width`: the output rests until the signal has crossed the
    /// gap.
    pub fn played(&self, width: f64) -> Self {
        let half = 0.5 * width;
        let caught = |position: f64, u: f64| position.clamp(u - half, u + half);
        let mut position = caught(self.rest, self.rest);
        let mut out = self.empty(position);
        for (from, end, value, slope) in self.spans() {
            position = caught(position, value);
            let wall = value - half * slope.signum();
            // Time at which the moving end of the gap reaches the position.
            let touch = if slope == 0.0 { f64::INFINITY } else { from + (position - wall) / slope };
            if touch > from + SHORTEST {
                out.push(from, position, 0.0);
            }
            if touch < end - SHORTEST {
                let touch = touch.max(from);
                out.push(touch, wall + slope * (touch - from), slope);
                position = wall + slope * (end - from);
            }
        }
        out
    }

    /// Adds a relay with hysteresis: +size after the signal exceeded `threshold`, -size after it fell below
    /// the negative threshold.
    pub fn relayed(&self, size: f64, threshold: f64) -> Self {
        let mut side = 0.0;
        let mut out = self.clone();
        for piece in &mut out.pieces {
            if piece.value.abs() > threshold {
                side = piece.value.signum();
            }
            piece.value += size * side;
        }
        out
    }

    /// The signal after stiction: the output rests until the signal is `width` away from it, then jumps to
    /// the signal; sloped pieces are checked every millisecond.
    pub fn sticking(&self, width: f64) -> Self {
        let mut position = self.rest;
        let mut out = self.empty(position);
        for (from, end, value, slope) in self.spans() {
            let count = if slope == 0.0 { 1 } else { ((end - from) / CHORD).ceil().max(1.0) as usize };
            for i in 0..count {
                let after = (end - from) * i as f64 / count as f64;
                let now = value + slope * after;
                if (now - position).abs() >= width {
                    position = now;
                }
                out.push(from + after, position, 0.0);
            }
        }
        out
    }

    /// The signal delayed by `delay_s`, after its rest value.
    pub fn delayed(mut self, delay_s: f64) -> Self {
        if delay_s > 0.0 {
            self = self.moved(delay_s);
            let rest = Piece { from: 0.0, value: self.rest, slope: 0.0 };
            self.pieces.insert(0, rest);
        }
        self
    }

    /// The same pieces later by `delay_s`, without a piece for the rest value before them.
    pub fn moved(mut self, delay_s: f64) -> Self {
        self.pieces.iter_mut().for_each(|p| p.from += delay_s);
        self.until += delay_s;
        self
    }

    /// The value at time `t`; at a jump it is the new value.
    #[cfg(test)]
    pub fn at(&self, t: f64) -> f64 {
        let index = self.pieces.partition_point(|p| p.from <= t);
        self.pieces[..index].last().map_or(self.rest, |p| p.value + p.slope * (t - p.from))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(values: &[f64]) -> Signal {
        Signal::held(values.iter().copied(), 0.1, 0.0)
    }

    fn agrees(signal: &Signal, expected: impl Fn(f64) -> f64) {
        for i in 0..400 {
            let t = 0.000_5 + f64::from(i) * 0.001;
            assert!((signal.at(t) - expected(t)).abs() < 1e-9, "{t}: {} {}", signal.at(t), expected(t));
        }
    }

    #[test]
    fn a_delay_moves_the_jumps_to_where_they_belong() {
        let delayed = steps(&[1.0, 2.0, 3.0, 4.0]).delayed(0.0437);
        agrees(&delayed, |t| ((t - 0.0437) / 0.1).floor().clamp(-1.0, 3.0) + 1.0);
    }

    #[test]
    fn a_rate_limit_follows_at_its_rate_and_stops_at_the_target() {
        // The move to 1 at 4 per second takes 0.25 s; then it moves back.
        let limited = steps(&[1.0, 1.0, 1.0, -1.0]).limited(4.0);
        agrees(&limited, |t| if t < 0.3 { (4.0 * t).min(1.0) } else { 1.0 - 4.0 * (t - 0.3) });
        // The output catches up with a ramp that is slower than the limit, and then follows it.
        let ramp = steps(&[1.0; 4]).drifting(1.0).limited(3.0);
        agrees(&ramp, |t| (3.0 * t).min(1.0 + t));
    }

    /// A gap left by rounding must not be closed in steps of 1e-11 s, which would exhaust the memory.
    #[test]
    fn a_rate_limit_that_has_caught_up_follows_in_one_piece() {
        for gap in [1e-12, 1e-13, -1e-13, 1e-16] {
            let piece = Piece { from: 0.0, value: gap, slope: 0.1 };
            let limited = Signal { rest: 0.0, pieces: vec![piece], until: 1e-6 }.limited(1.0);
            assert!(limited.pieces.len() <= 3, "{gap}: {} pieces", limited.pieces.len());
            assert!((limited.at(0.9e-6) - 0.9e-7).abs() < 1e-11, "{gap}");
        }
    }

    #[test]
    fn a_play_moves_only_when_it_is_pushed() {
        let played = steps(&[1.0, 0.8, 0.3, -1.0]).played(0.4);
        agrees(&played, |t| [0.8, 0.8, 0.5, -0.8][(t / 0.1) as usize]);
        // A ramp from 1 to 2 moves the output from 0.8 on at once.
        let pushed = steps(&[1.0; 4]).drifting(2.5).played(0.4);
        agrees(&pushed, |t| 0.8 + 2.5 * t);
        let back = steps(&[1.0; 4]).drifting(-1.0).played(0.4);
        agrees(&back, |t| (0.8f64).min(1.0 - t + 0.2));
    }

    #[test]
    fn what_sticks_jumps_when_the_gap_is_wide_enough() {
        let stuck = steps(&[0.3, 0.5, 0.8, -0.1]).sticking(0.4);
        agrees(&stuck, |t| [0.0, 0.5, 0.5, -0.1][(t / 0.1) as usize]);
    }

    #[test]
    fn functions_without_memory_are_exact_on_straight_pieces() {
        let ramp = steps(&[1.0; 4]).affine(10.0, -2.0).drifting(-0.5);
        let dead = ramp.bent(&[-7.0, 7.0], |u: f64| u.signum() * (u.abs() - 7.0).max(0.0));
        agrees(&dead, |t| (8.0 * (1.0 - 0.5 * t) - 7.0).max(0.0));
        let square = ramp.curved(|_, u| u * u);
        for i in 0..400 {
            let t = 0.000_25 + f64::from(i) * 0.001;
            assert!((square.at(t) - ramp.at(t).powi(2)).abs() < 1e-4);
        }
    }
}
