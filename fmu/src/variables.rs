//! The variables of an FMU and their numbers (value references).

use whirlstand_vehicle::Vehicle;

/// The variable of a value reference; signals are given by their index in the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Variable {
    /// The independent variable, s.
    Time,
    /// The seed of the random numbers.
    Seed,
    /// Whether randomness, and rounding and sampling of outputs, are enabled.
    Noise,
    Input(usize),
    Output(usize),
    State(usize),
}

/// Value references: single variables first, then inputs, outputs and states in the vehicle's order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Variables {
    inputs: usize,
    outputs: usize,
    states: usize,
}

/// First value reference of the signals.
const SIGNALS: usize = 3;

impl Variables {
    pub(crate) fn of(vehicle: &Vehicle) -> Self {
        Self { inputs: vehicle.inputs.len(), outputs: vehicle.outputs.len(), states: vehicle.states.len() }
    }

    pub(crate) fn reference(&self, variable: Variable) -> usize {
        match variable {
            Variable::Time => 0,
            Variable::Seed => 1,
            Variable::Noise => 2,
            Variable::Input(i) => SIGNALS + i,
            Variable::Output(i) => SIGNALS + self.inputs + i,
            Variable::State(i) => SIGNALS + self.inputs + self.outputs + i,
        }
    }

    pub(crate) fn variable(&self, reference: u32) -> Option<Variable> {
        let reference = usize::try_from(reference).ok()?;
        let Some(signal) = reference.checked_sub(SIGNALS) else {
            return Some([Variable::Time, Variable::Seed, Variable::Noise][reference]);
        };
        if signal < self.inputs {
            return Some(Variable::Input(signal));
        }
        let signal = signal - self.inputs;
        if signal < self.outputs {
            return Some(Variable::Output(signal));
        }
        let signal = signal - self.outputs;
        (signal < self.states).then_some(Variable::State(signal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reference_is_that_of_its_variable() {
        let variables = Variables::of(&Vehicle::builtin("helicopter-hover").unwrap());
        let count = SIGNALS + variables.inputs + variables.outputs + variables.states;
        for reference in 0..count {
            let variable = variables.variable(reference as u32).unwrap();
            assert_eq!(variables.reference(variable), reference, "{variable:?}");
        }
        assert_eq!(variables.variable(count as u32), None);
        assert_eq!(variables.variable(u32::MAX), None);
    }
}
