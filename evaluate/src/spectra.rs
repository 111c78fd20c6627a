//! Power spectral density and spectrogram of a signal of any length, in constant memory.

use std::sync::Arc;

use whirlstand_linalg::C64;
use whirlstand_linalg::fft::{self, Fft};

/// Shortest and longest segment, samples.
const LENGTHS: (usize, usize) = (32, 4096);
/// Number of segments that begin within the length of one: with an overlap of three quarters, the Hann window
/// weights all samples alike (Heinzel et al. 2002).
const OVERLAP: usize = 4;
/// Most columns of a spectrogram; beyond that, neighbours are averaged.
const MOST_COLUMNS: usize = 128;
/// Most rows of a spectrogram; beyond that, bins are averaged.
const MOST_ROWS: usize = 128;

/// Power spectral density of a signal, and its spectrogram.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Spectrum {
    /// Frequencies, Hz, from 0 to half the sampling rate.
    pub frequency_hz: Vec<f64>,
    /// One-sided density over all segments, signal unit squared per Hz; empty when no segment was whole.
    pub density: Vec<f64>,
    /// Number of segments.
    pub segments: u64,
    /// The density over time.
    pub spectrogram: Spectrogram,
}

/// Density over time and frequency.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Spectrogram {
    /// Middle of each column, s.
    pub time_s: Vec<f64>,
    /// Middle of each row, Hz.
    pub frequency_hz: Vec<f64>,
    /// One-sided density, signal unit squared per Hz: row by row, a value per column.
    pub density: Vec<Vec<f64>>,
}

/// Sum over the segments of a signal: Welch's method (Welch 1967) with Hann windows, the mean of each segment removed. A
/// segment is a power of two of samples, about a second.
#[derive(Clone)]
pub(crate) struct SpectrumSum {
    period_s: f64,
    window: Vec<f64>,
    fft: Arc<dyn Fft<f64>>,
    /// Samples of the segment that is being filled.
    samples: Vec<f64>,
    last_s: f64,
    spectrum: Vec<C64>,
    density: Vec<f64>,
    segments: u64,
    columns: Vec<Column>,
    /// Segments in a whole column.
    per_column: u64,
}

/// Mean over consecutive segments.
#[derive(Clone)]
struct Column {
    time_s: f64,
    density: Vec<f64>,
    segments: u64,
}

impl Column {
    /// Adds further segments to the mean.
    fn join(&mut self, other: &Self) {
        let all = (self.segments + other.segments) as f64;
        let (mine, theirs) = (self.segments as f64 / all, other.segments as f64 / all);
        self.time_s = mine * self.time_s + theirs * other.time_s;
        self.density.iter_mut().zip(&other.density).for_each(|(a, b)| *a = mine * *a + theirs * b);
        self.segments += other.segments;
    }
}

impl SpectrumSum {
    /// Of a signal that has a sample every `period_s` seconds.
    pub fn new(period_s: f64) -> Self {
        let second = (1.0 / period_s).clamp(LENGTHS.0 as f64, LENGTHS.1 as f64) as usize;
        let length = second.next_power_of_two().min(LENGTHS.1);
        let step = std::f64::consts::TAU / length as f64;
        Self {
            period_s,
            window: (0..length).map(|i| 0.5 - 0.5 * (step * i as f64).cos()).collect(),
            fft: fft::forward(length),
            samples: Vec::with_capacity(length),
            last_s: f64::NEG_INFINITY,
            spectrum: vec![C64::default(); length],
            density: vec![0.0; length / 2 + 1],
            segments: 0,
            columns: Vec::new(),
            per_column: 1,
        }
    }

    /// Takes in the sample at time `t`, s. A segment contains no gap: after a gap, or after a sample that is not
    /// finite, the next segment begins.
    pub fn take(&mut self, t: f64, y: f64) {
        if !y.is_finite() || t - self.last_s > 1.5 * self.period_s {
            self.samples.clear();
        }
        self.last_s = t;
        if !y.is_finite() {
            return;
        }
        self.samples.push(y);
        if self.samples.len() == self.window.len() {
            self.take_segment(t);
            self.samples.drain(..self.window.len() / OVERLAP);
        }
    }

