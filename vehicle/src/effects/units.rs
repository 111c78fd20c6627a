//! Units of an effect's parameters, at its place in a vehicle.

use whirlstand_msgs::units::{Dimension, Quantity, ShownUnit, Unit, clean, two_readings};

use super::Effect;
use super::kind::Kind;
use super::place::{Matrix, Place};
use super::table::{Parameter, Scale};
use crate::error::EffectError;
use crate::model::Vehicle;
use crate::signal_unit::SignalUnit;

/// Unit of an effect's parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterUnit {
    kind: UnitKind,
    /// The unit in terms of the vehicle file's own units.
    unit: Unit,
    /// Text of `unit`, where it can be written as a symbol.
    symbol: Option<String>,
    /// Text of `unit` for a reader, with `per`.
    apart: String,
}

#[derive(Debug, Clone, PartialEq)]
enum UnitKind {
    /// The parameter's name contains the unit (`delay_s`), or the number is dimensionless.
    Named,
    /// The unit of a signal, or of its derivative.
    Signal(SignalUnit),
    /// The unit of a matrix entry: SI in an effect, the declared units in the matrix itself.
    Entry,
    /// A coefficient of powers of signals, in SI.
    Composite,
}

impl ParameterUnit {
    /// Symbol of the SI unit; empty for a dimensionless number.
    pub fn si_symbol(&self) -> String {
        match self.kind {
            UnitKind::Named => self.symbol.clone().unwrap_or_default(),
            _ => self.unit.si_symbol(),
        }
    }

    /// Unit in which SI values are shown to a reader: that of the vehicle file for signals and entries that
    /// have one, SI for coefficients.
    pub fn in_words(&self) -> ShownUnit {
        match (&self.kind, &self.symbol) {
            (UnitKind::Signal(signal), _) => signal.shown(),
            // As 1/s^2, not rad/s^2/rad.
            (UnitKind::Entry, Some(symbol))
                if !(self.unit.is_si() && self.si_symbol().len() <= symbol.len()) =>
            {
                ShownUnit::declared(&self.unit, symbol)
            }
            _ => ShownUnit::si(&self.si_symbol()),
        }
    }

    /// Text of an SI value for a reader, with its unit: that of the vehicle file for signals, SI for
    /// coefficients.
    pub fn shown(&self, si: f64) -> String {
        let (value, symbol) = match &self.kind {
            UnitKind::Signal(signal) if signal.is_one() => (si, String::new()),
            UnitKind::Signal(signal) => (self.unit.from_si(si), signal.to_string()),
            _ => (si, self.si_symbol()),
        };
        format!("{} {symbol}", clean(value)).trim_end().to_string()
    }

    /// Symbol of the unit in the vehicle file's own units, with `per` where no symbol can be written, or only
    /// with more base units: `A/s per V`, not `s^2*A^2/kg/m^2`.
    pub(crate) fn shown_symbol(&self) -> String {
        let si = self.unit.si_symbol();
        match &self.symbol {
            _ if self.unit.is_si() && (self.apart.is_empty() || si.len() <= self.apart.len()) => si,
            _ if self.unit.is_si() => self.apart.clone(),
            Some(symbol) => symbol.clone(),
            None => self.apart.clone(),
        }
    }

    /// The unit in terms of the vehicle file's own units.
    pub(crate) fn unit(&self) -> &Unit {
        &self.unit
    }

    /// Reason why a number without a unit is ambiguous, with both readings; `None` where it is not.
    pub(crate) fn two_readings(&self, value: f64) -> Option<String> {
        match &self.kind {
            UnitKind::Named | UnitKind::Composite => None,
            UnitKind::Signal(signal) => signal.two_readings(value),
            UnitKind::Entry => two_readings(value, &self.unit, self.symbol.as_deref()),
        }
    }

    /// Text of an SI value for a vehicle file: it reads back as the same number, and has its unit unless the
    /// parameter's name contains it, or there is none.
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
    /// Unit of a parameter of an effect of this kind at a place; `None` when the effect has no such
    /// parameter, or the vehicle no such place.
    pub fn unit_at(kind: Kind, place: &str, parameter: &str, vehicle: &Vehicle) -> Option<ParameterUnit> {
        let values = vec![None; kind.spec().parameters.len()];
        let (place, written, window) = (place.into(), Vec::new(), Default::default());
        let effect = Self { kind, place, values, text: None, written, window };
        effect.unit(parameter, vehicle)
    }

    /// Unit of a parameter; `None` when the effect has no such parameter, or its place is not in the vehicle.
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

    /// Checks that no value without a unit is ambiguous, as in a file that declares degrees.
    ///
    /// # Errors
    /// For an ambiguous number; the message gives both readings.
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

/// Units of the first and the second signal of a place: the factor of an entry, and its product.
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
    // Exponents of physical units are far below the range of i8; a unit beyond it cannot match.
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
            // The effect of a dimensionless input has the unit of what it moves.
            ParameterUnit { kind: UnitKind::Entry, ..signal(second.clone()) }
        }
        Scale::Entry | Scale::Coupling => {
            let (unit, symbol) = second.over(first);
            ParameterUnit { kind: UnitKind::Entry, unit, symbol, apart: format!("{second} per {first}") }
        }
        _ => signal(first.clone()),
    }
}
