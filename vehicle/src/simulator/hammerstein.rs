//! A vehicle whose effects all act on its inputs as a Hammerstein model (Ljung 1999, 5.2): static effects on the commands, then
//! a linear step.

use nalgebra::DMatrix;

use super::compile::System;
use super::inputs::{Chain, Delay};
use super::limit::Limit;
use crate::discretise::discretise;
use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;
use crate::model::{Input, Vehicle};

/// One step of [`crate::Simulator::expected`] where every effect acts on an input, and always. Behind its commands such a
/// vehicle is linear:
///
/// `z+ = motion [z; v]`, `y = sensing [z; v] + offsets`
///
/// z are the vehicle's states, then those of lags and modes on its inputs; v are [`InputPaths`]. All in SI.
#[derive(Debug, Clone, PartialEq)]
pub struct HammersteinModel {
    /// Number of the vehicle's own states.
    pub own: usize,
    /// States x (states + 2 inputs).
    pub motion: DMatrix<f64>,
    /// Outputs x (states + 2 inputs).
    pub sensing: DMatrix<f64>,
    /// Declared bias of each output.
    pub offsets: Vec<f64>,
    /// States before the first command: zero for the vehicle's own, those of lags and modes in steady state.
    pub resting: Vec<f64>,
    /// Delay of each input: whole steps, by which the commands are late, and the fraction of a step beyond, s, which is in
    /// the matrices.
    pub delays: Vec<(usize, f64)>,
}

/// The inputs of a [`HammersteinModel`], step by step: commands behind limits, static effects and whole steps of delays.
#[derive(Debug, Clone)]
pub struct InputPaths {
    period_s: f64,
    step: u64,
    applied: Vec<f64>,
    limits: Vec<Limit>,
    paths: Vec<(Chain, Delay)>,
}

impl HammersteinModel {
    /// The model of `vehicle`, and its inputs before the first command; `None` where an effect acts elsewhere, or part of
    /// the time.
    ///
    /// # Errors
    /// As [`crate::Simulator::new`].
    pub fn new(vehicle: &Vehicle, period_s: f64) -> Result<Option<(Self, InputPaths)>, SimulatorError> {
        let placed = vehicle.effects.iter().map(|e| Ok((e.clone(), e.resolve(vehicle)?)));
        let effects = placed.collect::<Result<Vec<(Effect, Place)>, SimulatorError>>()?;
        let on_input = |(effect, place): &(Effect, Place)| {
            matches!(place, Place::Input(_) | Place::InputPair(..)) && effect.window().is_always()
        };
        if !effects.iter().all(on_input) {
            return Ok(None);
        }
        let system = System::new(vehicle, &effects, &vec![true; effects.len()])?;
        let commands = InputPaths::new(vehicle, &effects, period_s);
        let (a, b) = &system.stages[0];
        let (size, m) = b.shape();
        let over = |length_s: f64| {
            let not_finite = |_| SimulatorError::NotFinite { vehicle: vehicle.name.clone(), period_s };
            discretise(a, b, length_s).map_err(not_finite)
        };
        let (phi, gamma) = over(period_s)?;
        let mut motion = DMatrix::zeros(size, size + 2 * m);
        motion.view_mut((0, 0), (size, size)).copy_from(&phi);
        motion.view_mut((0, size + m), (size, m)).copy_from(&gamma);
        for (input, (_, delay)) in commands.paths.iter().enumerate().filter(|(_, (_, d))| d.fraction_s > 0.0)
        {
            // The newer value acts for the rest of the step.
            let (_, rest) = over(period_s - delay.fraction_s)?;
            motion.column_mut(size + input).copy_from(&(gamma.column(input) - rest.column(input)));
            motion.column_mut(size + m + input).copy_from(&rest.column(input));
        }
        let p = vehicle.outputs.len();
        let (mut c, mut d) = (DMatrix::zeros(p, size), DMatrix::zeros(p, m));
        for (i, (ideal, _)) in system.outputs.iter().enumerate() {
            ideal.spread(i, &mut c, &mut d);
        }
        let mut sensing = DMatrix::zeros(p, size + 2 * m);
        sensing.view_mut((0, 0), (p, size)).copy_from(&c);
        for (input, (_, delay)) in commands.paths.iter().enumerate() {
            // Outputs are measured where the step begins.
            let value = if delay.fraction_s > 0.0 { input } else { m + input };
            sensing.column_mut(size + value).copy_from(&d.column(input));
        }
        let mut resting = vec![0.0; size];
        let before: Vec<f64> = commands.paths.iter().map(|(_, delay)| delay.newer()).collect();
        for rest in &system.rests {
            resting[rest.state] = rest.gain * rest.signal.value(&resting, &before);
        }
        let model = Self {
            own: system.n,
            motion,
            sensing,
            offsets: vehicle.outputs.iter().map(|output| output.bias).collect(),
            resting,
            delays: commands.paths.iter().map(|(_, delay)| (delay.whole_steps(), delay.fraction_s)).collect(),
        };
        Ok(Some((model, commands)))
    }

