//! The library of candidates: every effect of the table at every place of a vehicle, with start values.

use crate::thresholds::{SEARCHED_FACTORS, UNBOUNDED};
use whirlstand_vehicle::{Kind, Matrix, Vehicle};

pub use crate::candidates::candidate::{Candidate, Sizes, Tunable};

fn tunable(name: &'static str, lower: f64, upper: f64, scale: f64) -> Tunable {
    Tunable { name, lower, upper, scale, size: true }
}

/// Tunable scale factor of an input or a sensor.
fn factor() -> Tunable {
    tunable("factor", *SEARCHED_FACTORS.start(), *SEARCHED_FACTORS.end(), 1e-2)
}

/// Tunable that is not a size: a time, a phase, a frequency.
fn free(name: &'static str, lower: f64, upper: f64, scale: f64) -> Tunable {
    Tunable { name, lower, upper, scale, size: false }
}

/// Start values of a rate limit: well below the fastest mean rates of the input over several times, so that it acts in
/// this record, on a slow pilot as on steps; and twice the fastest of all, as a command that is held jumps at the
/// beginning of its period. Rates that are nearly the same give one start.
fn limits(rates: &[f64]) -> Vec<Vec<f64>> {
    let fastest = rates.iter().copied().fold(0.0, f64::max);
    let below = rates.iter().map(|rate| 0.75 * rate);
    let mut starts: Vec<f64> = below.chain([2.0 * fastest]).filter(|limit| *limit > 0.0).collect();
    starts.sort_by(f64::total_cmp);
    starts.dedup_by(|a, b| *a < 1.2 * *b);
    starts.into_iter().map(|limit| vec![limit]).collect()
}

struct Builder<'v> {
    vehicle: &'v Vehicle,
    sizes: &'v Sizes,
    all: Vec<Candidate>,
}

