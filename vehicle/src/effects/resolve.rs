//! From the `where` of an effect to its place in a vehicle.

use whirlstand_msgs::names::did_you_mean;
use whirlstand_msgs::units::{Dimension, Unit};

use super::Effect;
use super::place::{Matrix, Place};
use super::table::{PlaceKind, Scale};
use crate::error::{EffectError, list};
use crate::model::Vehicle;

impl Effect {
    /// Finds the effect's place in `vehicle` and checks that values written with a unit fit it.
    ///
    /// # Errors
    /// When the place does not exist or is of the wrong kind (the message says which are valid), or when a
    /// unit does not fit.
    pub fn resolve(&self, vehicle: &Vehicle) -> Result<Place, EffectError> {
        let inputs = || vehicle.inputs.iter().map(|s| s.name.as_str());
        let outputs = || vehicle.outputs.iter().map(|s| s.name.as_str());
        let states = || vehicle.states.iter().map(|s| s.name.as_str());
        let place = match self.kind.spec().place {
            PlaceKind::Input => Place::Input(self.find("input", &self.place, inputs)?),
            PlaceKind::Output => Place::Output(self.find("output", &self.place, outputs)?),
            PlaceKind::State => Place::State(self.find("state", &self.place, states)?),
            PlaceKind::InputPair => {
                let (from, onto) = self.pair("->", "input", inputs)?;
                Place::InputPair(from, onto)
            }
            PlaceKind::StatePair => {
                let (from, onto) = self.pair("->", "state", states)?;
                Place::StatePair(from, onto)
            }
            PlaceKind::OutputPair => {
                let (first, second) = self.pair(",", "output", outputs)?;
                Place::OutputPair(first, second)
            }
            PlaceKind::Entry => self.entry(vehicle)?,
            PlaceKind::Vehicle if self.place == "vehicle" => Place::Vehicle,
            PlaceKind::Vehicle => {
                return Err(self.error(Some("where"), "must be \"vehicle\"".into()));
            }
        };
        self.check_units(vehicle, place)?;
        Ok(place)
    }

    /// Forgets in which units values were written, once they are known to fit.
    pub(crate) fn confirmed(mut self) -> Self {
        self.written.clear();
        self
    }

    fn find<'a, I: Iterator<Item = &'a str>>(
        &self,
        what: &str,
        name: &str,
        names: impl Fn() -> I,
    ) -> Result<usize, EffectError> {
        names().position(|n| n == name).ok_or_else(|| {
            let hint = did_you_mean(name, names());
            let known = list(names());
            self.error(
                Some("where"),
                format!("must name an {what}, but '{name}' is none{hint}; there are {known}")
                    .replace("an state", "a state"),
            )
        })
    }

    fn pair<'a, I: Iterator<Item = &'a str>>(
        &self,
        separator: &str,
        what: &str,
        names: impl Fn() -> I,
    ) -> Result<(usize, usize), EffectError> {
        let Some((first, second)) = self.place.split_once(separator) else {
            let example = names().take(2).collect::<Vec<_>>().join(separator);
            return Err(self.error(Some("where"), format!("must name two {what}s, as in \"{example}\"")));
        };
        let (first, second) = (first.trim(), second.trim());
        let pair = (self.find(what, first, &names)?, self.find(what, second, &names)?);
        if pair.0 == pair.1 && what != "state" {
            return Err(self.error(Some("where"), format!("must name two different {what}s")));
        }
        Ok(pair)
    }

    fn entry(&self, vehicle: &Vehicle) -> Result<Place, EffectError> {
        let syntax =
            || self.error(Some("where"), "must be a matrix entry, one-based, as in \"A[2,1]\"".into());
        let (matrix, rest) = self.place.split_once('[').ok_or_else(syntax)?;
        let indices = rest.trim_end().strip_suffix(']').ok_or_else(syntax)?;
        let (row, column) = indices.split_once(',').ok_or_else(syntax)?;
        let index = |text: &str| text.trim().parse::<usize>().map_err(|_| syntax());
        let (row, column) = (index(row)?, index(column)?);
        let (matrix, size) = match matrix.trim() {
            "A" => (Matrix::A, vehicle.a.shape()),
            "B" => (Matrix::B, vehicle.b.shape()),
            "C" => (Matrix::C, vehicle.c.shape()),
            "D" => (Matrix::D, vehicle.d.shape()),
            _ => return Err(syntax()),
        };
        if row == 0 || column == 0 || row > size.0 || column > size.1 {
            let reason = format!("lies outside {matrix:?}, which has {} rows and {} columns", size.0, size.1);
            return Err(self.error(Some("where"), reason));
        }
        Ok(Place::Entry(matrix, row - 1, column - 1))
    }

    fn check_units(&self, vehicle: &Vehicle, place: Place) -> Result<(), EffectError> {
        let none = Unit::ONE.dimension();
        let time = Unit::SECOND.dimension();
        let input = |i: usize| vehicle.inputs[i].unit.dimension();
        let output = |i: usize| vehicle.outputs[i].unit.dimension();
        let state = |i: usize| vehicle.states[i].unit.dimension();
        let (first, second) = match place {
            Place::Input(i) => (input(i), none),
            Place::InputPair(i, j) => (input(i), input(j)),
            Place::Output(i) => (output(i), none),
            Place::OutputPair(i, j) => (output(i), output(j)),
            Place::State(i) => (state(i), none),
            Place::StatePair(i, j) => (state(i), state(j)),
            Place::Entry(Matrix::A, i, j) => (state(j), over(state(i), time, 1)),
            Place::Entry(Matrix::B, i, j) => (input(j), over(state(i), time, 1)),
            Place::Entry(Matrix::C, i, j) => (state(j), output(i)),
            Place::Entry(Matrix::D, i, j) => (input(j), output(i)),
            Place::Vehicle => (none, none),
        };
        for &(index, found) in &self.written {
            let parameter = &self.kind.spec().parameters[index];
            let expected = match parameter.scale {
                Scale::One => none,
                Scale::Time => time,
                Scale::Frequency => over(none, time, 1),
                Scale::Angle => continue,
                Scale::Signal => first,
                Scale::SignalRate => over(first, time, 1),
                Scale::Drag => over(over(none, time, 1), first, 1),
                Scale::Cubic => over(over(second, time, 1), first, 3),
                Scale::Entry | Scale::Coupling => over(second, first, 1),
            };
            if found != expected {
                let name =
                    |d: Dimension| if d.is_none() { "a pure number".into() } else { format!("in {d}") };
                let reason = format!("must be {}, but is {}", name(expected), name(found));
                return Err(self.error(Some(parameter.name), reason));
            }
        }
        Ok(())
    }
}

/// `a` divided by `b` to a power. Exponents of real units stay far inside i8; a unit beyond that cannot match.
fn over(a: Dimension, b: Dimension, power: i8) -> Dimension {
    a.times(b, -power).unwrap_or(a)
}
