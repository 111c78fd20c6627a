//! Start values from the data: an equation-error fit with modulating functions.
//!
//! Each equation dx_i/dt = sum a_ij x_j + sum b_ij u_j + c is multiplied by phi(t) = sin^2(pi t / L) exp(-i w t) over
//! windows of length L and integrated by parts, so that no measured signal is differentiated (Shinbrot, NACA TN 3288,
//! 1954; Preisig and Rippin, Comput. Chem. Eng. 17, 1993). That is linear regression for the free entries of A and B.
//! A state without a sensor is the derivative of a measured one where the model says so.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::{Kind, Matrix, Target, Vehicle};

use super::data::Segment;
use super::problem::Problem;

/// Where the signal of a state comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    /// Output over gain.
    Measured(usize, f64),
    /// Derivative of output over gain.
    Derived(usize, f64),
}

/// Candidates for a start, coarse windows first; empty when some state with free entries cannot be had from the
/// outputs.
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

/// What the file gives: start, or the value that the vehicle has, within the bounds.
pub fn given(problem: &Problem) -> Vec<f64> {
    let value = |p: &super::problem::Parameter| {
        p.start.unwrap_or_else(|| problem.vehicle.free_value(&p.target)).clamp(p.lower, p.upper)
    };
    problem.parameters.iter().map(value).collect()
}

/// For every state the output that shows it alone, and the gain: C has nothing else in its row, and nothing in C or D
/// of that row is free.
pub fn shown(vehicle: &Vehicle, weights: &[f64]) -> Vec<Option<(usize, f64)>> {
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
    let direct: Vec<Option<Source>> =
        shown(vehicle, weights).into_iter().map(|s| s.map(|(i, gain)| Source::Measured(i, gain))).collect();
    (0..n)
        .map(|j| {
            direct[j].or_else(|| {
                (0..n).find_map(|r| {
                    let Some(Source::Measured(output, gain)) = direct[r] else { return None };
                    let row = vehicle.a.row(r);
                    let kinematic = !is_free(vehicle, Matrix::A, r)
                        && !is_free(vehicle, Matrix::B, r)
                        && row.iter().enumerate().all(|(k, a)| (k == j) == (*a != 0.0))
                        && vehicle.b.row(r).iter().all(|b| *b == 0.0);
                    kinematic.then(|| Source::Derived(output, gain * row[j]))
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
    // One equation a window, frequency and part: [derivatives, states, inputs, one].
    let mut equations: Vec<Vec<f64>> = Vec::new();
    let filled: Vec<Vec<Vec<f64>>> =
        segments.iter().map(|s| (0..p).map(|i| super::data::filled(&s.output(i, p))).collect()).collect();
    for h in (0..=highest).step_by(stride) {
        let w = std::f64::consts::TAU * h as f64 / l;
        // The same for all windows.
        let phi: Vec<Integrals> = (0..window).map(|k| modulate(k as f64 * dt, l, w)).collect();
        // A held input acts in the middle of its period, later by the delay.
        let held: Vec<Vec<[f64; 2]>> = delays
            .iter()
            .map(|d| (0..window).map(|k| modulate((k as f64 + 0.5) * dt + d, l, w)[0]).collect())
            .collect();
        let one = phi.iter().fold([0.0; 2], |sum, phi| [sum[0] + phi[0][0], sum[1] + phi[0][1]]);
        for (segment, filled) in segments.iter().zip(&filled) {
            for start in (0..).map(|i| i * (window / 2)).take_while(|s| s + window <= segment.steps) {
                let mut outputs = vec![[[0.0; 2]; 3]; p];
                let mut inputs = vec![[0.0; 2]; m];
                for (sums, y) in outputs.iter_mut().zip(filled) {
                    for (y, phi) in y[start..start + window].iter().zip(&phi) {
                        for (sum, phi) in sums.iter_mut().zip(phi) {
                            sum[0] += phi[0] * y;
                            sum[1] += phi[1] * y;
                        }
                    }
                }
                for (j, (sum, held)) in inputs.iter_mut().zip(&held).enumerate() {
                    for (k, phi) in held.iter().enumerate() {
                        let u = segment.inputs[(start + k) * m + j];
                        sum[0] += phi[0] * u;
                        sum[1] += phi[1] * u;
                    }
                }
                for part in 0..2 {
                    let mut row = Vec::with_capacity(2 * n + m + 1);
                    for source in sources {
                        row.push(match *source {
                            Source::Measured(i, gain) => -outputs[i][1][part] / gain,
                            Source::Derived(i, gain) => outputs[i][2][part] / gain,
                        });
                    }
                    for source in sources {
                        row.push(match *source {
                            Source::Measured(i, gain) => outputs[i][0][part] / gain,
                            Source::Derived(i, gain) => -outputs[i][1][part] / gain,
                        });
                    }
                    row.extend(inputs.iter().map(|u| u[part]));
                    row.push(one[part]);
                    equations.push(row);
                }
            }
        }
    }
    let mut theta = given.to_vec();
    for i in 0..n {
        solve_row(problem, vehicle, i, &equations, &mut theta)?;
    }
    Some(theta)
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

/// Starts scattered over the inner tenth of the bounds, damped: for structures whose states the outputs do not show.
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