impl Builder<'_> {
    fn add(
        &mut self,
        kind: Kind,
        place: &str,
        tunables: &[Tunable],
        starts: Vec<Vec<f64>>,
    ) -> &mut Candidate {
        let looks = starts.len() as f64;
        self.all.push(Candidate {
            kind,
            place: place.into(),
            tunables: tunables.to_vec(),
            fixed: Vec::new(),
            text: None,
            starts,
            linear: false,
            null: 0.0,
            looks,
        });
        let last = self.all.len() - 1;
        &mut self.all[last]
    }

    /// An effect whose response is proportional to its distance from `null`.
    fn linear(&mut self, kind: Kind, place: &str, tunable: Tunable, null: f64, start: f64) {
        if start != null && start.is_finite() {
            let candidate = self.add(kind, place, &[tunable], vec![vec![start]]);
            (candidate.linear, candidate.null) = (true, null);
        }
    }

    fn inputs(&mut self) {
        let (duration, period) = (self.sizes.duration_s, self.sizes.period_s);
        let longest = (0.25 * duration).min(2.0);
        for (j, input) in self.vehicle.inputs.iter().enumerate() {
            let (name, peak) = (&input.name, self.sizes.inputs[j]);
            if peak <= 0.0 {
                continue;
            }
            let times: Vec<Vec<f64>> = [0.01, 0.03, 0.08, 0.2, 0.5, 1.2]
                .into_iter()
                .filter(|t| *t > 0.3 * period && *t < longest)
                .map(|t| vec![t])
                .collect();
            let late = tunable("delay_s", 0.0, longest, 0.1 * period);
            self.add(Kind::InputDelay, name, &[late], times.clone());
            let lag = tunable("time_constant_s", 0.0, 2.0 * longest, 0.1 * period);
            self.add(Kind::ActuatorLag, name, &[lag], times);
            self.linear(Kind::InputGain, name, factor(), 1.0, 0.9);
            let rate = 1.0 / duration;
            self.linear(
                Kind::GainDrift,
                name,
                tunable("rate_per_s", -2.0 * rate, 20.0 * rate, 1e-2 * rate),
                0.0,
                -0.2 * rate,
            );
            self.linear(
                Kind::InputBias,
                name,
                tunable("offset", -9.0 * peak, 9.0 * peak, 1e-2 * peak),
                0.0,
                0.1 * peak,
            );
            // Up to widths within which the input is nearly all of the time.
            let shares = |whole: f64| [0.03, 0.1, 0.25, 0.5, 0.8].map(|share| vec![share * whole]).to_vec();
            let width = tunable("width", 0.0, peak, 1e-3 * peak);
            self.add(Kind::DeadZone, name, &[width], shares(peak));
            let width = tunable("width", 0.0, 2.0 * peak, 1e-3 * peak);
            self.add(Kind::Backlash, name, &[width], shares(2.0 * peak));
            let fastest = 2.0 * peak / period;
            let limit = tunable("limit_per_s", 1e-3 * peak, fastest, 1e-3 * peak);
            self.add(Kind::RateLimit, name, &[limit], limits(&self.sizes.input_rates[j]));
            self.saturation(j, peak);
            self.modes(name);
            for (i, other) in self.vehicle.inputs.iter().enumerate() {
                if i != j {
                    // Onto an input that the record does not move, a command may come in full.
                    let scale = if self.sizes.inputs[i] > 0.0 { self.sizes.inputs[i] / peak } else { 1.0 };
                    let place = format!("{name}->{}", other.name);
                    let coefficient = tunable("coefficient", -9.0 * scale, 9.0 * scale, 1e-2 * scale);
                    self.linear(Kind::InputCoupling, &place, coefficient, 0.0, 0.1 * scale);
                }
            }
        }
    }

    /// Candidates of a saturation: both limits, or only the one that the record reaches. A limit acts only within the range
    /// that the input covers, which need not lie evenly about zero, and a search does not move one that does not act:
    /// starts lie on either side of the middle of the range, and two limits start separately.
    fn saturation(&mut self, j: usize, peak: f64) {
        let input = &self.vehicle.inputs[j];
        let lower = tunable("lower", -peak, peak, 1e-3 * peak);
        let upper = tunable("upper", -peak, peak, 1e-3 * peak);
        let (low, high) = (input.lower.max(-UNBOUNDED), input.upper.min(UNBOUNDED));
        let (lowest, highest) = self.sizes.input_ranges[j];
        let (middle, half) = (0.5 * (lowest + highest), 0.5 * (highest - lowest));
        let both = [0.9, 0.6, 0.3];
        let both = both.iter().flat_map(|l| both.map(|u| vec![middle - l * half, middle + u * half]));
        let both = both.collect();
        self.add(Kind::InputSaturation, &input.name, &[lower, upper], both);
        let one = |half: f64| [0.95, 0.8, 0.6, 0.4, 0.2].map(|s| vec![middle + s * half]).to_vec();
        self.add(Kind::InputSaturation, &input.name, &[upper], one(half)).fixed =
            vec![(Tunable { lower: low.min(lower.lower), ..lower }, low)];
        self.add(Kind::InputSaturation, &input.name, &[lower], one(-half)).fixed =
            vec![(Tunable { upper: high.max(upper.upper), ..upper }, high)];
    }

    fn modes(&mut self, name: &str) {
        let half = 0.5 / self.sizes.period_s;
        let mut starts = Vec::new();
        for f in [0.3, 0.7, 1.5, 3.0, 6.0, 12.0, 25.0].into_iter().filter(|f| *f < 0.8 * half) {
            starts.extend([0.08, 0.35, 1.0].map(|z| vec![f, z]));
        }
        let frequency = free("frequency_hz", 0.05, half, 1e-2);
        let damping = tunable("damping_ratio", 0.005, 1.0, 1e-3);
        let gain = tunable("gain", 0.05, 20.0, 1e-3);
        self.add(Kind::UnmodelledMode, name, &[frequency, damping], starts.clone()).fixed = vec![(gain, 1.0)];
        let starts = starts.into_iter().map(|mut s| {
            // With a gain of one this would equal the previous candidate.
            s.push(1.25);
            s
        });
        let starts = starts.collect();
        self.add(Kind::UnmodelledMode, name, &[frequency, damping, gain], starts);
    }

    fn entries(&mut self) {
        let vehicle = self.vehicle;
        let (n, m) = vehicle.b.shape();
        for (matrix, columns) in [(Matrix::A, n), (Matrix::B, m)] {
            for i in 0..n {
                for j in 0..columns {
                    let nominal = if matrix == Matrix::A { vehicle.a[(i, j)] } else { vehicle.b[(i, j)] };
                    let free = vehicle.free.iter().any(|f| {
                        matches!(f.target, whirlstand_vehicle::Target::Entry(k, r, c) if k == matrix && r == i && c == j)
                    });
                    if nominal == 0.0 && !free
                        || matrix == Matrix::A && self.vehicle.kinematic_row(i).is_some()
                    {
                        continue;
                    }
                    // The change of this matrix entry that moves its state as much as all other terms
                    // together.
                    let reach = if matrix == Matrix::A { self.sizes.states[j] } else { self.sizes.inputs[j] };
                    if reach <= 0.0 || self.sizes.slopes[i] <= 0.0 {
                        continue;
                    }
                    let scale = self.sizes.slopes[i] / reach;
                    let size = nominal.abs().max(0.3 * scale);
                    let place = format!("{matrix:?}[{},{}]", i + 1, j + 1);
                    let value = tunable("value", nominal - 10.0 * size, nominal + 10.0 * size, 1e-3 * size);
                    let starts = [-0.1, -0.5, 0.5]
                        .map(|s| vec![nominal + s * if s == -0.1 { scale.min(size) } else { size }]);
                    self.add(Kind::ParameterChange, &place, &[value], starts.to_vec()).null = nominal;
                }
            }
        }
    }

    fn states(&mut self) {
        let names: Vec<String> = self.vehicle.states.iter().map(|s| s.name.clone()).collect();
        for (i, name) in names.iter().enumerate() {
            let (x, slope) = (self.sizes.states[i], self.sizes.slopes[i]);
            if x <= 0.0 || slope <= 0.0 {
                continue;
            }
            let c = 0.3 * slope / (x * x);
            self.linear(
                Kind::QuadraticDrag,
                name,
                tunable("coefficient", -99.0 * c, 999.0 * c, 1e-2 * c),
                0.0,
                c,
            );
            let levels = [0.05, 0.3].map(|s| vec![s * slope]).to_vec();
            let level = tunable("level", 0.0, 20.0 * slope, 1e-3 * slope);
            self.add(Kind::CoulombFriction, name, &[level], levels.clone());
            let skew = tunable("asymmetry", -20.0 * slope, 20.0 * slope, 1e-3 * slope);
            let levels = levels.into_iter().map(|v| vec![v[0], 0.0]).collect();
            self.add(Kind::CoulombFriction, name, &[level, Tunable { size: false, ..skew }], levels);
            for (j, onto) in names.iter().enumerate() {
                let slope = self.sizes.slopes[j];
                if slope <= 0.0 || self.vehicle.kinematic_row(j).is_some() {
                    continue;
                }
                let c = 0.3 * slope / (x * x * x);
                let coefficient = tunable("coefficient", -99.0 * c, 999.0 * c, 1e-2 * c);
                let candidate = self.add(
                    Kind::CubicStiffness,
                    &format!("{name}->{onto}"),
                    &[coefficient],
                    vec![vec![0.1 * c], vec![c]],
                );
                (candidate.linear, candidate.null) = (true, 0.0);
            }
        }
    }

    fn outputs(&mut self, present: &[usize]) {
        let (duration, period) = (self.sizes.duration_s, self.sizes.period_s);
        let longest = (0.25 * duration).min(2.0);
        let times: Vec<Vec<f64>> = [0.01, 0.03, 0.08, 0.2, 0.5, 1.2]
            .into_iter()
            .filter(|t| *t > 0.3 * period && *t < longest)
            .map(|t| vec![t])
            .collect();
        for &i in present {
            let name = self.vehicle.outputs[i].name.clone();
            let (peak, noise) = (self.sizes.outputs[i], self.sizes.noise[i]);
            let far = 99.0 * (peak + noise);
            let step = noise.max(1e-6 * peak);
            self.linear(Kind::SensorBias, &name, tunable("offset", -far, far, step), 0.0, step);
            let drift = tunable("rate_per_s", -far / duration, far / duration, step / duration);
            self.linear(Kind::SensorDrift, &name, drift, 0.0, step / duration);
            self.linear(Kind::SensorScale, &name, factor(), 1.0, 0.9);
            let late = tunable("delay_s", 0.0, longest, 0.1 * period);
            self.add(Kind::SensorDelay, &name, &[late], times.clone());
            let lag = tunable("time_constant_s", 0.0, 2.0 * longest, 0.1 * period);
            self.add(Kind::SensorLag, &name, &[lag], times.clone());
        }
        for (a, &i) in present.iter().enumerate() {
            for &j in &present[a + 1..] {
                let (first, second) = (&self.vehicle.outputs[i], &self.vehicle.outputs[j]);
                // An IMU misalignment mixes angles and rates about one axis: pairs of one dimension, angles
                // first. Rates follow their angles, so they form their own pair only where the angles are not
                // measured.
                if first.unit.dimension() == second.unit.dimension() {
                    let place = format!("{},{}", first.name, second.name);
                    let angle = tunable("angle_rad", -1.6, 1.6, 1e-3);
                    self.add(
                        Kind::Misalignment,
                        &place,
                        &[angle],
                        vec![vec![0.1], vec![-0.1], vec![0.6], vec![-0.6]],
                    );
                }
            }
        }
    }
}

