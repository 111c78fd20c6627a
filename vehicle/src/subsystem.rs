//! Decoupled subsystems: a part of a vehicle that the rest does not affect.

use nalgebra::DMatrix;

use crate::effects::{Effect, Matrix, Place};
use crate::free::{Free, Target};
use crate::model::Vehicle;

/// A part of a vehicle: indices of its states, inputs and outputs in the whole, ascending. Nothing outside affects its
/// outputs, which is for the caller to see to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Subsystem {
    /// Its states.
    pub states: Vec<usize>,
    /// Its inputs.
    pub inputs: Vec<usize>,
    /// Its outputs.
    pub outputs: Vec<usize>,
}

impl Subsystem {
    /// A place of the whole as a place of the part; `None` outside it.
    pub fn place(&self, place: Place) -> Option<Place> {
        let within = |all: &[usize], i: usize| all.iter().position(|own| *own == i);
        let (states, inputs, outputs) = (&self.states, &self.inputs, &self.outputs);
        Some(match place {
            Place::State(i) => Place::State(within(states, i)?),
            Place::Input(i) => Place::Input(within(inputs, i)?),
            Place::Output(i) => Place::Output(within(outputs, i)?),
            Place::StatePair(a, b) => Place::StatePair(within(states, a)?, within(states, b)?),
            Place::InputPair(a, b) => Place::InputPair(within(inputs, a)?, within(inputs, b)?),
            Place::OutputPair(a, b) => Place::OutputPair(within(outputs, a)?, within(outputs, b)?),
            Place::Entry(matrix, i, j) => {
                let (rows, columns) = self.of(matrix);
                Place::Entry(matrix, within(rows, i)?, within(columns, j)?)
            }
            Place::Vehicle => return None,
        })
    }

    /// An effect on the whole as an effect on the part; `None` where it acts outside.
    pub fn effect(&self, effect: &Effect, whole: &Vehicle) -> Option<Effect> {
        // Signals keep their names, entries of matrices are counted anew.
        Some(match self.place(effect.resolve(whole).ok()?)? {
            Place::Entry(matrix, i, j) => effect.at_entry(matrix, i, j),
            _ => effect.clone(),
        })
    }

    /// A free parameter of the whole as one of the part; `None` where it lies outside.
    pub fn free(&self, free: &Free, whole: &Vehicle) -> Option<Free> {
        let target = match free.target {
            Target::Entry(matrix, i, j) => match self.place(Place::Entry(matrix, i, j))? {
                Place::Entry(matrix, i, j) => Target::Entry(matrix, i, j),
                _ => return None,
            },
            Target::Effect(index, parameter) => {
                self.effect(whole.effects.get(index)?, whole)?;
                let before = whole.effects[..index].iter().filter(|e| self.effect(e, whole).is_some());
                Target::Effect(before.count(), parameter)
            }
        };
        Some(Free { target, ..free.clone() })
    }

    /// The part as a vehicle of its own, with the effects on it. States end where they do in the whole.
    pub fn vehicle(&self, whole: &Vehicle) -> Vehicle {
        let bounds = whole.state_bounds(&[]);
        let state = |i: &usize| crate::State { bound: Some(bounds[*i]), ..whole.states[*i].clone() };
        let matrix = |matrix: Matrix, all: &DMatrix<f64>| {
            let (rows, columns) = self.of(matrix);
            all.select_rows(rows).select_columns(columns)
        };
        Vehicle {
            states: self.states.iter().map(state).collect(),
            inputs: self.inputs.iter().map(|i| whole.inputs[*i].clone()).collect(),
            outputs: self.outputs.iter().map(|i| whole.outputs[*i].clone()).collect(),
            a: matrix(Matrix::A, &whole.a),
            b: matrix(Matrix::B, &whole.b),
            c: matrix(Matrix::C, &whole.c),
            d: matrix(Matrix::D, &whole.d),
            effects: whole.effects.iter().filter_map(|e| self.effect(e, whole)).collect(),
            free: whole.free.iter().filter_map(|free| self.free(free, whole)).collect(),
            source_text: String::new(),
            name: whole.name.clone(),
            description: whole.description.clone(),
            fit: whole.fit.clone(),
            map: whole.map.clone(),
            provenance: whole.provenance.clone(),
            folder: whole.folder.clone(),
        }
    }

