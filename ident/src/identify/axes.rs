//! Axes that know nothing of each other: groups of states and outputs between which the vehicle file has no entry.
//!
//! With noises that are independent, the likelihood of a record is the product of those of its axes, each with its own
//! parameters and noises: what is likeliest for all is what is likeliest for each. One axis at a time is a smaller search,
//! from a start of its own, that cannot end beside the maximum because another axis is still far from it.

use nalgebra::DMatrix;
use whirlstand_vehicle::{Free, Matrix, Place, Target};

use super::data::Segment;
use super::predictor::{Force, NoiseStructure};
use super::problem::Problem;

/// A group of states and outputs, by their indices in the whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    states: Vec<usize>,
    outputs: Vec<usize>,
    /// Indices of the free parameters that act on it.
    pub parameters: Vec<usize>,
}

/// An axis as a problem of its own.
#[derive(Debug)]
pub struct Part {
    /// The vehicle of the axis' states and outputs, with all inputs.
    pub problem: Problem,
    /// Its noises.
    pub structure: NoiseStructure,
    /// Its columns of the data.
    pub segments: Vec<Segment>,
    /// Indices of its noises among those of the whole: of the states, then of the outputs.
    pub noises: Vec<usize>,
}

/// Groups that are joined pair by pair.
struct Groups(Vec<usize>);

impl Groups {
    fn join(&mut self, a: usize, b: usize) {
        let (kept, gone) = (self.0[a], self.0[b]);
        for group in &mut self.0 {
            if *group == gone {
                *group = kept;
            }
        }
    }
}

impl Axis {
    /// The axes of a problem that have an output which is fitted and a free parameter. One alone stands for a vehicle that
    /// is not made of such axes.
    ///
    /// Axes may share an input, which is known, unless a free parameter changes what becomes of it.
    pub fn of(problem: &Problem) -> Vec<Self> {
        let (n, p, m) = (problem.n(), problem.p(), problem.m());
        let (output, input) = (|i: usize| n + i, |j: usize| n + p + j);
        let place = |effect: usize| problem.vehicle.effects[effect].resolve(&problem.vehicle).ok();
        let entry = |(matrix, i, j): (Matrix, usize, usize)| match matrix {
            Matrix::A => (i, j),
            Matrix::B => (i, input(j)),
            Matrix::C => (output(i), j),
            Matrix::D => (output(i), input(j)),
        };
        let ends = |place: Place| match place {
            Place::Input(j) => Some((input(j), input(j))),
            Place::InputPair(a, b) => Some((input(a), input(b))),
            Place::Output(i) => Some((output(i), output(i))),
            Place::OutputPair(a, b) => Some((output(a), output(b))),
            Place::State(i) => Some((i, i)),
            Place::StatePair(a, b) => Some((a, b)),
            // Its name counts the rows of the whole.
            Place::Entry(..) | Place::Vehicle => None,
        };
        let of_target = |target: &Target| match *target {
            Target::Entry(matrix, i, j) => Some(entry((matrix, i, j))),
            Target::Effect(effect, _) => place(effect).and_then(ends),
        };
        let whole = || {
            vec![Self {
                states: (0..n).collect(),
                outputs: (0..p).collect(),
                parameters: (0..problem.parameters.len()).collect(),
            }]
        };
        let acting: Option<Vec<_>> =
            (0..problem.vehicle.effects.len()).map(|effect| place(effect).and_then(ends)).collect();
        let targets: Option<Vec<_>> = problem.parameters.iter().map(|f| of_target(&f.target)).collect();
        let (Some(acting), Some(targets)) = (acting, targets) else { return whole() };

        // An input joins what it drives only where an effect of free parameters is on it.
        let effects = problem.parameters.iter().filter_map(|f| match f.target {
            Target::Effect(effect, _) => Some(acting[effect]),
            Target::Entry(..) => None,
        });
        let uncertain: Vec<usize> = effects.flat_map(|(a, b)| [a, b]).filter(|k| *k >= n + p).collect();
        let mut groups = Groups((0..n + p + m).collect());
        let vehicle = &problem.vehicle;
        let mut join = |(a, b): (usize, usize)| {
            if [a, b].iter().all(|k| *k < n + p || uncertain.contains(k)) {
                groups.join(a, b);
            }
        };
        let matrices = [
            (Matrix::A, &vehicle.a),
            (Matrix::B, &vehicle.b),
            (Matrix::C, &vehicle.c),
            (Matrix::D, &vehicle.d),
        ];
        for (matrix, values) in matrices {
            for i in 0..values.nrows() {
                for j in (0..values.ncols()).filter(|j| values[(i, *j)] != 0.0) {
                    join(entry((matrix, i, j)));
                }
            }
        }
        acting.iter().chain(&targets).for_each(|ends| join(*ends));

        let group = groups.0;
        // The end that is not an input belongs to the axis; where both are, the input was joined to it.
        let owner = |(a, b): (usize, usize)| group[a.min(b)];
        let mut axes: Vec<(usize, Self)> = Vec::new();
        for i in (0..p).filter(|i| problem.weights[*i] > 0.0) {
            let own = group[output(i)];
            if axes.iter().all(|(of, _)| *of != own) {
                let axis = Self {
                    states: (0..n).filter(|k| group[*k] == own).collect(),
                    outputs: (0..p).filter(|k| group[output(*k)] == own).collect(),
                    parameters: (0..targets.len()).filter(|k| owner(targets[*k]) == own).collect(),
                };
                axes.push((own, axis));
            }
        }
        let axes: Vec<Self> = axes.into_iter().map(|(_, axis)| axis).collect();
        let parameters = axes.iter().map(|axis| axis.parameters.len()).sum::<usize>();
        // A parameter without a fitted output is found undetermined by a fit of the whole.
        if parameters != problem.parameters.len() || axes.iter().any(|axis| axis.parameters.is_empty()) {
            return whole();
        }
        axes
    }

