//! One step of a linear simulation at one value of the parameters, with derivatives by all of them.

use nalgebra::DMatrix;
use whirlstand_vehicle::{HammersteinModel, InputPaths, Matrix, Target};

use super::problem::{Problem, parameter_sides};
use super::sensitivity::exponential_with_derivatives;

/// Derivative of a matrix's entry, or of a vector's in column 0.
#[derive(Debug, Clone, Copy)]
pub struct Slope {
    pub parameter: usize,
    pub row: usize,
    pub column: usize,
    pub value: f64,
}

/// `z+ = motion [z; v]` and `y = sensing [z; v] + offsets`, with v from `drive`.
#[derive(Debug)]
pub struct LinearStep {
    /// States x (states + width of the drive): the vehicle's own states, then those of effects on its inputs.
    pub motion: DMatrix<f64>,
    pub motion_slopes: Vec<Slope>,
    /// Outputs x (states + width of the drive).
    pub sensing: DMatrix<f64>,
    pub sensing_slopes: Vec<Slope>,
    pub offsets: Vec<f64>,
    /// States at the start, zero for the vehicle's own.
    pub start: Vec<f64>,
    pub start_slopes: Vec<Slope>,
    pub drive: Drive,
}

/// What drives a step.
#[derive(Debug, Clone)]
pub enum Drive {
    /// The commands as they are recorded.
    Recorded,
    /// The commands behind static effects and delays; then for each parameter of these effects the derivatives by it of its
    /// own input, until and from the fraction of a step by which it is delayed.
    Behind(Box<InputPaths>, Vec<Moved>),
}

/// The inputs' paths on both sides of a parameter on which they depend.
#[derive(Debug, Clone)]
pub struct Moved {
    input: usize,
    sides: [InputPaths; 2],
    /// Inverse of the distance between the sides.
    inverse: f64,
    scratch: Vec<f64>,
}

impl Drive {
    /// Begins at a step of the vehicle's clock.
    pub fn begin_at(&mut self, step: u64) {
        if let Self::Behind(commands, moved) = self {
            let sides = moved.iter_mut().flat_map(|one| &mut one.sides);
            sides.chain([&mut **commands]).for_each(|commands| commands.begin_at(step));
        }
    }

    /// Writes what the commands `u` of the next step drive it with.
    pub fn next(&mut self, u: &[f64], v: &mut [f64]) {
        let Self::Behind(commands, moved) = self else {
            v.copy_from_slice(u);
            return;
        };
        let m = u.len();
        let (own, slopes) = v.split_at_mut(2 * m);
        commands.next(u, own);
        for (one, slopes) in moved.iter_mut().zip(slopes.as_chunks_mut::<2>().0) {
            *slopes = [0.0; 2];
            for (side, sign) in one.sides.iter_mut().zip([one.inverse, -one.inverse]) {
                side.next(u, &mut one.scratch);
                slopes[0] += sign * one.scratch[one.input];
                slopes[1] += sign * one.scratch[m + one.input];
            }
        }
    }
}

impl LinearStep {
    /// The step at `theta`; `None` when it is not finite, and when the vehicle is not linear behind its inputs.
    pub fn new(problem: &Problem, theta: &[f64]) -> Option<Self> {
        if problem.is_plain() { Self::plain(problem, theta) } else { Self::behind_effects(problem, theta) }
    }

    /// A vehicle without effects: the derivatives are exact.
    fn plain(problem: &Problem, theta: &[f64]) -> Option<Self> {
        let (n, m, p) = (problem.n(), problem.m(), problem.p());
        let w = n + m;
        let [a, b, c, d] = problem.matrices_at(theta);
        let mut block = DMatrix::zeros(w, w);
        block.view_mut((0, 0), (n, n)).copy_from(&a);
        block.view_mut((0, n), (n, m)).copy_from(&b);
        let (mut directions, mut of, mut sensing_slopes) = (Vec::new(), Vec::new(), Vec::new());
        for parameter in 0..problem.parameters.len() {
            let (matrix, row, column) = problem.entry(parameter)?;
            let column = if matches!(matrix, Matrix::A | Matrix::C) { column } else { n + column };
            if matches!(matrix, Matrix::A | Matrix::B) {
                directions.push(Problem::unit(w, w, (row, column)) * problem.period_s);
                of.push(parameter);
            } else {
                sensing_slopes.push(Slope { parameter, row, column, value: 1.0 });
            }
        }
        let (value, derivatives) = exponential_with_derivatives(&(block * problem.period_s), &directions)?;
        let mut sensing = DMatrix::zeros(p, w);
        sensing.view_mut((0, 0), (p, n)).copy_from(&c);
        sensing.view_mut((0, n), (p, m)).copy_from(&d);
        let moving = derivatives.iter().zip(of);
        Some(Self {
            motion: value.rows(0, n).into_owned(),
            motion_slopes: moving
                .flat_map(|(d, parameter)| slopes(&d.rows(0, n).into(), parameter))
                .collect(),
            sensing,
            sensing_slopes,
            offsets: vec![0.0; p],
            start: vec![0.0; n],
            start_slopes: Vec::new(),
            drive: Drive::Recorded,
        })
    }