    /// Rows and columns of a matrix that belong to the part.
    fn of(&self, matrix: Matrix) -> (&[usize], &[usize]) {
        match matrix {
            Matrix::A => (&self.states, &self.states),
            Matrix::B => (&self.states, &self.inputs),
            Matrix::C => (&self.outputs, &self.states),
            Matrix::D => (&self.outputs, &self.inputs),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Kind, Simulator};

    /// Two axes in mixed order, with effects on each.
    fn two_axes() -> Vehicle {
        let text = r#"
            A = [[-2.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -4.0, -1.0]]
            B = [[0.0, 5.0], [0.0, 0.0], [3.0, 0.0]]
            C = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
            states = [{ name = "r" }, { name = "phi" }, { name = "p" }]
            inputs = [{ name = "u_roll" }, { name = "u_yaw" }]
            outputs = [{ name = "roll" }, { name = "yaw_rate" }, { name = "roll_rate" }]
            free = [
                { entry = "A[3,3]", lower = -9.0, upper = 0.0 },
                { effect = "actuator_lag", where = "u_yaw", parameter = "time_constant_s", lower = 0.01, upper = 1.0 },
            ]
            [[effects]]
            effect = "actuator_lag"
            where = "u_roll"
            time_constant_s = 0.05
            [[effects]]
            effect = "actuator_lag"
            where = "u_yaw"
            time_constant_s = 0.1
            [[effects]]
            effect = "parameter_change"
            where = "A[3,3]"
            value = -1.5
        "#;
        Vehicle::parse(text, "axes.toml").unwrap()
    }

    #[test]
    fn a_part_moves_as_it_does_in_the_whole() {
        let whole = two_axes();
        for part in [
            Subsystem { states: vec![1, 2], inputs: vec![0], outputs: vec![0, 2] },
            Subsystem { states: vec![0], inputs: vec![1], outputs: vec![1] },
        ] {
            let mut together = Simulator::expected(&whole, 0.01).unwrap();
            let mut alone = Simulator::expected(&part.vehicle(&whole), 0.01).unwrap();
            for k in 0..300 {
                let u = [(0.05 * f64::from(k)).sin(), (0.03 * f64::from(k)).cos()];
                together.apply(&u);
                alone.apply(&part.inputs.iter().map(|j| u[*j]).collect::<Vec<_>>());
                let seen = together.measure();
                let of_part: Vec<f64> = part.outputs.iter().map(|i| seen[*i]).collect();
                for (a, b) in alone.measure().iter().zip(&of_part) {
                    assert!((a - b).abs() < 1e-12, "step {k}: {a} and {b}");
                }
                together.advance();
                alone.advance();
            }
        }
    }

    #[test]
    fn places_are_counted_within_the_part() {
        let whole = two_axes();
        let roll = Subsystem { states: vec![1, 2], inputs: vec![0], outputs: vec![0, 2] };
        let yaw = Subsystem { states: vec![0], inputs: vec![1], outputs: vec![1] };
        let change = Effect::new(Kind::ParameterChange, "A[3,3]", &[("value", -0.5)]).unwrap();
        assert_eq!(roll.effect(&change, &whole).unwrap().place(), "A[2,2]");
        assert_eq!(yaw.effect(&change, &whole), None);
        assert_eq!(roll.free(&whole.free[0], &whole).unwrap().target, Target::Entry(Matrix::A, 1, 1));
        assert_eq!(yaw.free(&whole.free[1], &whole).unwrap().target, Target::Effect(0, "time_constant_s"));
        assert_eq!((roll.free(&whole.free[1], &whole), yaw.free(&whole.free[0], &whole)), (None, None));
        let across = Effect::new(Kind::InputCoupling, "u_roll->u_yaw", &[("coefficient", 0.1)]).unwrap();
        assert!(across.resolve(&whole).is_ok());
        assert_eq!((roll.effect(&across, &whole), yaw.effect(&across, &whole)), (None, None));
    }
}