    /// The axis alone.
    pub fn part(&self, problem: &Problem, structure: &NoiseStructure, segments: &[Segment]) -> Part {
        let whole = &problem.vehicle;
        let (state, output) = (|i: usize| index(&self.states, i), |i: usize| index(&self.outputs, i));
        let select = |values: &DMatrix<f64>, rows: &[usize]| values.select_rows(rows);
        let mut vehicle = whole.clone();
        vehicle.states = self.states.iter().map(|i| whole.states[*i].clone()).collect();
        vehicle.outputs = self.outputs.iter().map(|i| whole.outputs[*i].clone()).collect();
        vehicle.a = select(&whole.a, &self.states).select_columns(&self.states);
        vehicle.b = select(&whole.b, &self.states);
        vehicle.c = select(&whole.c, &self.outputs).select_columns(&self.states);
        vehicle.d = select(&whole.d, &self.outputs);
        let kept: Vec<usize> = (0..whole.effects.len())
            .filter(|effect| match whole.effects[*effect].resolve(whole) {
                Ok(Place::Output(i) | Place::OutputPair(i, _)) => output(i).is_some(),
                Ok(Place::State(i) | Place::StatePair(i, _)) => state(i).is_some(),
                _ => true,
            })
            .collect();
        vehicle.effects = kept.iter().map(|effect| whole.effects[*effect].clone()).collect();
        let target = |target: &Target| {
            Some(match *target {
                Target::Entry(Matrix::A, i, j) => Target::Entry(Matrix::A, state(i)?, state(j)?),
                Target::Entry(Matrix::B, i, j) => Target::Entry(Matrix::B, state(i)?, j),
                Target::Entry(Matrix::C, i, j) => Target::Entry(Matrix::C, output(i)?, state(j)?),
                Target::Entry(Matrix::D, i, j) => Target::Entry(Matrix::D, output(i)?, j),
                Target::Effect(effect, name) => Target::Effect(index(&kept, effect)?, name),
            })
        };
        let free = whole.free.iter().filter_map(|f| Some(Free { target: target(&f.target)?, ..f.clone() }));
        vehicle.free = free.collect();
        let parameters = self.parameters.iter().filter_map(|k| {
            let parameter = &problem.parameters[*k];
            Some(super::problem::Parameter { target: target(&parameter.target)?, ..parameter.clone() })
        });
        let part = Problem {
            parameters: parameters.collect(),
            weights: self.outputs.iter().map(|i| problem.weights[*i]).collect(),
            vehicle,
            ..problem.clone()
        };
        let (structure, noises) = self.noises(problem.n(), structure);
        let p = problem.p();
        let columns = |segment: &Segment| {
            let rows = segment.outputs.chunks_exact(p);
            let outputs = rows.flat_map(|row| self.outputs.iter().map(|i| row[*i])).collect();
            Segment { outputs, ..segment.clone() }
        };
        Part { problem: part, structure, segments: segments.iter().map(columns).collect(), noises }
    }

    /// The axis' part of the noises, and their indices among all.
    fn noises(&self, n: usize, whole: &NoiseStructure) -> (NoiseStructure, Vec<usize>) {
        let (state, output) = (|i: usize| index(&self.states, i), |i: usize| index(&self.outputs, i));
        let kept: Vec<usize> =
            (0..whole.forces.len()).filter(|k| state(whole.forces[*k].on).is_some()).collect();
        let forces = kept.iter().filter_map(|k| {
            let force = whole.forces[*k];
            Some(Force { on: state(force.on)?, output: output(force.output)? })
        });
        let forces: Vec<Force> = forces.collect();
        let own = |j: usize| match j.checked_sub(n) {
            Some(force) => Some(self.states.len() + index(&kept, force)?),
            None => state(j),
        };
        let driven = whole.states.iter().enumerate().filter_map(|(k, j)| Some((k, own(*j)?)));
        let (mut noises, states): (Vec<usize>, Vec<usize>) = driven.unzip();
        let after = whole.states.len();
        let measured = whole.outputs.iter().enumerate().filter_map(|(k, i)| Some((after + k, output(*i)?)));
        let (of_outputs, outputs): (Vec<usize>, Vec<usize>) = measured.unzip();
        noises.extend(of_outputs);
        (NoiseStructure { states, outputs, forces }, noises)
    }
}

