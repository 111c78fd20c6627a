//! What the parameters of an effect are measured in, at its place in a vehicle.

use whirlstand_msgs::units::{Dimension, Quantity, ShownUnit, Unit, clean, two_readings};

use super::Effect;
use super::kind::Kind;
use super::place::{Matrix, Place};
use super::table::{Parameter, Scale};
use crate::error::EffectError;
use crate::model::Vehicle;
use crate::signal_unit::SignalUnit;

/// What a parameter of an effect is measured in.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterUnit {
    kind: UnitKind,
    /// As the vehicle file's own units have it.
    unit: Unit,
    /// The text of `unit`, where it can be written.
    symbol: Option<String>,
    /// The text of `unit` for a reader, with `per`.
    apart: String,
}

#[derive(Debug, Clone, PartialEq)]
enum UnitKind {
    /// The parameter's name says it (`delay_s`), or it is a pure number.
    Named,
    /// That of a signal, or of its derivative.
    Signal(SignalUnit),
    /// That of a matrix entry: SI in an effect, the declared units in the matrix itself.
    Entry,
    /// A coefficient of powers of signals, in SI.
    Composite,
}

impl ParameterUnit {
    /// Symbol of the SI unit; empty for a pure number.
    pub fn si_symbol(&self) -> String {
        match self.kind {
            UnitKind::Named => self.symbol.clone().unwrap_or_default(),
            _ => self.unit.si_symbol(),
        }
    }

    /// How values in SI are shown to a reader: in the unit of the vehicle file for signals and entries that have one, in SI for
    /// coefficients.
    pub fn in_words(&self) -> ShownUnit {
        match (&self.kind, &self.symbol) {
            (UnitKind::Signal(signal), _) => signal.shown(),
            // 1/s^2, not rad/s^2/rad.
            (UnitKind::Entry, Some(symbol))
                if !(self.unit.is_si() && self.si_symbol().len() <= symbol.len()) =>
            {
                ShownUnit::declared(&self.unit, symbol)
            }
            _ => ShownUnit::si(&self.si_symbol()),
        }
    }

    /// A value in SI for a reader, with its unit: that of the vehicle file for signals, of SI for coefficients.
    pub fn shown(&self, si: f64) -> String {
        let (value, symbol) = match &self.kind {
            UnitKind::Signal(signal) if signal.is_one() => (si, String::new()),
            UnitKind::Signal(signal) => (self.unit.from_si(si), signal.to_string()),
            _ => (si, self.si_symbol()),
        };
        format!("{} {symbol}", clean(value)).trim_end().to_string()
    }

    /// Symbol of the unit that the vehicle file itself has for it, with `per` where none can be written in one, or only in more
    /// base units than that takes: `A/s per V`, not `s^2*A^2/kg/m^2`.
    pub(crate) fn shown_symbol(&self) -> String {
        let si = self.unit.si_symbol();
        match &self.symbol {
            _ if self.unit.is_si() && (self.apart.is_empty() || si.len() <= self.apart.len()) => si,
            _ if self.unit.is_si() => self.apart.clone(),
            Some(symbol) => symbol.clone(),
            None => self.apart.clone(),
        }
    }

    /// The unit itself, as the vehicle file's own units have it.
    pub(crate) fn unit(&self) -> &Unit {
        &self.unit
    }

    /// Why a number without a unit cannot be taken, with both of its readings; `None` where it can.
    pub(crate) fn two_readings(&self, value: f64) -> Option<String> {
        match &self.kind {
            UnitKind::Named | UnitKind::Composite => None,
            UnitKind::Signal(signal) => signal.two_readings(value),
            UnitKind::Entry => two_readings(value, &self.unit, self.symbol.as_deref()),
        }
    }

    /// A value in SI as a vehicle file has it: it reads back as the same number, and its unit stands beside it unless
    /// the parameter's name says it, or it has none.
    pub(crate) fn written(&self, si: f64) -> String {
        let bare = match &self.kind {
            UnitKind::Named => true,
            UnitKind::Signal(signal) => signal.is_one(),
            UnitKind::Entry | UnitKind::Composite => self.unit == Unit::ONE,
        };
        if bare {
            return format!("{si:?}");
        }
        if let (UnitKind::Signal(_), Some(symbol)) = (&self.kind, &self.symbol) {
            let number = crate::file::text::number(si, self.unit.factor());
            let text = format!("{} {symbol}", number.strip_suffix(".0").unwrap_or(&number));
            if text.parse::<Quantity>().is_ok_and(|q| q.si == si) {
                return crate::file::text::quoted(&text);
            }
        }
        let symbol = self.unit.si_symbol();
        crate::file::text::quoted(&format!("{si:?} {}", if symbol.is_empty() { "1" } else { &symbol }))
    }
}

impl Effect {
    /// What a parameter of an effect of this kind would be measured in at a place; `None` when the effect has no such
    /// parameter, or the vehicle no such place.
    pub fn unit_at(kind: Kind, place: &str, parameter: &str, vehicle: &Vehicle) -> Option<ParameterUnit> {
        let values = vec![None; kind.spec().parameters.len()];
        let (place, written, window) = (place.into(), Vec::new(), Default::default());
        let effect = Self { kind, place, values, text: None, written, window };
        effect.unit(parameter, vehicle)
    }

