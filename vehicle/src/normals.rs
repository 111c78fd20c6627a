//! Normal deviates in blocks: bit-identical to [`Stream::normal`], computed in vector registers.
//!
//! Most uniform numbers lie where the quantile is one ratio of polynomials. The others, about one in seven,
//! are collected, and need a logarithm; it is that of the `libm` crate, operation by operation, without
//! branches that these numbers never take.

use multiversion::multiversion;

use crate::random::{CENTRE, MIDDLE, Stream, normal_quantile, ratio};

/// Numbers per block.
pub const BLOCK: usize = 64;

/// Number of tails computed at once.
const TAILS: usize = 8;

/// Normal deviates of a stream that has no other use.
#[derive(Debug, Clone)]
pub struct Normals {
    stream: Stream,
    block: [f64; BLOCK],
    next: usize,
}

impl Normals {
    /// All remaining normal deviates of `stream`.
    pub fn new(stream: Stream) -> Self {
        Self { stream, block: [0.0; BLOCK], next: BLOCK }
    }

    /// The next deviate, as [`Stream::normal`].
    #[inline]
    pub fn next(&mut self) -> f64 {
        if self.next == BLOCK {
            self.stream.uniforms(&mut self.block);
            quantiles(&mut self.block);
            self.next = 0;
        }
        self.next += 1;
        self.block[self.next - 1]
    }
}

/// Replaces uniform numbers by their normal quantiles.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn quantiles(values: &mut [f64; BLOCK]) {
    // A number outside the tails is overwritten by the next one.
    let (mut tails, mut at, mut count) = ([0.0; BLOCK], [0; BLOCK], 0);
    for (i, p) in values.iter().enumerate() {
        (tails[count], at[count]) = (*p, i);
        count += usize::from((p - 0.5).abs() > 0.425);
    }
    for value in values.iter_mut() {
        let q = *value - 0.5;
        *value = q * ratio(&CENTRE, 0.180_625 - q * q);
    }
    // Entries after the last tail are uniform numbers or zero, and their results are unused.
    for first in (0..count).step_by(TAILS) {
        let chunk: [f64; TAILS] = std::array::from_fn(|i| tails[first + i]);
        let computed = tail(&chunk);
        for i in 0..TAILS.min(count - first) {
            values[at[first + i]] = computed[i].unwrap_or_else(|| normal_quantile(chunk[i]));
        }
    }
}

/// Quantiles of numbers more than 0.425 from the middle; `None` for the extreme tails.
#[inline(always)]
fn tail(p: &[f64; TAILS]) -> [Option<f64>; TAILS] {
    let mut magnitude = [0.0; TAILS];
    let mut far = [false; TAILS];
    for i in 0..TAILS {
        let r = (-log(if p[i] - 0.5 < 0.0 { p[i] } else { 1.0 - p[i] })).sqrt();
        magnitude[i] = ratio(&MIDDLE, r - 1.6);
        far[i] = r > 5.0;
    }
    std::array::from_fn(|i| {
        let signed = if p[i] - 0.5 < 0.0 { -magnitude[i] } else { magnitude[i] };
        (!far[i]).then_some(signed)
    })
}

/// Natural logarithm of a number between 2^-60 and 1, 1 excluded.
///
/// Source: FreeBSD's `e_log.c` (Sun Microsystems, 1993) as the `libm` crate has it, MIT.
#[inline(always)]
fn log(x: f64) -> f64 {
    const LN2_HI: f64 = 6.931_471_803_691_238e-1;
    const LN2_LO: f64 = 1.908_214_929_270_587_7e-10;
    const LG: [f64; 7] = [
        6.666_666_666_666_735e-1,
        3.999_999_999_940_942e-1,
        2.857_142_874_366_239e-1,
        2.222_219_843_214_978_4e-1,
        1.818_357_216_161_805e-1,
        1.531_383_769_920_937_3e-1,
        1.479_819_860_511_658_6e-1,
    ];
    /// High half of the square root of one half.
    const ROOT: u64 = 0x3fe6_a09e << 32;
    let bits = x.to_bits() + ((0x3ff0_0000 << 32) - ROOT);
    // Exponent as a number, by the last bits of 2^52: no vector unit before AVX-512 converts 64-bit integers.
    let exponent = f64::from_bits(0x4330_0000_0000_0000 | bits >> 52) - 4_503_599_627_370_496.0 - 1023.0;
    let f = f64::from_bits((bits & 0x000f_ffff_ffff_ffff) + ROOT) - 1.0;
    let half_square = 0.5 * f * f;
    let s = f / (2.0 + f);
    let z = s * s;
    let w = z * z;
    let even = w * (LG[1] + w * (LG[3] + w * LG[5]));
    let odd = z * (LG[0] + w * (LG[2] + w * (LG[4] + w * LG[6])));
    let r = odd + even;
    s * (half_square + r) + exponent * LN2_LO - half_square + f + exponent * LN2_HI
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_block_is_the_quantiles_one_by_one(
            mut values in proptest::collection::vec((0u64..1 << 53, 0u32..54), BLOCK),
        ) {
            // Numbers of all sizes at both ends.
            let step = 1.0 / (1u64 << 53) as f64;
            values[0] = (0, 0);
            values[1] = ((1 << 53) - 1, 0);
            let uniform = |(i, (k, shift)): (usize, &(u64, u32))| {
                let p = ((k >> shift) as f64 + 0.5) * step;
                if i % 2 == 0 || *shift == 0 { p } else { (((1u64 << 53) - 1 - (k >> shift)) as f64 + 0.5) * step }
            };
            let mut block: [f64; BLOCK] = std::array::from_fn(|i| uniform((i, &values[i])));
            let expected = block.map(|p| normal_quantile(p).to_bits());
            quantiles(&mut block);
            prop_assert_eq!(block.map(f64::to_bits), expected);
        }

        #[test]
        fn the_logarithm_is_libms(p in 1e-17f64..0.9999999) {
            prop_assert_eq!(log(p).to_bits(), libm::log(p).to_bits());
        }
    }

    #[test]
    fn a_stream_in_blocks_is_the_stream() {
        for seed in 0..40 {
            let (mut one, mut blocks) =
                (Stream::new(seed, "noise/roll"), Normals::new(Stream::new(seed, "noise/roll")));
            for k in 0..5000 {
                assert_eq!(blocks.next().to_bits(), one.normal().to_bits(), "seed {seed}, number {k}");
            }
        }
    }
}