    /// A vehicle whose effects all act on its inputs: the matrices of a step are differenced, not simulations.
    fn behind_effects(problem: &Problem, theta: &[f64]) -> Option<Self> {
        let at = |theta: &[f64]| {
            HammersteinModel::new(&problem.vehicle_at(theta), problem.period_s).ok().flatten()
        };
        let (model, commands) = at(theta)?;
        let m = problem.m();
        let first_moved = model.states() + 2 * m;
        let (mut motion_slopes, mut sensing_slopes, mut start_slopes) = (Vec::new(), Vec::new(), Vec::new());
        let mut moved = Vec::new();
        for (parameter, place) in problem.parameters.iter().enumerate() {
            // At a bound, and at a value where the states or the whole steps of delays change, the difference is one-sided.
            let alike = |side: f64| {
                let mut moved = theta.to_vec();
                let before = std::mem::replace(&mut moved[parameter], side);
                let found = if side == before { None } else { at(&moved) };
                found.filter(|(other, _)| model.is_alike(other)).map(|found| (found, side))
            };
            let [above, below] = parameter_sides(place, theta[parameter]).map(alike);
            let centre = || ((model.clone(), commands.clone()), theta[parameter]);
            let ((above, upper), (below, lower)) = match (above, below) {
                (None, None) => return None,
                (above, below) => (above.unwrap_or_else(centre), below.unwrap_or_else(centre)),
            };
            let inverse = 1.0 / (upper - lower);
            let change = |side: fn(&HammersteinModel) -> &DMatrix<f64>| {
                slopes(&((side(&above.0) - side(&below.0)) * inverse), parameter)
            };
            motion_slopes.extend(change(|model| &model.motion));
            sensing_slopes.extend(change(|model| &model.sensing));
            let starts = above.0.resting.iter().zip(&below.0.resting).enumerate();
            start_slopes.extend(starts.filter(|(_, (a, b))| a != b).map(|(row, (a, b))| Slope {
                parameter,
                row,
                column: 0,
                value: (a - b) * inverse,
            }));
            if let Target::Effect(index, _) = place.target
                && InputPaths::depend_on(problem.vehicle.effects[index].kind())
            {
                let input = problem.vehicle.input_index(problem.vehicle.effects[index].place())?;
                let column = first_moved + 2 * moved.len();
                // The derivative of the input acts as the input does.
                let acts = |matrix: &DMatrix<f64>, slopes: &mut Vec<Slope>| {
                    let both = [(column, model.states() + input), (column + 1, model.states() + m + input)];
                    for (column, own) in both {
                        let entries = matrix.column(own).iter().copied().enumerate().collect::<Vec<_>>();
                        let acting = entries.into_iter().filter(|(_, value)| *value != 0.0);
                        slopes.extend(acting.map(|(row, value)| Slope { parameter, row, column, value }));
                    }
                };
                acts(&model.motion, &mut motion_slopes);
                acts(&model.sensing, &mut sensing_slopes);
                moved.push(Moved { input, sides: [above.1, below.1], inverse, scratch: vec![0.0; 2 * m] });
            }
        }
        let width = first_moved + 2 * moved.len();
        let HammersteinModel { motion, sensing, offsets, resting, .. } = model;
        Some(Self {
            motion: motion.resize_horizontally(width, 0.0),
            motion_slopes,
            sensing: sensing.resize_horizontally(width, 0.0),
            sensing_slopes,
            offsets,
            start: resting,
            start_slopes,
            drive: Drive::Behind(Box::new(commands), moved),
        })
    }
}

/// The entries of a derivative that are not zero.
fn slopes(derivative: &DMatrix<f64>, parameter: usize) -> Vec<Slope> {
    let all =
        (0..derivative.nrows()).flat_map(|row| (0..derivative.ncols()).map(move |column| (row, column)));
    let slope = |(row, column)| Slope { parameter, row, column, value: derivative[(row, column)] };
    all.map(slope).filter(|slope| slope.value != 0.0).collect()
}