/// All candidates whose response follows from the inputs alone; `present` are the outputs that were measured.
/// Events and tones, whose times and frequencies come from the residual, are added by their own searches.
pub fn library(vehicle: &Vehicle, sizes: &Sizes, present: &[usize]) -> Vec<Candidate> {
    let mut builder = Builder { vehicle, sizes, all: Vec::new() };
    builder.inputs();
    builder.entries();
    builder.states();
    builder.outputs(present);
    let fits = |c: &Candidate| {
        c.starts.first().and_then(|s| c.effect(s)).is_some_and(|e| vehicle.clone().add_effect(e).is_ok())
    };
    builder.all.retain(fits);
    builder.all
}

/// A constant force on a state's derivative from time `at_s` on.
pub fn step(place: &str, at_s: f64, magnitude: f64, sizes: &Sizes, looks: f64) -> Candidate {
    let scale = magnitude.abs().max(f64::MIN_POSITIVE);
    Candidate {
        kind: Kind::StepDisturbance,
        place: place.into(),
        tunables: vec![
            free("at_s", sizes.times_s.0, sizes.times_s.1, 0.2 * sizes.period_s),
            tunable("magnitude", -99.0 * scale, 99.0 * scale, 1e-2 * scale),
        ],
        fixed: Vec::new(),
        text: None,
        starts: vec![vec![at_s, magnitude]],
        linear: true,
        null: 0.0,
        looks,
    }
}

