//! Random numbers: seeded, portable, one stream per consumer.
//!
//! A [`Stream`] is ChaCha8 keyed by the run's seed, on the stream number that is the FNV-1a hash of the
//! consumer's name. Streams are independent, so adding a sensor does not change another's noise. Everything
//! is computed with IEEE operations and the `libm` crate, so the numbers are the same on every machine.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// The random numbers of one consumer.
#[derive(Debug, Clone, PartialEq)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream of `consumer` in a run with `seed`.
    pub fn new(seed: u64, consumer: &str) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(fnv1a(consumer));
        Self(rng)
    }

    /// Uniform on (0, 1), both ends excluded.
    pub fn uniform(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1u64 << 53) as f64;
        ((self.0.next_u64() >> 11) as f64 + 0.5) * STEP
    }

    /// Fills `out` with numbers of [`Self::uniform`].
    pub(crate) fn uniforms(&mut self, out: &mut [f64]) {
        out.iter_mut().for_each(|value| *value = self.uniform());
    }

    /// Standard normal: the inverse distribution function of one uniform number.
    pub fn normal(&mut self) -> f64 {
        normal_quantile(self.uniform())
    }

    /// True with the given probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }
}

/// FNV-1a, 64 bits (Fowler, Noll, Vo; IETF draft-eastlake-fnv).
fn fnv1a(text: &str) -> u64 {
    text.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

/// Inverse of the standard normal distribution function on (0, 1), to about 1 part in 10^16.
///
/// Source: Wichura, "Algorithm AS 241: The percentage points of the normal distribution", Applied Statistics
/// 37 (1988), routine PPND16.
pub(crate) fn normal_quantile(p: f64) -> f64 {
    let q = p - 0.5;
    if q.abs() <= 0.425 {
        let r = 0.180_625 - q * q;
        return q * ratio(&CENTRE, r);
    }
    let r = libm::sqrt(-libm::log(if q < 0.0 { p } else { 1.0 - p }));
    let magnitude = if r <= 5.0 { ratio(&MIDDLE, r - 1.6) } else { ratio(&TAIL, r - 5.0) };
    if q < 0.0 { -magnitude } else { magnitude }
}

/// Numerator and denominator, lowest power first.
pub(crate) type Ratio = [[f64; 8]; 2];

#[inline(always)]
pub(crate) fn ratio(r: &Ratio, x: f64) -> f64 {
    // Estrin's scheme: the same polynomial as Horner's with a third of the latency.
    let (x2, x4) = (x * x, x * x * (x * x));
    let pair = |c: &[f64; 8], i: usize| c[i] + c[i + 1] * x;
    let polynomial = |c: &[f64; 8]| (pair(c, 0) + x2 * pair(c, 2)) + x4 * (pair(c, 4) + x2 * pair(c, 6));
    polynomial(&r[0]) / polynomial(&r[1])
}

pub(crate) const CENTRE: Ratio = [
    [
        3.387_132_872_796_366_5,
        133.141_667_891_784_38,
        1_971.590_950_306_551_3,
        13_731.693_765_509_46,
        45_921.953_931_549_87,
        67_265.770_927_008_7,
        33_430.575_583_588_13,
        2_509.080_928_730_122_7,
    ],
    [
        1.0,
        42.313_330_701_600_91,
        687.187_007_492_057_9,
        5_394.196_021_424_751,
        21_213.794_301_586_597,
        39_307.895_800_092_71,
        28_729.085_735_721_943,
        5_226.495_278_852_545,
    ],
];

pub(crate) const MIDDLE: Ratio = [
    [
        1.423_437_110_749_683_5,
        4.630_337_846_156_546,
        5.769_497_221_460_691,
        3.647_848_324_763_204_5,
        1.270_458_252_452_368_4,
        0.241_780_725_177_450_6,
        0.022_723_844_989_269_184,
        0.000_774_545_014_278_341_4,
    ],
    [
        1.0,
        2.053_191_626_637_759,
        1.676_384_830_183_803_8,
        0.689_767_334_985_1,
        0.148_103_976_427_480_08,
        0.015_198_666_563_616_457,
        0.000_547_593_808_499_534_5,
        1.050_750_071_644_416_9e-9,
    ],
];

const TAIL: Ratio = [
    [
        6.657_904_643_501_103,
        5.463_784_911_164_114,
        1.784_826_539_917_291_3,
        0.296_560_571_828_504_87,
        0.026_532_189_526_576_124,
        0.001_242_660_947_388_078_4,
        0.000_027_115_555_687_434_876,
        2.010_334_399_292_288_1e-7,
    ],
    [
        1.0,
        0.599_832_206_555_888,
        0.136_929_880_922_735_8,
        0.014_875_361_290_850_615,
        0.000_786_869_131_145_613_2,
        0.000_018_463_183_175_100_548,
        1.421_511_758_316_446e-7,
        2.044_263_103_389_939_8e-15,
    ],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quantile_is_scipys() {
        let table: serde_json::Value =
            serde_json::from_str(include_str!("../reference/normal.json")).unwrap();
        let rows = table["quantiles"].as_array().unwrap();
        assert!(rows.len() > 50);
        for row in rows {
            let (p, expected) = (row[0].as_f64().unwrap(), row[1].as_f64().unwrap());
            let error = (normal_quantile(p) - expected).abs();
            assert!(error <= 4e-15 * expected.abs().max(1e-3), "{p}: {} {expected}", normal_quantile(p));
        }
    }

    #[test]
    fn a_stream_is_the_same_everywhere() {
        // From a second implementation, in Python. A change here changes every log recorded with a seed.
        let table: serde_json::Value =
            serde_json::from_str(include_str!("../reference/normal.json")).unwrap();
        for row in table["streams"].as_array().unwrap() {
            let mut stream = Stream::new(row["seed"].as_u64().unwrap(), row["consumer"].as_str().unwrap());
            for expected in row["uniforms"].as_array().unwrap() {
                assert_eq!(stream.uniform(), expected.as_f64().unwrap(), "{}", row["consumer"]);
            }
        }
        let first = Stream::new(1, "noise/roll").uniform();
        assert_ne!(Stream::new(1, "noise/pitch").uniform(), first);
        assert_ne!(Stream::new(2, "noise/roll").uniform(), first);
    }

    #[test]
    fn normal_deviates_have_the_moments_of_the_normal_distribution() {
        let mut stream = Stream::new(7, "test");
        let n = 400_000;
        let mut sums = [0.0; 4];
        let mut before = 0.0;
        let mut correlation = 0.0;
        for _ in 0..n {
            let x = stream.normal();
            for (power, sum) in sums.iter_mut().enumerate() {
                *sum += x.powi(power as i32 + 1) / f64::from(n);
            }
            correlation += x * before / f64::from(n);
            before = x;
        }
        // Five standard errors: 1, sqrt 2, sqrt 15, sqrt 96 over sqrt n. The seed is fixed, so the test is
        // deterministic.
        let bound = |std: f64| 5.0 * std / f64::from(n).sqrt();
        assert!(sums[0].abs() < bound(1.0), "{sums:?}");
        assert!((sums[1] - 1.0).abs() < bound(2f64.sqrt()), "{sums:?}");
        assert!(sums[2].abs() < bound(15f64.sqrt()), "{sums:?}");
        assert!((sums[3] - 3.0).abs() < bound(96f64.sqrt()), "{sums:?}");
        assert!(correlation.abs() < bound(1.0), "{correlation}");
    }
}
