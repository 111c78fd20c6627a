//! False alarms in clean flight: `cargo run --release -p whirlstand-mirror --example clean -- VEHICLE HOURS [SEED]`.

mod support;

use support::Flight;
use whirlstand_mirror::{Mirror, Options};
use whirlstand_vehicle::{Engine, Vehicle};

fn main() {
    let mut args = std::env::args().skip(1);
    let name = args.next().unwrap_or_else(|| "quadrotor".into());
    let hours: f64 = args.next().map_or(1.0, |a| a.parse().expect("hours"));
    let seed: u64 = args.next().map_or(1, |a| a.parse().expect("a seed"));
    let period_s = 0.005;
    let vehicle = Vehicle::builtin(&name).expect("a built-in vehicle");
    let mut flight = Flight::new(&vehicle, period_s, seed, None);
    let options = Options::new(Engine::Flying, true, period_s);
    let mut mirror = Mirror::new(&vehicle, period_s, &options).expect("a vehicle that can be mirrored");
    let steps = (3600.0 * hours / period_s) as u64;
    let begun = std::time::Instant::now();
    let mut spent = std::time::Duration::ZERO;
    let (mut sums, mut squares) = (vec![0.0; vehicle.outputs.len()], vec![0.0; vehicle.outputs.len()]);
    let mut alarms = 0;
    for _ in 0..steps {
        flight.fly();
        let from = std::time::Instant::now();
        let finding = mirror.observe(&flight.sample());
        spent += from.elapsed();
        for (i, e) in mirror.whitened().iter().enumerate() {
            sums[i] += e;
            squares[i] += e * e;
        }
        if let Some(finding) = finding {
            alarms += 1;
            println!("{:.2} s: {finding:?}", finding.step as f64 * period_s);
        }
    }
    let n = steps as f64;
    println!(
        "{name}, {hours} h, seed {seed}: {alarms} findings; {:.2} us a step in the mirror, {:.1} s in all",
        1e6 * spent.as_secs_f64() / n,
        begun.elapsed().as_secs_f64()
    );
    for (i, output) in vehicle.outputs.iter().enumerate() {
        println!("  {}: mean {:.4}, variance {:.4}", output.name, sums[i] / n, squares[i] / n);
    }
}