/// A constant force on a state's derivative for a limited time.
pub fn pulse(
    place: &str,
    at_s: f64,
    duration_s: f64,
    magnitude: f64,
    sizes: &Sizes,
    looks: f64,
) -> Candidate {
    let mut candidate = step(place, at_s, magnitude, sizes, looks);
    candidate.kind = Kind::PulseDisturbance;
    candidate.tunables.insert(1, free("duration_s", sizes.period_s, sizes.duration_s, 0.2 * sizes.period_s));
    candidate.starts = vec![vec![at_s, duration_s, magnitude]];
    candidate
}

/// A sine on an output (`Kind::Vibration`) or on a state's derivative (`Kind::PeriodicDisturbance`).
pub fn tone(
    kind: Kind,
    place: &str,
    (frequency_hz, amplitude, phase_rad): (f64, f64, f64),
    sizes: &Sizes,
    looks: f64,
) -> Candidate {
    let scale = amplitude.abs().max(f64::MIN_POSITIVE);
    Candidate {
        kind,
        place: place.into(),
        tunables: vec![
            free("frequency_hz", 0.0, 0.5 / sizes.period_s, 1e-2 / sizes.duration_s),
            free("phase_rad", -99.0, 99.0, 1e-2),
            tunable("amplitude", 0.0, 99.0 * scale, 1e-2 * scale),
        ],
        fixed: Vec::new(),
        text: None,
        starts: vec![vec![frequency_hz, phase_rad, amplitude]],
        linear: true,
        null: 0.0,
        looks,
    }
}

/// A transition of the flight mode to that of another vehicle, at an unknown time.
pub fn transition(to: &str, starts: Vec<f64>, sizes: &Sizes, looks: f64) -> Candidate {
    Candidate {
        kind: Kind::ModeTransition,
        place: "vehicle".into(),
        tunables: vec![free("at_s", sizes.times_s.0, sizes.times_s.1, 0.5 * sizes.period_s)],
        fixed: Vec::new(),
        text: Some(to.into()),
        starts: starts.into_iter().map(|t| vec![t]).collect(),
        linear: false,
        null: 0.0,
        looks,
    }
}

#[cfg(test)]
mod tests {
    use super::{Sizes, library};
    use whirlstand_vehicle::{Kind, Vehicle};

    /// A search that begins at small widths does not find an actuator that hardly moves: its response to the width vanishes.
    #[test]
    fn a_search_for_a_width_begins_up_to_where_the_input_hardly_acts() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let all = library(&vehicle, &Sizes::ones(&vehicle, 20.0, 0.02), &[0, 1, 2, 3]);
        for kind in [Kind::DeadZone, Kind::Backlash] {
            let candidate = all.iter().find(|c| c.kind == kind).unwrap();
            let widest = candidate.starts.iter().map(|start| start[0]).fold(0.0, f64::max);
            assert!(widest > 0.7 * candidate.tunables[0].upper, "{kind:?}: {widest}");
        }
    }

    #[test]
    fn a_command_may_come_in_full_onto_an_input_at_rest() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut sizes = Sizes::ones(&vehicle, 20.0, 0.02);
        sizes.inputs = vec![3.0, 0.0];
        let all = library(&vehicle, &sizes, &[0, 1, 2, 3]);
        let coupling = all.iter().find(|c| c.place == "u_roll->u_pitch").unwrap();
        assert!(coupling.tunables[0].upper >= 1.0, "{:?}", coupling.tunables);
    }
}
