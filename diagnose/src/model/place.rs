//! Where the samples of a run go among those of all channels.

/// Position of the next sample of a channel in the vector of all samples.
pub struct Place {
    /// Index of the output.
    pub output: usize,
    /// Steps between two samples.
    pub stride: usize,
    /// Step of the next sample.
    pub next: usize,
    /// Index of the next sample.
    pub at: usize,
    /// Index after the channel's last sample.
    pub end: usize,
    /// Largest allowed magnitude.
    pub reach: f64,
}

impl Place {
    /// Copies the samples that lie in the steps from `first` on, whose values `of` gives for an output; false
    /// where one exceeds all bounds.
    pub fn take<'a>(&mut self, first: usize, of: impl Fn(usize) -> &'a [f64], samples: &mut [f64]) -> bool {
        let values = of(self.output);
        if self.at == self.end {
            return true;
        }
        if self.stride == 1 {
            let there = values.get(self.next - first..).unwrap_or_default();
            let there = &there[..there.len().min(self.end - self.at)];
            samples[self.at..self.at + there.len()].copy_from_slice(there);
            self.next += there.len();
            self.at += there.len();
            return there.iter().fold(true, |within, y| within & (y.abs() <= self.reach));
        }
        while self.at < self.end
            && let Some(y) = values.get(self.next - first)
        {
            // NaN exceeds any bound.
            if y.is_nan() || y.abs() > self.reach {
                return false;
            }
            samples[self.at] = *y;
            self.next += self.stride;
            self.at += 1;
        }
        true
    }
}
