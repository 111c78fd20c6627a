//! Preparation of the data: mean levels are subtracted, and outputs that depend on inputs before the record
//! are left out.

use whirlstand_vehicle::{Kind, Target, Vehicle};

use super::IdentifyError;
use super::data::Segment;

/// Levels about which a linear model describes the data: means over the fitted parts, weighted by length.
#[derive(Debug, Clone, PartialEq)]
pub struct Levels {
    /// Level of every input, SI.
    pub inputs: Vec<f64>,
    /// Level of every output, SI; 0 without values.
    pub outputs: Vec<f64>,
}

impl Levels {
    /// Means of all signals over `segments`.
    ///
    /// # Errors
    /// When an effect of the vehicle depends on where zero is: a model about a level would misplace it.
    pub fn of(vehicle: &Vehicle, segments: &[Segment]) -> Result<Self, IdentifyError> {
        let shifts = |kind: Kind| {
            matches!(
                kind,
                Kind::InputDelay
                    | Kind::ActuatorLag
                    | Kind::InputGain
                    | Kind::InputCoupling
                    | Kind::UnmodelledMode
                    | Kind::SensorDelay
                    | Kind::SensorLag
                    | Kind::SensorScale
                    | Kind::Misalignment
            )
        };
        if let Some(effect) = vehicle.effects.iter().find(|e| !shifts(e.kind()) || !e.window().is_always()) {
            let effect = format!("{} at '{}'", effect.kind(), effect.place());
            return Err(IdentifyError::Level { vehicle: vehicle.name.clone(), effect });
        }
        let mean = |all: &dyn Fn(&Segment) -> Vec<f64>| {
            let values: Vec<f64> = segments.iter().flat_map(all).filter(|v| v.is_finite()).collect();
            if values.is_empty() { 0.0 } else { whirlstand_logs::stats::mean(&values) }
        };
        let (m, p) = (vehicle.inputs.len(), vehicle.outputs.len());
        Ok(Self {
            inputs: (0..m)
                .map(|j| mean(&|s| s.inputs.iter().skip(j).step_by(m).copied().collect()))
                .collect(),
            outputs: (0..p).map(|i| mean(&|s| s.output(i, p))).collect(),
        })
    }

    /// Subtracts the levels from the signals of a segment.
    pub fn take_off(&self, segment: &mut Segment) {
        let (m, p) = (self.inputs.len().max(1), self.outputs.len().max(1));
        segment.inputs.iter_mut().enumerate().for_each(|(k, u)| *u -= self.inputs[k % m]);
        segment.outputs.iter_mut().enumerate().for_each(|(k, y)| *y -= self.outputs[k % p]);
    }

    /// Shifts the limits of the vehicle by the levels times `sign`: -1 for signals without their levels, 1 to
    /// undo it.
    pub fn shift(&self, vehicle: &mut Vehicle, sign: f64) {
        for (input, level) in vehicle.inputs.iter_mut().zip(&self.inputs) {
            input.lower += sign * level;
            input.upper += sign * level;
        }
    }
}

/// Leaves out the outputs that still depend on unknown inputs before the segment's start: those within the
/// longest input delay that the search may try. At most a tenth of the segment.
pub fn without_unknown_past(vehicle: &Vehicle, segment: &mut Segment) {
    let longest = |place: &str| -> f64 {
        let own = vehicle.effects.iter().enumerate();
        let own = own.filter(|(_, e)| e.kind() == Kind::InputDelay && e.place() == place);
        own.map(|(index, effect)| {
            let free = vehicle.free.iter().find(|f| f.target == Target::Effect(index, "delay_s"));
            free.map_or(effect.parameter("delay_s").unwrap_or(0.0), |f| f.upper)
        })
        .sum()
    };
    let delay_s = vehicle.inputs.iter().map(|u| longest(&u.name)).fold(0.0, f64::max);
    let steps = ((delay_s / segment.period_s).ceil() as usize).min(segment.steps / 10);
    let p = vehicle.outputs.len();
    segment.outputs[..steps * p].fill(f64::NAN);
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Effect;

    fn segment(steps: usize) -> Segment {
        let wave = |k: usize, level: f64| level + (k as f64).sin();
        Segment {
            origin: "test".into(),
            start_s: 0.0,
            first_step: 0,
            period_s: 0.1,
            inputs: (0..steps).flat_map(|k| [wave(k, 5.0), wave(k, -2.0)]).collect(),
            outputs: (0..steps).flat_map(|k| [wave(k, 1.0), f64::NAN, wave(k, 3.0), wave(k, 4.0)]).collect(),
            steps,
        }
    }

    #[test]
    fn levels_leave_means_of_zero_and_come_back() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        vehicle.effects.clear();
        let before = vehicle.clone();
        let mut segment = segment(200);
        let levels = Levels::of(&vehicle, std::slice::from_ref(&segment)).unwrap();
        levels.take_off(&mut segment);
        for i in [0, 2, 3] {
            let mean = whirlstand_logs::stats::mean(&segment.output(i, 4));
            assert!(mean.abs() < 1e-12, "{mean}");
        }
        assert!(segment.output(1, 4).iter().all(|v| v.is_nan()) && levels.outputs[1] == 0.0);
        levels.shift(&mut vehicle, -1.0);
        assert!((vehicle.inputs[0].upper - before.inputs[0].upper + levels.inputs[0]).abs() < 1e-12);
        levels.shift(&mut vehicle, 1.0);
        assert!((vehicle.inputs[1].lower - before.inputs[1].lower).abs() < 1e-9);
        vehicle.effects.push(Effect::new(Kind::DeadZone, "u_roll", &[("width", 0.1)]).unwrap());
        let error = Levels::of(&vehicle, &[segment]).unwrap_err().to_string();
        assert!(error.contains("dead_zone at 'u_roll'"), "{error}");
    }

    #[test]
    fn outputs_within_the_longest_delay_are_left_out() {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        vehicle.effects.push(Effect::new(Kind::InputDelay, "u_roll", &[("delay_s", 0.25)]).unwrap());
        let (mut long, mut short) = (segment(200), segment(20));
        without_unknown_past(&vehicle, &mut long);
        without_unknown_past(&vehicle, &mut short);
        let blank = |s: &Segment| s.output(0, 4).iter().filter(|v| v.is_nan()).count();
        assert_eq!((blank(&long), blank(&short)), (3, 2));
    }
}
