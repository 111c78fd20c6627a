//! Logs of simulated flights, made through the same files that a bench writes.

use std::path::{Path, PathBuf};

use nalgebra::DMatrix;
use whirlstand_control::lqr::lqr;
use whirlstand_logs::{BenchInfo, LogWriter, SignalInfo};
use whirlstand_msgs::{
    Command, Disturbance, Estimate, Head, Health, Imu, Message, Setpoint, Truth, flags, latency_bucket,
};
use whirlstand_vehicle::{Effect, Kind, Simulator, Vehicle};

fn bench_info(vehicle: &Vehicle, period_ns: u64) -> BenchInfo {
    let info = |name: &str, unit: String| SignalInfo::new(name, unit);
    BenchInfo {
        version: "0.1.0".into(),
        launch: "quadrotor".into(),
        vehicle: vehicle.name.clone(),
        mode: "lockstep".into(),
        transport: "inproc".into(),
        seed: 1,
        period_ns,
        states: vehicle.states.iter().map(|s| info(&s.name, s.unit.si_symbol())).collect(),
        inputs: vehicle.inputs.iter().map(|s| info(&s.name, s.unit.si_symbol())).collect(),
        outputs: vehicle.outputs.iter().map(|s| info(&s.name, s.unit.si_symbol())).collect(),
        ..BenchInfo::default()
    }
}

/// An estimator that is told the truth but for a known error.
fn estimated(head: Head, x: [f64; 16], y: &[f64], vehicle: &Vehicle) -> Estimate {
    let mut estimate_k =
        Estimate { head, x, count: 4, dof: 4, flags: flags::CONVERGED, ..Estimate::zeroed() };
    for i in 0..4 {
        let noise = (y[i] - x[i]) * 0.3;
        estimate_k.x[i] += noise;
        estimate_k.std[i] = 0.3 * vehicle.outputs[i].noise;
        estimate_k.nis += (noise / estimate_k.std[i]).powi(2);
    }
    estimate_k
}

/// The input that holds the setpoint at rest, and feedback about it.
fn commanded(
    head: Head,
    estimate_k: &Estimate,
    wanted: f64,
    gain: &DMatrix<f64>,
    vehicle: &Vehicle,
) -> Command {
    let trim = -vehicle.a[(1, 0)] * wanted / vehicle.b[(1, 0)];
    let error = [estimate_k.x[0] - wanted, estimate_k.x[1], estimate_k.x[2], estimate_k.x[3]];
    let mut command_k = Command { head, count: 2, ..Command::zeroed() };
    for j in 0..2 {
        let feedback: f64 = (0..4).map(|i| gain[(j, i)] * error[i]).sum();
        command_k.u[j] = (if j == 0 { trim } else { 0.0 } - feedback).clamp(-20.0, 20.0);
    }
    command_k
}

/// Writes the log of a quadrotor under state feedback: 5 deg of roll at 1 s, a pulse on the roll rate at 6 s,
/// three late commands at 9 s, 12 s in all. `effort` weighs the input: a smaller one is a stiffer loop.
pub fn bench_log(folder: &Path, name: &str, effort: f64) -> PathBuf {
    let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
    let pulse = [("at_s", 6.0), ("duration_s", 0.2), ("magnitude", 3.0)];
    vehicle.add_effect(Effect::new(Kind::PulseDisturbance, "roll_rate", &pulse).unwrap()).unwrap();
    let period_ns = 5_000_000;
    let period = period_ns as f64 * 1e-9;
    let bench = bench_info(&vehicle, period_ns);
    let folder = folder.join(name);
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("log.mcap");
    let mut log = LogWriter::create(&path, &bench).unwrap();
    log.attach("vehicle.toml", "application/toml", vehicle.to_toml().as_bytes()).unwrap();
    log.attach("launch.toml", "application/toml", format!("name = \"{name}\"\n").as_bytes()).unwrap();
    let (imu, truth) = (log.channel::<Imu>().unwrap(), log.channel::<Truth>().unwrap());
    let (estimate, command) = (log.channel::<Estimate>().unwrap(), log.channel::<Command>().unwrap());
    let (setpoint, disturbance) = (log.channel::<Setpoint>().unwrap(), log.channel::<Disturbance>().unwrap());
    let health = log.channel::<Health>().unwrap();
    let weight = DMatrix::from_diagonal_element(4, 4, 1.0);
    let cost = DMatrix::from_diagonal_element(2, 2, effort);
    let gain = lqr(&vehicle.a, &vehicle.b, &weight, &cost).unwrap().gain;
    let mut simulator = Simulator::new(&vehicle, period, 7).unwrap();
    let mut u = [0.0, 0.0];
    let mut acting = [0.0; 16];
    let mut report = Health { pid: 1, state: 1, ..Health::zeroed() };
    report.set_node_name("plant");
    for k in 0..2400u64 {
        let head = Head { seq: k, step: k, stamp_ns: k * period_ns };
        let t = k as f64 * period;
        simulator.apply(&u);
        let y = simulator.measure().to_vec();
        let mut now = [0.0; 16];
        now[..4].copy_from_slice(simulator.disturbance());
        if now != acting {
            acting = now;
            log.write(&disturbance, &Disturbance { head, dx: now, count: 4, reserved: 0 }).unwrap();
        }
        let mut x = [0.0; 16];
        x[..4].copy_from_slice(simulator.state());
        let mut applied = [0.0; 8];
        applied[..2].copy_from_slice(simulator.applied());
        let late = (1800..1803).contains(&k);
        let flag = if late { flags::HELD } else { 0 };
        log.write(&truth, &Truth { head, x, u: applied, states: 4, inputs: 2, flags: flag, reserved: 0 })
            .unwrap();
        let mut imu_k = Imu { head, valid: 3, ..Imu::zeroed() };
        (imu_k.roll, imu_k.roll_rate, imu_k.pitch, imu_k.pitch_rate) = (y[0], y[1], y[2], y[3]);
        log.write(&imu, &imu_k).unwrap();
        let estimate_k = estimated(head, x, &y, &vehicle);
        log.write(&estimate, &estimate_k).unwrap();
        let wanted = if t >= 1.0 { 5f64.to_radians() } else { 0.0 };
        let mut setpoint_k = Setpoint { head, tracked: 1, ..Setpoint::zeroed() };
        setpoint_k.x[0] = wanted;
        log.write(&setpoint, &setpoint_k).unwrap();
        let command_k = commanded(head, &estimate_k, wanted, &gain, &vehicle);
        log.write(&command, &command_k).unwrap();
        u = [command_k.u[0], command_k.u[1]];
        let latency = 20_000 + (k * k * 7919) % 60_000;
        report.latency[latency_bucket(latency)] += 1;
        report.latency_max_ns = report.latency_max_ns.max(latency);
        report.steps = k + 1;
        report.deadline_misses += u64::from(late);
        report.head = head;
        if k % 20 == 19 {
            log.write(&health, &report).unwrap();
        }
        simulator.advance();
    }
    log.finish().unwrap();
    path
}