fn index(all: &[usize], one: usize) -> Option<usize> {
    all.iter().position(|k| *k == one)
}

#[cfg(test)]
mod tests {
    use whirlstand_vehicle::Vehicle;

    use super::super::Nuisance;
    use super::*;

    /// Two rate axes, each with an attitude, and one input on both; `more` is added to the file.
    fn problem(free: &str, more: &str) -> Problem {
        let text = format!(
            r#"
            A = [[0.0, 1.0, 0.0, 0.0], [0.0, -2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, -3.0]]
            B = [[0.0], [5.0], [0.0], [7.0]]
            C = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
            states = [{{ name = "roll" }}, {{ name = "roll_rate" }}, {{ name = "pitch" }}, {{ name = "pitch_rate" }}]
            inputs = [{{ name = "u" }}]
            outputs = [{{ name = "roll" }}, {{ name = "pitch" }}, {{ name = "pitch_rate" }}]
            free = [
                {{ entry = "A[4,4]", lower = -20.0, upper = 0.0 }},
                {{ entry = "B[2,1]", lower = 0.0, upper = 20.0 }},
                {free}
            ]
            {more}
            "#
        );
        let vehicle = Vehicle::parse(&text, "axes.toml").unwrap();
        let segment = Segment {
            origin: "axes".into(),
            start_s: 0.0,
            first_step: 0,
            period_s: 0.01,
            inputs: vec![0.0; 2],
            outputs: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
            steps: 2,
        };
        Problem::new(&vehicle, &[segment], Nuisance::default()).unwrap()
    }

    #[test]
    fn a_vehicle_is_parted_where_nothing_couples_its_states() {
        let two = problem("", "");
        let axes = Axis::of(&two);
        let roll = Axis { states: vec![0, 1], outputs: vec![0], parameters: vec![1] };
        let pitch = Axis { states: vec![2, 3], outputs: vec![1, 2], parameters: vec![0] };
        assert_eq!(axes, [roll, pitch]);

        let coupled = problem(r#"{ entry = "A[2,4]", lower = -1.0, upper = 1.0 }"#, "");
        assert_eq!(Axis::of(&coupled).len(), 1);
    }

    #[test]
    fn an_input_couples_what_it_drives_while_its_lag_is_unknown() {
        let lag = "[[effects]]\neffect = 'actuator_lag'\nwhere = 'u'\ntime_constant_s = 0.05";
        assert_eq!(Axis::of(&problem("", lag)).len(), 2);
        let free = "{ effect = 'actuator_lag', where = 'u', parameter = 'time_constant_s', lower = 0.0, upper = 1.0 }";
        assert_eq!(Axis::of(&problem(free, lag)).len(), 1);
    }

    #[test]
    fn a_part_has_the_rows_and_noises_of_its_axis() {
        let whole = problem("", "");
        let forces = vec![Force { on: 1, output: 0 }, Force { on: 3, output: 2 }];
        let structure = NoiseStructure::with_forces(&whole, forces);
        // Of states 1 and 3 and two forces; of outputs 0, 1 and 2.
        assert_eq!(structure.states, [1, 3, 4, 5]);
        let segment = Segment {
            origin: "axes".into(),
            start_s: 0.0,
            first_step: 0,
            period_s: 0.01,
            inputs: vec![0.0; 2],
            outputs: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
            steps: 2,
        };
        let part = Axis::of(&whole)[1].part(&whole, &structure, &[segment]);
        assert_eq!(part.problem.vehicle.a, nalgebra::dmatrix![0.0, 1.0; 0.0, -3.0]);
        assert_eq!(part.problem.vehicle.b, nalgebra::dmatrix![0.0; 7.0]);
        assert_eq!(part.problem.vehicle.c, nalgebra::dmatrix![1.0, 0.0; 0.0, 1.0]);
        assert_eq!(part.problem.parameters.len(), 1);
        assert_eq!(part.problem.parameters[0].target, Target::Entry(Matrix::A, 1, 1));
        assert_eq!(part.segments[0].outputs, [2.0, 3.0, 5.0, 6.0]);
        assert_eq!(part.structure.states, [1, 2]);
        assert_eq!(part.structure.outputs, [0, 1]);
        assert_eq!(part.structure.forces, [Force { on: 1, output: 1 }]);
        assert_eq!(part.noises, [1, 3, 5, 6]);
    }
}