    /// What a parameter is measured in; `None` when the effect has no such parameter, or no place in the vehicle.
    pub fn unit(&self, parameter: &str, vehicle: &Vehicle) -> Option<ParameterUnit> {
        let place = self.find_place(vehicle).ok()?;
        let parameter = self.kind.spec().parameters.iter().find(|p| p.name == parameter)?;
        Some(unit(parameter, &signals(vehicle, place)))
    }

    /// Checks that values written with a unit fit the place.
    pub(super) fn check_units(&self, vehicle: &Vehicle, place: Place) -> Result<(), EffectError> {
        let signals = signals(vehicle, place);
        for &(index, found) in &self.written {
            let parameter = &self.kind.spec().parameters[index];
            if parameter.scale == Scale::Angle {
                continue;
            }
            let expected = unit(parameter, &signals).unit.dimension();
            if found != expected {
                let name =
                    |d: Dimension| if d.is_none() { "a pure number".into() } else { format!("in {d}") };
                let reason = format!("must be {}, but is {}", name(expected), name(found));
                return Err(self.error(Some(parameter.name), reason));
            }
        }
        Ok(())
    }

    /// Checks that no value stands without a unit that could be meant in another than SI, as in a file that declares
    /// degrees.
    ///
    /// # Errors
    /// With both readings of the number.
    pub(crate) fn check_bare(&self, vehicle: &Vehicle, place: Place) -> Result<(), EffectError> {
        let signals = signals(vehicle, place);
        for (index, parameter) in self.kind.spec().parameters.iter().enumerate() {
            let Some(value) = self.values[index] else { continue };
            if self.written.iter().any(|(written, _)| *written == index) {
                continue;
            }
            if let Some(reason) = unit(parameter, &signals).two_readings(value) {
                return Err(self.error(Some(parameter.name), reason));
            }
        }
        Ok(())
    }
}

/// Units of the first and the second signal of a place: what an entry is multiplied by, and what comes of it.
fn signals(vehicle: &Vehicle, place: Place) -> (SignalUnit, SignalUnit) {
    let one = SignalUnit::default;
    let input = |i: usize| vehicle.inputs[i].unit.clone();
    let output = |i: usize| vehicle.outputs[i].unit.clone();
    let state = |i: usize| vehicle.states[i].unit.clone();
    match place {
        Place::Input(i) => (input(i), one()),
        Place::InputPair(i, j) => (input(i), input(j)),
        Place::Output(i) => (output(i), one()),
        Place::OutputPair(i, j) => (output(i), output(j)),
        Place::State(i) => (state(i), one()),
        Place::StatePair(i, j) => (state(i), state(j).per_second()),
        Place::Entry(Matrix::A, i, j) => (state(j), state(i).per_second()),
        Place::Entry(Matrix::B, i, j) => (input(j), state(i).per_second()),
        Place::Entry(Matrix::C, i, j) => (state(j), output(i)),
        Place::Entry(Matrix::D, i, j) => (input(j), output(i)),
        Place::Vehicle => (one(), one()),
    }
}

fn unit(parameter: &Parameter, (first, second): &(SignalUnit, SignalUnit)) -> ParameterUnit {
    if let Some(symbol) = parameter.own_unit() {
        let unit = symbol.parse().unwrap_or(Unit::ONE);
        return ParameterUnit {
            kind: UnitKind::Named,
            unit,
            symbol: Some(symbol.into()),
            apart: symbol.into(),
        };
    }
    let signal = |signal: SignalUnit| ParameterUnit {
        unit: *signal.unit(),
        symbol: Some(signal.to_string()),
        apart: signal.to_string(),
        kind: UnitKind::Signal(signal),
    };
    // Exponents of real units stay far inside i8; a unit beyond that cannot match.
    let composite = |unit: Option<Unit>| ParameterUnit {
        kind: UnitKind::Composite,
        unit: Unit::coherent(unit.unwrap_or(Unit::ONE).dimension()),
        symbol: None,
        apart: String::new(),
    };
    let per_second = Unit::ONE.times(&Unit::SECOND, -1).unwrap_or(Unit::ONE);
    match parameter.scale {
        Scale::SignalRate => signal(first.per_second()),
        Scale::Drag => composite(per_second.times(first.unit(), -1)),
        Scale::Cubic => composite(second.unit().times(first.unit(), -3)),
        Scale::Entry | Scale::Coupling if first.is_one() => {
            // What an input without a unit does is in the unit of what it moves.
            ParameterUnit { kind: UnitKind::Entry, ..signal(second.clone()) }
        }
        Scale::Entry | Scale::Coupling => {
            let (unit, symbol) = second.over(first);
            ParameterUnit { kind: UnitKind::Entry, unit, symbol, apart: format!("{second} per {first}") }
        }
        _ => signal(first.clone()),
    }
}
