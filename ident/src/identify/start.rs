//! Start values from the data: an equation-error fit with modulating functions.
//!
//! Each equation dx_i/dt = sum a_ij x_j + sum b_ij u_j + c is multiplied by phi(t) = sin^2(pi t / L) exp(-i w
//! t) over windows of length L and integrated by parts, so that no measured signal is differentiated
//! (Shinbrot, NACA TN 3288, 1954; Preisig and Rippin, Comput. Chem. Eng. 17, 1993). The result is a linear
//! regression for the free entries of A and B. A state without a sensor is computed as the derivative of a
//! measured one where the model defines it so.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::{Kind, Matrix, Target, Vehicle};

use super::data::Segment;
use super::problem::Problem;

/// Source of a state's signal.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    /// An output divided by its gain: index of the output, gain.
    Measured(usize, f64),
    /// The derivative of an output divided by its gain: index of the output, gain.
    Derived(usize, f64),
}

/// Start values from the data, one set per window length, longest windows first; empty when a state with free
/// entries cannot be computed from the outputs.
pub fn candidates(problem: &Problem, segments: &[Segment]) -> Vec<Vec<f64>> {
    let given: Vec<f64> = given(problem);
    if problem.parameters.iter().all(|p| p.start.is_some()) {
        return vec![given];
    }
    let mut found = Vec::new();
    let vehicle = problem.vehicle_at(&given);
    let Some(sources) = sources(&vehicle, &problem.weights) else { return found };
    let longest = segments.iter().map(|s| s.steps).max().unwrap_or(0);
    for (divisor, share) in [(1, 0.02), (4, 0.02), (4, 0.05), (10, 0.05), (10, 0.1), (25, 0.1), (25, 0.25)] {
        let window = (longest / divisor).max(32).min(longest);
        if let Some(start) = regress(problem, &vehicle, &sources, segments, window, share, &given) {
            found.push(start);
        }
    }
    found
}

/// Start values from the vehicle file, SI: `start` where given, else the value in the model, both within the
/// bounds.
pub fn given(problem: &Problem) -> Vec<f64> {
    let value = |p: &super::problem::Parameter| {
        p.start.unwrap_or_else(|| problem.vehicle.free_value(&p.target)).clamp(p.lower, p.upper)
    };
    problem.parameters.iter().map(value).collect()
}

/// Index and gain of the output that measures each state alone: the row of C has no other entry, and no entry
/// of C or D in that row is free.
pub fn measuring_outputs(vehicle: &Vehicle, weights: &[f64]) -> Vec<Option<(usize, f64)>> {
    let alone = |i: usize, j: usize| {
        let row = vehicle.c.row(i);
        let only = row.iter().enumerate().all(|(k, c)| (k == j) == (*c != 0.0));
        let direct = vehicle.d.row(i).iter().any(|d| *d != 0.0) || is_free(vehicle, Matrix::D, i);
        weights[i] > 0.0 && only && !direct && !is_free(vehicle, Matrix::C, i)
    };
    let output = |j: usize| (0..vehicle.outputs.len()).find(|i| alone(*i, j));
    (0..vehicle.states.len()).map(|j| output(j).map(|i| (i, vehicle.c[(i, j)]))).collect()
}

/// True when an entry of row `i` is free.
fn is_free(vehicle: &Vehicle, matrix: Matrix, i: usize) -> bool {
    vehicle.free.iter().any(|f| matches!(f.target, Target::Entry(x, r, _) if x == matrix && r == i))
}

fn sources(vehicle: &Vehicle, weights: &[f64]) -> Option<Vec<Source>> {
    let n = vehicle.states.len();
    let direct: Vec<Option<Source>> = measuring_outputs(vehicle, weights)
        .into_iter()
        .map(|s| s.map(|(i, gain)| Source::Measured(i, gain)))
        .collect();
    (0..n)
        .map(|j| {
            direct[j].or_else(|| {
                (0..n).find_map(|r| {
                    let Some(Source::Measured(output, gain)) = direct[r] else { return None };
                    let (integrated, c) = vehicle.kinematic_row(r)?;
                    (integrated == j).then_some(Source::Derived(output, gain * c))
                })
            })
        })
        .collect()
}

/// Integrals of phi, its first and its second derivative times a signal, for one window and frequency: real and
/// imaginary parts.
type Integrals = [[f64; 2]; 3];

