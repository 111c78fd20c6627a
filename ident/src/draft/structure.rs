//! Candidate structures of a draft, each as a vehicle of one input and one output with free parameters.

use nalgebra::DMatrix;
use serde::Serialize;
use whirlstand_vehicle::{
    Effect, Free, Input, Intersample, Kind, Matrix, Output, SignalUnit, State, Target, Vehicle,
};

use super::error::DraftError;

/// Longest delay allowed, s: those of radios and flight controllers are far shorter.
pub const LONGEST_DELAY_S: f64 = 0.25;
/// Longest actuator lag allowed, s: about that of a large rotor.
pub const LONGEST_LAG_S: f64 = 0.5;
/// Fastest growth of an unstable pole allowed, 1/s: twice that of the X-29, whose motion doubled within 0.15 s (Clarke,
/// Burken, Bosworth and Bauer, NASA TM 4598, 1994). Bounds nearer to what vehicles have would be met by estimates that
/// scatter, and their structures would not be taken.
const FASTEST_GROWTH: f64 = 10.0;
/// Largest ratio of a gain to the spread of the output over that of the input.
const GAIN_ROOM: f64 = 10.0;

/// Structure of an axis: how an output depends on an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Structure {
    /// Order of the rigid-body motion, 1 or 2.
    pub order: usize,
    /// True when the actuator is a first-order lag.
    pub lag: bool,
    /// True when the input is delayed.
    pub delay: bool,
}

/// Signals that a structure connects.
#[derive(Debug, Clone, PartialEq)]
pub struct Signals {
    /// Name of the input.
    pub input: String,
    /// SI unit of the input.
    pub input_unit: SignalUnit,
    /// Name of the output.
    pub output: String,
    /// SI unit of the output.
    pub output_unit: SignalUnit,
    /// Spread of the output over that of the input, SI.
    pub ratio: f64,
    /// Time between two steps, s.
    pub period_s: f64,
    /// What the input does between its samples.
    pub intersample: Intersample,
    /// Actuator dynamics determined by another axis with the same actuators.
    pub actuators: Option<Actuators>,
}

/// Known dynamics of actuators, s; `None` where they have no such effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actuators {
    /// Time constant of the lag, s.
    pub lag_s: Option<f64>,
    /// Delay of the input, s.
    pub delay_s: Option<f64>,
}

impl Actuators {
    /// Actuator dynamics of a fitted vehicle of one input.
    pub fn of(vehicle: &Vehicle) -> Self {
        let value = |kind: Kind, name: &str| {
            vehicle.effects.iter().find(|e| e.kind() == kind).and_then(|e| e.parameter(name))
        };
        Self {
            lag_s: value(Kind::ActuatorLag, "time_constant_s"),
            delay_s: value(Kind::InputDelay, "delay_s"),
        }
    }
}

