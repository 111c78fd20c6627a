//! Structural dependence: which channels a parameter can affect, and which parameters can be perturbed in one
//! run.
//!
//! Axes of a vehicle that are decoupled have sensitivities without common rows. Those of several such
//! parameters come from one run in which all of them are perturbed (Curtis, Powell and Reid, J. Inst. Maths
//! Applics 13, 1974).

use whirlstand_vehicle::{Effect, Matrix, Place, Subsystem, Target, Vehicle};

use crate::data::record::Data;

/// A set of signals or channels as one bit each: a vehicle has at most 32 states, inputs and outputs each.
pub type Set = u128;

/// Reachability between signals, in the order states, inputs, outputs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reach {
    /// The signals that each signal affects, itself included.
    moves: Vec<Set>,
    states: usize,
    inputs: usize,
    /// The signal index of each channel.
    channels: Vec<usize>,
}

impl Reach {
    /// Reachability of a vehicle with all its effects, where the `open` targets may become non-zero.
    pub fn new<'t>(vehicle: &Vehicle, data: &Data, open: impl Iterator<Item = &'t Target>) -> Self {
        let (n, m, p) = (vehicle.states.len(), vehicle.inputs.len(), vehicle.outputs.len());
        let channels = data.channels.iter().map(|c| n + m + c.output).collect();
        let moves = (0..n + m + p).map(|signal| 1 << signal).collect();
        let mut reach = Self { moves, states: n, inputs: m, channels };
        for matrix in [Matrix::A, Matrix::B, Matrix::C, Matrix::D] {
            let entries = match matrix {
                Matrix::A => &vehicle.a,
                Matrix::B => &vehicle.b,
                Matrix::C => &vehicle.c,
                Matrix::D => &vehicle.d,
            };
            for (i, j) in (0..entries.nrows()).flat_map(|i| (0..entries.ncols()).map(move |j| (i, j))) {
                if entries[(i, j)] != 0.0 {
                    reach.link(Place::Entry(matrix, i, j), vehicle);
                }
            }
        }
        vehicle.effects.iter().for_each(|effect| reach.link(place(effect, vehicle), vehicle));
        for target in open {
            reach.link(place_of(target, vehicle), vehicle);
        }
        if data.memory_s.is_some() {
            reach.correct();
        }
        reach.close();
        reach
    }

    /// Signals on which a place depends, and those that it affects.
    fn ends(&self, place: Place, vehicle: &Vehicle) -> (Set, Set) {
        let (input, output) = (self.states, self.states + self.inputs);
        let one = |signal: usize| -> Set { 1 << signal };
        match place {
            Place::State(i) => (one(i), one(i)),
            Place::Input(i) => (one(input + i), one(input + i)),
            Place::Output(i) => (one(output + i), one(output + i)),
            Place::StatePair(a, b) => (one(a), one(b)),
            Place::InputPair(a, b) => (one(input + a), one(input + b)),
            Place::OutputPair(a, b) => {
                let turned = vehicle.turned_outputs(a, b).into_iter().flatten();
                let mixed = turned.fold(0, |all, (a, b)| all | one(output + a) | one(output + b));
                (mixed, mixed)
            }
            Place::Entry(Matrix::A, i, j) => (one(j), one(i)),
            Place::Entry(Matrix::B, i, j) => (one(input + j), one(i)),
            Place::Entry(Matrix::C, i, j) => (one(j), one(output + i)),
            Place::Entry(Matrix::D, i, j) => (one(input + j), one(output + i)),
            Place::Vehicle => (Set::MAX, Set::MAX),
        }
    }

    fn link(&mut self, place: Place, vehicle: &Vehicle) {
        let (from, onto) = self.ends(place, vehicle);
        let signals = self.moves.len();
        (0..signals).filter(|s| from >> s & 1 == 1).for_each(|s| self.moves[s] |= onto);
    }

    /// A filter corrects states by every output that a coupled state affects.
    fn correct(&mut self) {
        self.close();
        let shown = self.states + self.inputs;
        let mut together: Vec<Set> = (0..self.states).map(|i| self.moves[i]).collect();
        for _ in 0..self.states {
            let before = together.clone();
            for own in &mut together {
                *own = before.iter().filter(|other| *own & **other != 0).fold(*own, |all, other| all | other);
            }
        }
        let states = (1 << self.states) - 1;
        for own in together {
            (shown..self.moves.len())
                .filter(|s| own >> s & 1 == 1)
                .for_each(|s| self.moves[s] |= own & states);
        }
    }

    /// Transitive closure of the reachability.
    fn close(&mut self) {
        for via in 0..self.moves.len() {
            let onto = self.moves[via];
            self.moves.iter_mut().filter(|own| **own >> via & 1 == 1).for_each(|own| *own |= onto);
        }
    }

    /// The channels that a set of signals affects.
    fn channels(&self, signals: Set) -> Set {
        let reached =
            (0..self.moves.len()).filter(|s| signals >> s & 1 == 1).fold(0, |all, s| all | self.moves[s]);
        let bit = |(c, signal): (usize, &usize)| if reached >> signal & 1 == 1 { 1 << c } else { 0 };
        self.channels.iter().enumerate().map(bit).fold(0, |all, c| all | c)
    }

    /// The decoupled part of the vehicle around some channels: all signals that affect them, or channels that these
    /// affect too. `None` where that is the whole.
    pub fn part_around(&self, channels: Set) -> Option<Subsystem> {
        let reached: Vec<Set> = (0..self.moves.len()).map(|signal| self.channels(1 << signal)).collect();
        let mut part = channels;
        // Each turn adds a channel, or is the last.
        for _ in 0..self.channels.len() {
            part = reached.iter().filter(|own| **own & part != 0).fold(part, |all, own| all | own);
        }
        let whole = reached.iter().fold(0, |all, own| all | own);
        let outputs = self.states + self.inputs;
        let within = |from: usize, to: usize| -> Vec<usize> {
            (from..to).filter(|signal| reached[*signal] & part != 0).map(|signal| signal - from).collect()
        };
        (part != whole).then(|| Subsystem {
            states: within(0, self.states),
            inputs: within(self.states, outputs),
            outputs: within(outputs, self.moves.len()),
        })
    }

    /// True where the vehicle has no decoupled parts.
    pub fn is_coupled(&self) -> bool {
        (0..self.channels.len()).all(|c| self.part_around(1 << c).is_none())
    }

    /// The channels that a state affects.
    pub fn of_state(&self, state: usize) -> Set {
        self.channels(1 << state)
    }

    /// The channels that an entry of the vehicle affects.
    pub fn of_target(&self, target: &Target, vehicle: &Vehicle) -> Set {
        self.channels(self.ends(place_of(target, vehicle), vehicle).1)
    }

    /// The channels that an effect affects.
    pub fn of_effect(&self, effect: &Effect, vehicle: &Vehicle) -> Set {
        self.channels(self.ends(place(effect, vehicle), vehicle).1)
    }
}

fn place(effect: &Effect, vehicle: &Vehicle) -> Place {
    effect.resolve(vehicle).unwrap_or(Place::Vehicle)
}

fn place_of(target: &Target, vehicle: &Vehicle) -> Place {
    match target {
        Target::Entry(matrix, i, j) => Place::Entry(*matrix, *i, *j),
        Target::Effect(index, _) => place(&vehicle.effects[*index], vehicle),
    }
}

/// Groups of parameters of which no two affect the same channel.
pub fn groups(reached: &[Set]) -> Vec<Vec<usize>> {
    let mut groups: Vec<(Set, Vec<usize>)> = Vec::new();
    for (value, own) in reached.iter().enumerate() {
        match groups.iter_mut().find(|(taken, _)| taken & own == 0) {
            Some((taken, members)) => {
                *taken |= own;
                members.push(value);
            }
            None => groups.push((*own, vec![value])),
        }
    }
    groups.into_iter().map(|(_, members)| members).collect()
}