/// The modulating function and its derivatives at time t of a window of length l.
fn modulate(t: f64, l: f64, w: f64) -> Integrals {
    let a = std::f64::consts::PI / l;
    let (s, c) = (a * t).sin_cos();
    // w0 = sin^2, w1 = a sin 2at, w2 = 2 a^2 cos 2at.
    let (w0, w1, w2) = (s * s, 2.0 * a * s * c, 2.0 * a * a * (c * c - s * s));
    let (ws, wc) = (w * t).sin_cos();
    // exp(-iwt) = wc - i ws; derivative of the product by the product rule.
    let times = |re: f64, im: f64| [re * wc + im * ws, im * wc - re * ws];
    [times(w0, 0.0), times(w1, -w * w0), times(w2 - w * w * w0, -2.0 * w * w1)]
}

/// Start values from windows of `window` samples with harmonics up to `share` of the sampling frequency;
/// parameters that the equations do not determine keep their value in `given`.
fn regress(
    problem: &Problem,
    vehicle: &Vehicle,
    sources: &[Source],
    segments: &[Segment],
    window: usize,
    share: f64,
    given: &[f64],
) -> Option<Vec<f64>> {
    let (n, m, p) = (problem.n(), problem.m(), problem.p());
    let dt = problem.period_s;
    let l = window as f64 * dt;
    // Harmonics up to a share of the sampling frequency.
    let highest = ((share / dt) * l).floor().max(2.0) as usize;
    let stride = (highest / 60).max(1);
    let delays: Vec<f64> = (0..m).map(|j| delay(vehicle, j)).collect();
    let mut equations: Vec<Vec<f64>> = Vec::new();
    let filled: Vec<Vec<Vec<f64>>> =
        segments.iter().map(|s| (0..p).map(|i| super::data::filled(&s.output(i, p))).collect()).collect();
    for h in (0..=highest).step_by(stride) {
        let harmonic = Harmonic::new(std::f64::consts::TAU * h as f64 / l, window, dt, &delays);
        for (segment, filled) in segments.iter().zip(&filled) {
            for start in (0..).map(|i| i * (window / 2)).take_while(|s| s + window <= segment.steps) {
                let outputs = harmonic.outputs(filled, start);
                let inputs = harmonic.inputs(segment, start);
                equations.extend((0..2).map(|part| equation(sources, &outputs, &inputs, harmonic.one, part)));
            }
        }
    }
    let mut theta = given.to_vec();
    for i in 0..n {
        solve_row(problem, vehicle, i, &equations, &mut theta)?;
    }
    Some(theta)
}

/// The modulating functions of one frequency at the samples of a window; they are the same for all windows.
struct Harmonic {
    /// For every sample the function and its derivatives.
    phi: Vec<Integrals>,
    /// Function of every input and sample at the middle of the hold period, delayed by the input's delay.
    held: Vec<Vec<[f64; 2]>>,
    /// Integral of the function, which multiplies the constant of an equation.
    one: [f64; 2],
}

impl Harmonic {
    /// At the angular frequency `w` in rad/s, for windows of `window` samples of `dt` seconds and inputs with
    /// `delays` in seconds.
    fn new(w: f64, window: usize, dt: f64, delays: &[f64]) -> Self {
        let l = window as f64 * dt;
        let phi: Vec<Integrals> = (0..window).map(|k| modulate(k as f64 * dt, l, w)).collect();
        let held = delays
            .iter()
            .map(|d| (0..window).map(|k| modulate((k as f64 + 0.5) * dt + d, l, w)[0]).collect())
            .collect();
        let one = phi.iter().fold([0.0; 2], |sum, phi| [sum[0] + phi[0][0], sum[1] + phi[0][1]]);
        Self { phi, held, one }
    }

    /// Integrals for every output in the window that begins at sample `start`.
    fn outputs(&self, filled: &[Vec<f64>], start: usize) -> Vec<Integrals> {
        let mut outputs = vec![[[0.0; 2]; 3]; filled.len()];
        for (sums, y) in outputs.iter_mut().zip(filled) {
            for (y, phi) in y[start..start + self.phi.len()].iter().zip(&self.phi) {
                for (sum, phi) in sums.iter_mut().zip(phi) {
                    sum[0] += phi[0] * y;
                    sum[1] += phi[1] * y;
                }
            }
        }
        outputs
    }