    fn take_segment(&mut self, until_s: f64) {
        let length = self.window.len();
        let mean = self.samples.iter().sum::<f64>() / length as f64;
        for ((bin, w), y) in self.spectrum.iter_mut().zip(&self.window).zip(&self.samples) {
            *bin = C64::new(w * (y - mean), 0.0);
        }
        self.fft.process(&mut self.spectrum);
        let scale = self.period_s / self.window.iter().map(|w| w * w).sum::<f64>();
        let last = length / 2;
        let one_sided = |i: usize| if i == 0 || i == last { scale } else { 2.0 * scale };
        let density: Vec<f64> =
            self.spectrum[..=last].iter().enumerate().map(|(i, bin)| one_sided(i) * bin.norm_sqr()).collect();
        self.density.iter_mut().zip(&density).for_each(|(sum, d)| *sum += d);
        self.segments += 1;
        let time_s = until_s - 0.5 * (length - 1) as f64 * self.period_s;
        let segment = Column { time_s, density: rows(&density), segments: 1 };
        match self.columns.last_mut() {
            Some(column) if column.segments < self.per_column => column.join(&segment),
            _ => self.columns.push(segment),
        }
        if self.columns.len() > MOST_COLUMNS {
            self.per_column *= 2;
            let pairs = self.columns.chunks(2).map(|pair| {
                let mut column = pair[0].clone();
                pair[1..].iter().for_each(|next| column.join(next));
                column
            });
            self.columns = pairs.collect();
        }
    }

    /// The densities of all samples.
    pub fn finish(self) -> Spectrum {
        if self.segments == 0 {
            return Spectrum::default();
        }
        let resolution = 1.0 / (self.window.len() as f64 * self.period_s);
        let frequency_hz: Vec<f64> = (0..self.density.len()).map(|i| i as f64 * resolution).collect();
        let row_hz = rows(&frequency_hz);
        let row = |i: usize| self.columns.iter().map(|column| column.density[i]).collect();
        let spectrogram = Spectrogram {
            time_s: self.columns.iter().map(|column| column.time_s).collect(),
            density: (0..row_hz.len()).map(row).collect(),
            frequency_hz: row_hz,
        };
        let density = self.density.iter().map(|d| d / self.segments as f64).collect();
        Spectrum { frequency_hz, density, segments: self.segments, spectrogram }
    }
}

/// Bins as the rows of a spectrogram: the mean is left out, and neighbours are averaged.
fn rows(bins: &[f64]) -> Vec<f64> {
    let width = (bins.len() - 1).div_ceil(MOST_ROWS);
    bins[1..].chunks(width).map(|row| row.iter().sum::<f64>() / row.len() as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_logs::spectrum::welch;
    use whirlstand_test_harness::noise;

    fn of(signal: &[f64], period_s: f64) -> Spectrum {
        let mut sum = SpectrumSum::new(period_s);
        signal.iter().enumerate().for_each(|(i, y)| sum.take(i as f64 * period_s, *y));
        sum.finish()
    }

    #[test]
    fn the_density_integrates_to_the_variance_as_that_of_a_whole_record_does() {
        let e = noise(20_000, 5);
        let power = |frequency: &[f64], density: &[f64]| density.iter().sum::<f64>() * frequency[1];
        let (here, whole) = (of(&e, 0.01), welch(&e, 0.01));
        let (here, whole) =
            (power(&here.frequency_hz, &here.density), power(&whole.frequency_hz, &whole.density));
        assert!((here - 1.0).abs() < 0.05 && (here / whole - 1.0).abs() < 0.03, "{here} {whole}");
    }

    #[test]
    fn a_tone_that_comes_and_goes_is_seen_where_and_when_it_is() {
        let tone =
            |t: f64| if (40.0..60.0).contains(&t) { (std::f64::consts::TAU * 31.0 * t).sin() } else { 0.0 };
        let signal: Vec<f64> = (0..200_000).map(|i| tone(f64::from(i) * 1e-3)).collect();
        let found = of(&signal, 1e-3).spectrogram;
        assert!(found.time_s.len() <= MOST_COLUMNS && found.frequency_hz.len() <= MOST_ROWS);
        let (mut row, mut best) = (0, 0.0);
        for (i, values) in found.density.iter().enumerate() {
            let most = values.iter().copied().fold(0.0, f64::max);
            if most > best {
                (row, best) = (i, most);
            }
        }
        assert!((found.frequency_hz[row] - 31.0).abs() < 4.0, "{}", found.frequency_hz[row]);
        let loud = found.time_s.iter().zip(&found.density[row]).filter(|(_, d)| **d > 0.1 * best);
        let (first, last) = loud.fold((f64::MAX, f64::MIN), |(f, l), (t, _)| (f.min(*t), l.max(*t)));
        assert!((first - 40.0).abs() < 3.0 && (last - 60.0).abs() < 3.0, "{first} {last}");
    }

    #[test]
    fn a_gap_begins_a_new_segment_and_a_short_signal_has_none() {
        assert_eq!(of(&[1.0; 31], 0.1), Spectrum::default());
        let mut sum = SpectrumSum::new(0.1);
        let times = (0..20).chain(40..60).chain(70..101);
        times.for_each(|i| sum.take(f64::from(i) * 0.1, f64::from(i % 3)));
        assert_eq!(sum.finish().segments, 0);
    }
}
