//! Resolves the `where` of an effect to its place in a vehicle.

use whirlstand_msgs::names::did_you_mean;

use super::Effect;
use super::place::{Matrix, Place};
use super::table::PlaceKind;
use crate::error::{EffectError, list};
use crate::model::Vehicle;

impl Effect {
    /// Finds the effect's place in `vehicle` and checks that values written with a unit fit it.
    ///
    /// # Errors
    /// When the place does not exist or is of the wrong kind (the message lists the valid ones), or when a
    /// unit does not fit.
    pub fn resolve(&self, vehicle: &Vehicle) -> Result<Place, EffectError> {
        let place = self.find_place(vehicle)?;
        self.check_units(vehicle, place)?;
        Ok(place)
    }

    /// Finds the effect's place in `vehicle`.
    pub(super) fn find_place(&self, vehicle: &Vehicle) -> Result<Place, EffectError> {
        let inputs = || vehicle.inputs.iter().map(|s| s.name.as_str());
        let outputs = || vehicle.outputs.iter().map(|s| s.name.as_str());
        let states = || vehicle.states.iter().map(|s| s.name.as_str());
        Ok(match self.kind.spec().place {
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
        })
    }

    /// Drops the stored units of values, after they have been checked.
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
                format!("must name an {what}, but '{name}' is not one{hint}; there are {known}")
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
}
