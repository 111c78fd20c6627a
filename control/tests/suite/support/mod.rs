//! What the tests against reference tables share. `reference/systems.py` has the same plants.
#![allow(missing_docs)]

use nalgebra::{Complex, DMatrix};
use whirlstand_control::{Compensation, InputLimits, SampledPlant};

/// SplitMix64 (Steele, Lea and Flood 2014), as in `reference/systems.py`.
#[derive(Debug, Clone)]
pub struct SplitMix(pub u64);

impl SplitMix {
    /// In [-1, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        (z >> 11) as f64 / 4_503_599_627_370_496.0 - 1.0
    }

    pub fn matrix(&mut self, rows: usize, columns: usize) -> DMatrix<f64> {
        let entries: Vec<f64> = (0..rows * columns).map(|_| self.uniform()).collect();
        DMatrix::from_row_slice(rows, columns, &entries)
    }
}

pub struct RandomSystem {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub q: DMatrix<f64>,
    pub r: DMatrix<f64>,
    pub poles: Vec<Complex<f64>>,
}

/// System k of the 200.
pub fn random_system(k: usize) -> RandomSystem {
    let mut g = SplitMix(1000 + k as u64);
    let n = 2 + k % 7;
    let m = (1 + k % 3).min(n);
    let (a, b) = (g.matrix(n, n), g.matrix(n, m));
    let (c, d) = (g.matrix(n, n), g.matrix(m, m));
    let mut poles = Vec::new();
    while poles.len() < n {
        let (re, im) = (-2.0 + g.uniform(), 1.5 + g.uniform());
        if k.is_multiple_of(3) && poles.len() + 2 <= n {
            poles.extend([Complex::new(re, im), Complex::new(re, -im)]);
        } else {
            poles.push(Complex::new(re - 0.3 * poles.len() as f64, 0.0));
        }
    }
    RandomSystem { q: c.transpose() * &c, r: DMatrix::identity(m, m) + d.transpose() * &d, a, b, poles }
}

pub const VEHICLES: [&str; 4] =
    ["quadrotor", "helicopter-hover", "helicopter-longitudinal", "helicopter-lateral"];

/// A and B of the paper's tables in SI units.
pub fn vehicle(name: &str) -> (DMatrix<f64>, DMatrix<f64>) {
    let degree = std::f64::consts::PI / 180.0;
    if name == "quadrotor" {
        #[rustfmt::skip]
        let a = DMatrix::from_row_slice(4, 4, &[
            0.0, 1.0, 0.0, 0.0,
            -1.1132, -0.7118, 0.0001, 0.0,
            0.0, 0.0, 0.0, 1.0,
            7.2721, 6.1794, -7.9908, -5.2474,
        ]);
        let b = DMatrix::from_row_slice(4, 2, &[0.0, 0.0, -1.1045, 0.0, 0.0, 0.0, -4.5267, -14.4146]);
        return (a, b * degree);
    }
    let p: [f64; 20] = match name {
        "helicopter-hover" => [
            -0.0897, -1.0211, 1.8807, 0.7150, -1.0785, -2.6725, -1.1095, -2.0666, 0.3604, 0.0213, -1.1681,
            1.2946, 3.0741, -4.4571, -0.2156, 0.3313, 1.2969, 0.8092, -3.6516, -1.3202,
        ],
        "helicopter-longitudinal" => [
            -4.9522, -0.1898, 1.5900, 5.0240, -3.6885, -1.8418, -4.4536, -3.4587, -0.7884, 0.8237, -0.1264,
            -0.4601, 0.5184, -0.9718, -1.8407, 0.0961, -5.0342, 2.8049, -4.4360, -4.0981,
        ],
        _ => [
            -9.4286, -2.8422, 6.1920, -4.6793, -0.0641, 0.4656, -8.1002, -5.5487, 0.2680, 0.5478, -0.9287,
            -1.3005, 0.3482, -0.1548, -0.4067, 1.1147, -12.7259, -0.0557, 1.8356, -3.6725,
        ],
    };
    let mut a = DMatrix::zeros(8, 8);
    a[(0, 1)] = 1.0;
    a[(2, 3)] = 1.0;
    for j in 0..4 {
        a[(1, j)] = p[j];
        a[(3, j)] = p[4 + j];
    }
    (a[(4, 0)], a[(4, 1)], a[(4, 4)]) = (p[8] / degree, p[9] / degree, p[10]);
    (a[(5, 2)], a[(5, 3)], a[(5, 5)]) = (p[11] / degree, p[12] / degree, p[13]);
    (a[(6, 5)], a[(7, 4)]) = (p[14], p[15]);
    let mut b = DMatrix::zeros(8, 2);
    (b[(1, 0)], b[(1, 1)]) = (p[16] * degree, p[17] * degree);
    (b[(3, 0)], b[(3, 1)]) = (p[18] * degree, p[19] * degree);
    (a, b)
}

/// A vehicle at 200 Hz within the limits of its vehicle file.
pub fn plant(name: &str) -> SampledPlant {
    let (a, b) = vehicle(name);
    let names = ["roll", "roll_rate", "pitch", "pitch_rate", "lateral_speed", "longitudinal_speed"];
    let positions = ["longitudinal_position", "lateral_position"];
    let states = names.iter().chain(&positions).take(a.nrows()).map(|s| (*s).to_owned()).collect();
    let reach = if name == "helicopter-hover" { 10.0 } else { 20.0 };
    let limits = InputLimits { lower: -reach, upper: reach, rate: f64::INFINITY };
    SampledPlant::new(a, b, 0.005)
        .and_then(|p| p.with_limits(vec![limits; 2]))
        .and_then(|p| p.with_names(states, vec!["u_roll".into(), "u_pitch".into()]))
        .expect("the paper's vehicles are sound")
}

/// A matrix from a JSON list of rows.
pub fn matrix(value: &serde_json::Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).expect("a list of rows");
    let columns = rows.first().map_or(0, Vec::len);
    DMatrix::from_fn(rows.len(), columns, |i, j| rows[i][j])
}

pub fn complex(value: &serde_json::Value) -> Vec<Complex<f64>> {
    let pairs: Vec<[f64; 2]> = serde_json::from_value(value.clone()).expect("a list of [re, im]");
    pairs.into_iter().map(|[re, im]| Complex::new(re, im)).collect()
}

/// Largest distance between two sets of numbers after the best greedy matching.
pub fn distance(found: &[Complex<f64>], wanted: &[Complex<f64>]) -> f64 {
    let mut left = found.to_vec();
    let mut worst: f64 = 0.0;
    for w in wanted {
        let Some((at, d)) =
            left.iter().map(|f| (f - w).norm()).enumerate().min_by(|x, y| x.1.total_cmp(&y.1))
        else {
            return f64::INFINITY;
        };
        left.swap_remove(at);
        worst = worst.max(d);
    }
    worst
}

/// All that a law can take back.
pub const ALL: [Compensation; 6] = [
    Compensation::DeadZone,
    Compensation::Backlash,
    Compensation::CoulombFriction,
    Compensation::InputSaturation,
    Compensation::RateLimit,
    Compensation::GainDrift,
];