    /// Number of states, those of lags and modes on the inputs included.
    pub fn states(&self) -> usize {
        self.motion.nrows()
    }

    /// True when the model of other values of the same effects has the same states and inputs, so that their matrices can
    /// be compared entry by entry.
    pub fn is_alike(&self, other: &Self) -> bool {
        let (size, m) = (self.states(), self.delays.len());
        let is_shown = |model: &Self, input: usize| {
            [input, m + input]
                .iter()
                .any(|column| model.sensing.column(size + column).iter().any(|d| *d != 0.0))
        };
        let mut delays = self.delays.iter().zip(&other.delays).enumerate();
        size == other.states()
            && delays.all(|(input, (own, other_s))| {
                // An output that shows the input itself is of the value before or behind the fraction.
                let same = (own.1 > 0.0) == (other_s.1 > 0.0);
                own.0 == other_s.0 && (same || !(is_shown(self, input) || is_shown(other, input)))
            })
    }
}

impl InputPaths {
    fn new(vehicle: &Vehicle, effects: &[(Effect, Place)], period_s: f64) -> Self {
        let neutral: Vec<f64> = vehicle.inputs.iter().map(Input::neutral).collect();
        let path = |(i, neutral): (usize, &f64)| {
            let own = effects.iter().enumerate().filter(move |(_, (_, place))| *place == Place::Input(i));
            Chain::with_delay(own.map(|(index, (effect, _))| (index, effect)), *neutral, period_s)
        };
        let limits = vehicle.inputs.iter().zip(&neutral);
        Self {
            period_s,
            step: 0,
            paths: neutral.iter().enumerate().map(path).collect(),
            limits: limits.map(|(input, neutral)| Limit::new(input, period_s, *neutral)).collect(),
            applied: neutral,
        }
    }

    /// True when the parameters of effects of this kind change the commands, not the matrices; of a delay only its whole
    /// steps do.
    pub fn depend_on(kind: Kind) -> bool {
        Chain::holds(kind)
    }

    /// Begins at a later step than 0. To be called before the first step.
    pub fn begin_at(&mut self, step: u64) {
        self.step = step;
    }

