//! Finds the vehicle's motion among its states, by their names.

/// A state that a bridge requires is missing.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the vehicle has no state \"{missing}\" (it has {}); an autopilot steers attitude, so a vehicle on this bridge needs \
     the states roll and pitch",
    present.join(", ")
)]
pub struct MissingState {
    /// Name of the missing state.
    pub missing: &'static str,
    /// Names of the existing states.
    pub present: Vec<String>,
}

/// Position and speed along one axis of the heading frame, as far as the model has them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Axis {
    /// Position, m.
    pub position: Option<f64>,
    /// Speed, m/s.
    pub speed: Option<f64>,
}

/// Attitude and position of the model at one time.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Motion {
    /// Roll, pitch and yaw, rad.
    pub angles: [f64; 3],
    /// Rates of roll, pitch and yaw, rad/s.
    pub rates: [f64; 3],
    /// Axes forward, right and up.
    pub axes: [Axis; 3],
}

/// Indices of the motion's variables among the states.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateMap {
    angles: [Option<usize>; 3],
    rates: [Option<usize>; 3],
    positions: [Option<usize>; 3],
    speeds: [Option<usize>; 3],
}

impl StateMap {
    /// Finds the motion's variables among state names.
    ///
    /// # Errors
    /// [`MissingState`] without `roll` or `pitch`.
    pub fn new<'n>(names: impl IntoIterator<Item = &'n str>) -> Result<Self, MissingState> {
        let names: Vec<&str> = names.into_iter().collect();
        let find = |wanted: &str| names.iter().position(|n| *n == wanted);
        for missing in ["roll", "pitch"] {
            if find(missing).is_none() {
                return Err(MissingState { missing, present: names.iter().map(|n| (*n).into()).collect() });
            }
        }
        Ok(Self {
            angles: ["roll", "pitch", "yaw"].map(find),
            rates: ["roll_rate", "pitch_rate", "yaw_rate"].map(find),
            positions: ["longitudinal_position", "lateral_position", "height"].map(find),
            speeds: ["longitudinal_speed", "lateral_speed", "vertical_speed"].map(find),
        })
    }

    /// The motion in states `x`; states beyond the end of `x` count as absent.
    pub fn motion(&self, x: &[f64]) -> Motion {
        let at = |i: Option<usize>| i.and_then(|i| x.get(i)).copied();
        let mut axes = [Axis::default(); 3];
        for ((axis, position), speed) in axes.iter_mut().zip(self.positions).zip(self.speeds) {
            *axis = Axis { position: at(position), speed: at(speed) };
        }
        Motion {
            angles: self.angles.map(|i| at(i).unwrap_or(0.0)),
            rates: self.rates.map(|i| at(i).unwrap_or(0.0)),
            axes,
        }
    }
}