impl Structure {
    /// All structures, the simplest first.
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        for order in [1, 2] {
            for (lag, delay) in [(false, false), (false, true), (true, false), (true, true)] {
                all.push(Self { order, lag, delay });
            }
        }
        all.sort_by_key(Self::parameters);
        all
    }

    /// True when the structure is compatible with the known actuator dynamics.
    pub fn agrees(&self, known: Option<&Actuators>) -> bool {
        known.is_none_or(|k| k.lag_s.is_some() == self.lag && k.delay_s.is_some() == self.delay)
    }

    /// Number of free parameters without known actuator dynamics.
    pub fn parameters(&self) -> usize {
        self.order + 1 + self.effects()
    }

    /// Number of effects on the input.
    pub fn effects(&self) -> usize {
        usize::from(self.lag) + usize::from(self.delay)
    }

    /// True when the structure is the other one with one more effect.
    pub fn extends(&self, other: &Self) -> bool {
        let holds = |mine: bool, its: bool| mine || !its;
        self.order == other.order
            && self.effects() == other.effects() + 1
            && holds(self.lag, other.lag)
            && holds(self.delay, other.delay)
    }

    /// The structure in words.
    pub fn words(&self) -> String {
        let order = if self.order == 1 { "first order" } else { "second order" };
        match (self.lag, self.delay) {
            (false, false) => order.into(),
            (true, false) => format!("{order} with lag"),
            (false, true) => format!("{order} with delay"),
            (true, true) => format!("{order} with lag and delay"),
        }
    }

    /// The structure as a vehicle with free parameters.
    ///
    /// # Errors
    /// When an effect does not fit, which means a mistake in this file.
    pub fn vehicle(&self, signals: &Signals) -> Result<Vehicle, DraftError> {
        let n = self.order;
        let (a, b) = self.start_matrices(signals);
        let slope = |k: usize| -> SignalUnit {
            let text = format!("{}{}", per_one(&signals.output_unit), "/s".repeat(k));
            text.parse().unwrap_or_default()
        };
        let name = |k: usize| match k {
            0 => signals.output.clone(),
            _ => format!("{}_slope", signals.output),
        };
        let state = |k: usize| State {
            name: name(k),
            unit: if k == 0 { signals.output_unit.clone() } else { slope(k) },
            bound: None,
        };
        let mut vehicle = Vehicle {
            name: "draft".into(),
            description: String::new(),
            states: (0..n).map(state).collect(),
            inputs: vec![Input {
                name: signals.input.clone(),
                unit: signals.input_unit.clone(),
                lower: f64::NEG_INFINITY,
                upper: f64::INFINITY,
                rate_limit: f64::INFINITY,
                intersample: signals.intersample,
            }],
            outputs: vec![Output {
                name: signals.output.clone(),
                unit: signals.output_unit.clone(),
                noise: 0.0,
                bias: 0.0,
                quantization: 0.0,
                every: 1,
                vibration: None,
            }],
            a,
            b,
            c: DMatrix::from_fn(1, n, |_, j| if j == 0 { 1.0 } else { 0.0 }),
            d: DMatrix::zeros(1, 1),
            effects: Vec::new(),
            free: self.free_entries(signals),
            fit: Vec::new(),
            map: Vec::new(),
            provenance: Vec::new(),
            source_text: String::new(),
            folder: None,
        };
        self.add_effects(signals, &mut vehicle)?;
        Ok(vehicle)
    }

    /// Start matrices: a motion that settles within a tenth of a second, with the gain of the signals'
    /// spreads.
    fn start_matrices(&self, signals: &Signals) -> (DMatrix<f64>, DMatrix<f64>) {
        let speed = 10f64.min(0.25 / signals.period_s);
        match self.order {
            1 => (DMatrix::from_element(1, 1, -speed), DMatrix::from_element(1, 1, speed * signals.ratio)),
            _ => (
                DMatrix::from_row_slice(2, 2, &[0.0, 1.0, -speed * speed, -1.4 * speed]),
                DMatrix::from_row_slice(2, 1, &[0.0, speed * speed * signals.ratio]),
            ),
        }
    }

    /// Free entries of A and B, with poles between a time constant of one step and slow growth.
    fn free_entries(&self, signals: &Signals) -> Vec<Free> {
        let fastest = 1.0 / signals.period_s;
        let entry = |matrix, i, j, lower: f64, upper: f64| Free {
            target: Target::Entry(matrix, i, j),
            lower: rounded(lower),
            upper: rounded(upper),
            start: None,
        };
        let gain = GAIN_ROOM * signals.ratio;
        match self.order {
            1 => {
                let b = gain * fastest;
                vec![entry(Matrix::A, 0, 0, -fastest, FASTEST_GROWTH), entry(Matrix::B, 0, 0, -b, b)]
            }
            _ => {
                let b = gain * fastest * fastest;
                vec![
                    entry(Matrix::A, 1, 0, -fastest * fastest, FASTEST_GROWTH * FASTEST_GROWTH),
                    entry(Matrix::A, 1, 1, -2.0 * fastest, FASTEST_GROWTH),
                    entry(Matrix::B, 1, 0, -b, b),
                ]
            }
        }
    }

    fn add_effects(&self, signals: &Signals, vehicle: &mut Vehicle) -> Result<(), DraftError> {
        let shortest = rounded(0.25 * signals.period_s);
        let longest = LONGEST_DELAY_S.max(4.0 * signals.period_s);
        let (lag_s, delay_s) = signals.actuators.map_or((None, None), |a| (a.lag_s, a.delay_s));
        let wanted = [
            (self.delay, Kind::InputDelay, "delay_s", delay_s, (0.0, longest)),
            (self.lag, Kind::ActuatorLag, "time_constant_s", lag_s, (shortest, LONGEST_LAG_S)),
        ];
        for (_, kind, name, known, (lower, upper)) in wanted.into_iter().filter(|w| w.0) {
            let value = known.unwrap_or_else(|| (2.0 * signals.period_s).max(0.02));
            vehicle.effects.push(Effect::new(kind, &signals.input, &[(name, value)])?);
            if known.is_some() {
                continue;
            }
            let target = Target::Effect(vehicle.effects.len() - 1, name);
            vehicle.free.push(Free { target, lower, upper, start: None });
        }
        Ok(())
    }
}

/// The text of a unit by which one can divide.
pub fn per_one(unit: &SignalUnit) -> String {
    let text = unit.to_string();
    if text.is_empty() { "1".into() } else { text }
}

/// Rounds outwards to two significant digits, for bounds.
pub fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let size = 10f64.powf(value.abs().log10().floor() - 1.0);
    let digits = (value.abs() / size * (1.0 - 1e-12)).ceil();
    // Rounded through text, so that 0.00051 does not become 0.0005099999999999999.
    format!("{:.1e}", value.signum() * digits * size).parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_structure_is_a_vehicle_that_a_file_can_hold() {
        let signals = Signals {
            input: "u_roll".into(),
            input_unit: SignalUnit::default(),
            output: "roll_rate".into(),
            output_unit: "rad/s".parse().unwrap(),
            ratio: 3.0,
            period_s: 0.01,
            intersample: Intersample::Held,
            actuators: None,
        };
        let all = Structure::all();
        assert_eq!(all.len(), 8);
        assert_eq!(all[0], Structure { order: 1, lag: false, delay: false });
        for structure in all {
            let vehicle = structure.vehicle(&signals).unwrap();
            assert_eq!(vehicle.free.len(), structure.parameters(), "{}", structure.words());
            let again = Vehicle::parse(&vehicle.to_toml(), "draft.toml").unwrap();
            assert_eq!((again.a, again.free), (vehicle.a, vehicle.free));
        }
        let known = Actuators { lag_s: Some(0.06), delay_s: None };
        let kept: Vec<_> = Structure::all().into_iter().filter(|s| s.agrees(Some(&known))).collect();
        assert!(kept.len() == 2 && kept.iter().all(|s| s.lag && !s.delay));
        let vehicle = kept[0].vehicle(&Signals { actuators: Some(known), ..signals }).unwrap();
        assert_eq!((Actuators::of(&vehicle), vehicle.free.len()), (known, 2), "it is no estimate any more");
    }

    #[test]
    fn bounds_are_rounded_outwards() {
        assert_eq!([0.0, 1.234, -0.000_513, 50.0, 99.9].map(rounded), [0.0, 1.3, -0.000_52, 50.0, 100.0]);
    }
}
