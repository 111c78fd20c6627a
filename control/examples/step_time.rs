//! What one step of estimator and controller takes on the quadrotor, from the first step on, and where the time goes.
//!
//! `cargo run --release -p whirlstand-control --example step_time`

use std::hint::black_box;
use std::time::Instant;

use nalgebra::DMatrix;
use whirlstand_control::{
    Controller, Design, Estimator, EstimatorOptions, InputLimits, LawOptions, SampledPlant, Sensors,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let degree = std::f64::consts::PI / 180.0;
    #[rustfmt::skip]
    let a = DMatrix::from_row_slice(4, 4, &[
        0.0, 1.0, 0.0, 0.0,
        -1.1132, -0.7118, 0.0001, 0.0,
        0.0, 0.0, 0.0, 1.0,
        7.2721, 6.1794, -7.9908, -5.2474,
    ]);
    let b = DMatrix::from_row_slice(4, 2, &[0.0, 0.0, -1.1045, 0.0, 0.0, 0.0, -4.5267, -14.4146]) * degree;
    let limits = InputLimits { lower: -20.0, upper: 20.0, rate: f64::INFINITY };
    let plant = SampledPlant::new(a, b, 0.005)?.with_limits(vec![limits; 2])?;
    let sensors = Sensors {
        c: DMatrix::identity(4, 4),
        d: DMatrix::zeros(4, 2),
        std: [0.08, 0.4, 0.08, 0.4].map(|s| s * degree).to_vec(),
        names: ["roll", "roll_rate", "pitch", "pitch_rate"].map(String::from).to_vec(),
    };
    let law = LawOptions::named("smc").ok_or("there is no law of that name")?;
    let design = Design::new(&plant, &law)?;
    // The clock is read once a window; each window is run anew from the start, and the best of several counts.
    let windows = [(0, 128), (128, 1000), (1000, 2000), (2000, 10_000), (10_000, 100_000)];
    println!("{:>18}  {:>14}  {:>14}", "steps", "estimator", "with controller");
    for (from, to) in windows {
        let mut best = [f64::INFINITY; 2];
        for _ in 0..7 {
            for (with_controller, best) in best.iter_mut().enumerate() {
                let mut estimator = Estimator::new(&plant, &sensors, &EstimatorOptions::default())?;
                let mut controller = Controller::new(&design);
                let mut u = [0.0; 2];
                let mut start = Instant::now();
                for k in 0..to {
                    if k == from {
                        start = Instant::now();
                    }
                    let small = 1e-3 * f64::from(k & 15);
                    estimator.step(black_box(&[small, -small, small, 0.0]), 0b1111, &u, &u);
                    if with_controller == 1 {
                        black_box(controller.step(estimator.x(), &[0.0; 4], 0, &mut u));
                    }
                }
                *best = best.min(start.elapsed().as_nanos() as f64 / f64::from(to - from));
                black_box((estimator.x(), u));
            }
        }
        println!("{from:>8} to {to:>7}  {:>11.0} ns  {:>11.0} ns", best[0], best[1]);
    }
    let mut estimator = Estimator::new(&plant, &sensors, &EstimatorOptions::default())?;
    let settled = (0..1_000_000).find(|_| {
        estimator.step(&[0.0; 4], 0b1111, &[0.0; 2], &[0.0; 2]);
        estimator.converged()
    });
    println!("gains kept for good from step {settled:?} on");
    Ok(())
}