    /// Integrals for every input in the window that begins at sample `start`.
    fn inputs(&self, segment: &Segment, start: usize) -> Vec<[f64; 2]> {
        let m = self.held.len();
        let mut inputs = vec![[0.0; 2]; m];
        for (j, (sum, held)) in inputs.iter_mut().zip(&self.held).enumerate() {
            for (k, phi) in held.iter().enumerate() {
                let u = segment.inputs[(start + k) * m + j];
                sum[0] += phi[0] * u;
                sum[1] += phi[1] * u;
            }
        }
        inputs
    }
}

/// The equation of one window and frequency, real (`part` 0) or imaginary (1): [derivatives, states, inputs, one].
fn equation(
    sources: &[Source],
    outputs: &[Integrals],
    inputs: &[[f64; 2]],
    one: [f64; 2],
    part: usize,
) -> Vec<f64> {
    let mut row = Vec::with_capacity(2 * sources.len() + inputs.len() + 1);
    row.extend(sources.iter().map(|source| match *source {
        Source::Measured(i, gain) => -outputs[i][1][part] / gain,
        Source::Derived(i, gain) => outputs[i][2][part] / gain,
    }));
    row.extend(sources.iter().map(|source| match *source {
        Source::Measured(i, gain) => outputs[i][0][part] / gain,
        Source::Derived(i, gain) => -outputs[i][1][part] / gain,
    }));
    row.extend(inputs.iter().map(|u| u[part]));
    row.push(one[part]);
    row
}

/// Total delay of an input, s.
fn delay(vehicle: &Vehicle, input: usize) -> f64 {
    let name = &vehicle.inputs[input].name;
    let own = vehicle.effects.iter().filter(|e| e.kind() == Kind::InputDelay && e.place() == name);
    own.filter_map(|e| e.parameter("delay_s")).sum()
}

/// Regression for the free entries of row `i` of A and B.
fn solve_row(
    problem: &Problem,
    vehicle: &Vehicle,
    i: usize,
    equations: &[Vec<f64>],
    theta: &mut [f64],
) -> Option<()> {
    let n = problem.n();
    let mut free: Vec<(usize, usize)> = Vec::new();
    for (parameter, p) in problem.parameters.iter().enumerate() {
        match p.target {
            Target::Entry(Matrix::A, r, j) if r == i => free.push((parameter, n + j)),
            Target::Entry(Matrix::B, r, j) if r == i => free.push((parameter, 2 * n + j)),
            _ => {}
        }
    }
    if free.is_empty() {
        return Some(());
    }
    let columns = free.len() + 1;
    let mut matrix = DMatrix::zeros(equations.len(), columns);
    let mut right = DVector::zeros(equations.len());
    for (e, row) in equations.iter().enumerate() {
        let known: f64 = (0..n)
            .filter(|j| !free.iter().any(|(_, c)| *c == n + j))
            .map(|j| vehicle.a[(i, j)] * row[n + j])
            .chain(
                (0..problem.m())
                    .filter(|j| !free.iter().any(|(_, c)| *c == 2 * n + j))
                    .map(|j| vehicle.b[(i, j)] * row[2 * n + j]),
            )
            .sum();
        right[e] = row[i] - known;
        for (c, (_, column)) in free.iter().enumerate() {
            matrix[(e, c)] = row[*column];
        }
        matrix[(e, columns - 1)] = row[row.len() - 1];
    }
    let normal = matrix.transpose() * &matrix;
    let solution = super::normal::solve(&normal, &(matrix.transpose() * right))?;
    for (c, (parameter, _)) in free.iter().enumerate() {
        let p = &problem.parameters[*parameter];
        if p.start.is_none() && solution[c].is_finite() {
            theta[*parameter] = solution[c].clamp(p.lower, p.upper);
        }
    }
    Some(())
}

/// Random start values in the inner tenth of the bounds, with damped diagonals: for structures whose states
/// the outputs do not measure.
pub fn scattered(problem: &Problem) -> Vec<Vec<f64>> {
    let mut stream = whirlstand_vehicle::Stream::new(1, "scattered starts");
    let base = given(problem);
    (0..12)
        .map(|_| {
            problem
                .parameters
                .iter()
                .zip(&base)
                .map(|(p, base)| {
                    let unit = stream.uniform() - 0.5;
                    let diagonal = matches!(p.target, Target::Entry(Matrix::A, i, j) if i == j);
                    let move_by = 0.1 * (p.upper - p.lower) * if diagonal { -unit.abs() } else { unit };
                    if p.start.is_some() { *base } else { (base + move_by).clamp(p.lower, p.upper) }
                })
                .collect()
        })
        .collect()
}