    /// Writes the inputs of the next step into `v`: of each the value until the fraction of a step by which it is delayed,
    /// then of each the value from there on. NaN is replaced by the previous command.
    ///
    /// # Panics
    /// When `u` has not one value, and `v` not two, for each input.
    pub fn next(&mut self, u: &[f64], v: &mut [f64]) {
        let m = self.paths.len();
        assert!(u.len() == m && v.len() == 2 * m, "one command and two inputs for each input");
        let (before, after) = v.split_at_mut(m);
        // As in the simulator: the middle of the step, so that a drift has the correct mean over it.
        let t = (self.step as f64 + 0.5) * self.period_s;
        let own = self.limits.iter_mut().zip(&mut self.applied).zip(&mut self.paths);
        for (i, ((limit, applied), (chain, delay))) in own.enumerate() {
            *applied = limit.next(u[i], *applied);
            delay.push(chain.next(*applied, t));
            (before[i], after[i]) = (delay.older(), delay.newer());
        }
        self.step += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simulator;

    fn vehicle(effects: &str) -> Vehicle {
        let text = format!(
            "A = [[0.0, 1.0], [-9.0, -2.0]]\nB = [[0.0, 0.5], [5.0, 3.0]]\nC = [[1.0, 0.0], [0.0, 1.0]]\n\
             D = [[0.0, 0.2], [0.1, 0.0]]\n\
             states = [{{ name = 'roll' }}, {{ name = 'roll_rate' }}]\n\
             inputs = [{{ name = 'u', lower = -1.5, upper = 0.8, rate_limit = 60.0 }}, {{ name = 'v', lower = 0.1, upper = 2.0 }}]\n\
             outputs = [{{ name = 'roll', bias = 0.05 }}, {{ name = 'roll_rate' }}]\n{effects}"
        );
        Vehicle::parse(&text, "axis.toml").unwrap()
    }

    fn effect(kind: &str, on: &str, parameters: &str) -> String {
        format!("[[effects]]\neffect = '{kind}'\nwhere = '{on}'\n{parameters}\n")
    }

    /// The simulator is the judge: outputs and states are the same at each step.
    #[test]
    fn a_hammerstein_model_moves_as_the_simulator_does() {
        let all = [
            String::new(),
            effect("actuator_lag", "u", "time_constant_s = 0.05"),
            effect("input_delay", "u", "delay_s = 0.033"),
            effect("input_delay", "v", "delay_s = 0.02") + &effect("input_delay", "u", "delay_s = 0.004"),
            effect("unmodelled_mode", "v", "frequency_hz = 4.0\ndamping_ratio = 0.2\ngain = 1.3")
                + &effect("input_delay", "v", "delay_s = 0.017")
                + &effect("dead_zone", "v", "width = 0.2"),
            effect("input_coupling", "u->v", "coefficient = 0.4")
                + &effect("input_gain", "u", "factor = 0.7")
                + &effect("gain_drift", "v", "rate_per_s = -0.02")
                + &effect("input_bias", "v", "offset = 0.3")
                + &effect("backlash", "u", "width = 0.1")
                + &effect("actuator_lag", "v", "time_constant_s = 0.2"),
        ];
        for effects in all {
            let vehicle = vehicle(&effects);
            let period_s = 0.01;
            let mut simulator = Simulator::expected(&vehicle, period_s).unwrap();
            let (model, mut commands) = HammersteinModel::new(&vehicle, period_s).unwrap().unwrap();
            let (first, begun) = (700, [0.3, -0.2]);
            simulator.begin_at(first);
            simulator.set_state(&begun);
            commands.begin_at(first);
            let mut z = model.resting.clone();
            z[..2].copy_from_slice(&begun);
            let size = model.states();
            for k in 0..300 {
                let at = |f: f64| 2.0 * (f64::from(k) * period_s * f).sin();
                let u = [if k % 40 == 7 { f64::NAN } else { at(9.0) }, at(5.0)];
                simulator.apply(&u);
                z.resize(size + 4, 0.0);
                commands.next(&u, &mut z[size..]);
                let now = nalgebra::DVector::from_column_slice(&z);
                let y = &model.sensing * &now + nalgebra::DVector::from_column_slice(&model.offsets);
                for (y, other) in y.iter().zip(simulator.measure()) {
                    assert!((y - other).abs() < 1e-12 * y.abs().max(1.0), "{effects}\n{k}: {y} {other}");
                }
                simulator.advance();
                z = (&model.motion * &now).iter().copied().collect();
                for (x, other) in z.iter().zip(simulator.state()) {
                    assert!((x - other).abs() < 1e-12 * x.abs().max(1.0), "{effects}\n{k}: {x} {other}");
                }
            }
        }
    }

    #[test]
    fn what_acts_elsewhere_or_for_a_time_is_no_hammerstein_model() {
        for effects in [
            effect("sensor_lag", "roll", "time_constant_s = 0.1"),
            effect("cubic_stiffness", "roll->roll_rate", "coefficient = 1.0"),
            effect("input_gain", "u", "factor = 0.5\nfrom_s = 3.0"),
        ] {
            assert!(HammersteinModel::new(&vehicle(&effects), 0.01).unwrap().is_none(), "{effects}");
        }
    }
}
