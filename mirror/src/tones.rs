//! Tones in whitened innovations: the periodogram of blocks of several lengths.
//!
//! The power of a block of n innovations at a frequency, |X|^2 / n, is exponentially distributed with mean
//! one for white innovations, and has the value n a^2 / 4 for a tone of amplitude a. It exceeds x by chance
//! with probability exp(-x), so the threshold follows from the number of tests (Basseville and Nikiforov
//! 1993, 8.2, on changes of the spectrum). The lengths are a factor of four apart: a tone just below the
//! threshold in one block exceeds it in the next longer one.

/// Block lengths, samples.
const LENGTHS: [usize; 3] = [64, 256, 1024];

/// First line, in half lines: a tone with fewer periods in its block is a drift, which the tests of the mean
/// detect.
const LEAST_LINE: usize = 6;

/// The periodogram of one block length.
#[derive(Debug, Clone)]
struct Block {
    length: usize,
    /// Sine and cosine of each line's rotation per sample; `cosine` and `sine` hold the present phases.
    turn: Vec<(f64, f64)>,
    cosine: Vec<f64>,
    sine: Vec<f64>,
    /// Real and imaginary sums of each output, line by line.
    real: Vec<f64>,
    imaginary: Vec<f64>,
    count: usize,
    begun: u64,
}

/// The tests of all outputs.
#[derive(Debug, Clone)]
pub struct Tones {
    blocks: Vec<Block>,
    threshold: f64,
}

impl Tones {
    /// Number of tests per output; each counts like a test at every step.
    pub const TESTS: usize = LENGTHS.len();

    /// `threshold`: the power that is exceeded by chance in one step out of the required number of steps.
    pub fn new(outputs: usize, threshold: f64) -> Self {
        let block = |length: usize| {
            // The lines are half a line apart: a tone between two of them keeps four fifths of its power.
            let lines = LEAST_LINE..length;
            let turn: Vec<(f64, f64)> =
                lines.map(|k| (std::f64::consts::PI * k as f64 / length as f64).sin_cos()).collect();
            let count = turn.len();
            Block {
                length,
                cosine: vec![1.0; count],
                sine: vec![0.0; count],
                real: vec![0.0; count * outputs],
                imaginary: vec![0.0; count * outputs],
                turn,
                count: 0,
                begun: 0,
            }
        };
        Self { blocks: LENGTHS.map(block).into(), threshold }
    }

    /// Resets the blocks at a step.
    pub fn restart(&mut self, step: u64) {
        self.blocks.iter_mut().for_each(|b| b.clear(step));
    }

    /// Processes a step. Returns the strongest detected tone: the ratio of its power to the threshold, its
    /// output, and the start of its block.
    pub fn step(&mut self, step: u64, whitened: &[f64]) -> Option<(f64, usize, u64)> {
        let mut found: Option<(f64, usize, u64)> = None;
        for block in &mut self.blocks {
            block.take(whitened);
            if block.count < block.length {
                continue;
            }
            for output in 0..whitened.len() {
                let beyond = block.most(output) / self.threshold;
                if beyond > 1.0 && found.is_none_or(|f| beyond > f.0) {
                    found = Some((beyond, output, block.begun));
                }
            }
            block.clear(step + 1);
        }
        found
    }
}

impl Block {
    fn clear(&mut self, step: u64) {
        (self.count, self.begun) = (0, step);
        self.cosine.fill(1.0);
        self.sine.fill(0.0);
        self.real.fill(0.0);
        self.imaginary.fill(0.0);
    }

    #[inline]
    fn take(&mut self, whitened: &[f64]) {
        let lines = self.turn.len();
        let sums = self.real.chunks_exact_mut(lines).zip(self.imaginary.chunks_exact_mut(lines));
        for ((real, imaginary), e) in sums.zip(whitened) {
            real.iter_mut().zip(&self.cosine).for_each(|(r, c)| *r += e * c);
            imaginary.iter_mut().zip(&self.sine).for_each(|(i, s)| *i += e * s);
        }
        let lines = self.cosine.iter_mut().zip(&mut self.sine).zip(&self.turn);
        for ((cosine, sine), (turn_sine, turn_cosine)) in lines {
            let next = *cosine * turn_cosine - *sine * turn_sine;
            *sine = *sine * turn_cosine + *cosine * turn_sine;
            *cosine = next;
        }
        self.count += 1;
    }

    fn most(&self, output: usize) -> f64 {
        let lines = self.turn.len();
        let own = output * lines..(output + 1) * lines;
        let power = self.real[own.clone()].iter().zip(&self.imaginary[own]).map(|(r, i)| r * r + i * i);
        power.fold(0.0, f64::max) / self.length as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    #[test]
    fn a_weak_tone_is_found_and_noise_is_none() {
        let mut stream = Stream::new(5, "tones");
        let mut tones = Tones::new(2, 20.0);
        for step in 0..20_000u64 {
            assert_eq!(tones.step(step, &[stream.normal(), stream.normal()]), None, "step {step}");
        }
        let found = (20_000..23_000u64).find_map(|step| {
            let tone = 0.6 * (0.7137 * step as f64).sin();
            tones.step(step, &[stream.normal(), stream.normal() + tone]).map(|f| (step, f))
        });
        let (step, (_, output, begun)) = found.unwrap();
        assert!(output == 1 && step < 22_500 && begun >= 19_400, "{step} {begun}");
    }
}
