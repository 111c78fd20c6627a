//! Launch-file options of an autopilot that flies the bench's vehicle.

use std::time::Duration;

use whirlstand_vehicle::Vehicle;

use super::ardupilot::{self, Ardupilot, ArdupilotOptions};
use super::betaflight::{self, Betaflight, BetaflightOptions};
use super::flight::FlightOptions;
use super::px4::{self, Px4, Px4Options};
use super::{Autopilot, Rc, RcOptions};
use crate::config::{BridgeConfig, BridgeKind, ConfigError};
use crate::mixer::{FrameKind, Mixer, MixerOptions};
use crate::sensors::{SensorOptions, StateMap};

/// Kind of autopilot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AutopilotKind {
    /// PX4, as software or hardware in the loop.
    Px4Hil,
    /// ArduPilot with its JSON interface.
    ArdupilotJson,
    /// Betaflight as software in the loop.
    BetaflightSitl,
}

/// Lowest loop rate for Betaflight, Hz: its source (`updateState`) requires more than 50.
const BETAFLIGHT_SLOWEST_HZ: f64 = 60.0;

/// Parts that connect an autopilot to one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// Indices of the vehicle's motion among its states.
    pub states: StateMap,
    /// Mixer from the outputs of the autopilot to the inputs of the vehicle.
    pub mixer: Mixer,
    /// The pilot's channels.
    pub rc: Rc,
}

/// All options of an autopilot in a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct AutopilotConfig {
    /// Kind of autopilot.
    pub kind: AutopilotKind,
    /// Table `[bridge.flight]`.
    pub flight: FlightOptions,
    /// Table `[bridge.sensors]`.
    pub sensors: SensorOptions,
    /// Table `[bridge.mixer]`.
    pub mixer: MixerOptions,
    /// Table `[bridge.rc]`.
    pub rc: RcOptions,
    /// Table `[bridge.px4]`.
    pub px4: Px4Options,
    /// Table `[bridge.ardupilot]`.
    pub ardupilot: ArdupilotOptions,
    /// Table `[bridge.betaflight]`.
    pub betaflight: BetaflightOptions,
}

impl AutopilotConfig {
    /// The autopilot of a bridge; `None` for a bridge that replaces the plant.
    pub fn of(bridge: &BridgeConfig) -> Option<Self> {
        let kind = match bridge.kind {
            BridgeKind::Px4Hil => AutopilotKind::Px4Hil,
            BridgeKind::ArdupilotJson => AutopilotKind::ArdupilotJson,
            BridgeKind::BetaflightSitl => AutopilotKind::BetaflightSitl,
            BridgeKind::Mavlink | BridgeKind::Crsf => return None,
        };
        let o = bridge.options.clone();
        Some(Self {
            kind,
            flight: o.flight,
            sensors: o.sensors,
            mixer: o.mixer,
            rc: o.rc,
            px4: o.px4,
            ardupilot: o.ardupilot,
            betaflight: o.betaflight,
        })
    }

    /// The protocol of this autopilot, for steps of `period_ns` nanoseconds.
    pub fn autopilot(&self, period_ns: u64) -> Box<dyn Autopilot> {
        let motors = self.mixer.frame != FrameKind::Ccpm;
        match self.kind {
            AutopilotKind::Px4Hil => {
                let line = self.px4.state_period_ns(1e9 / period_ns as f64, self.sensors.gps_hz);
                // A slower serial line was refused with the other options.
                let state_period_ns = line.unwrap_or(u64::MAX);
                let px4 = Px4::with_state_period(self.px4.clone(), motors, state_period_ns);
                Box::new(px4.with_period(Duration::from_nanos(period_ns)))
            }
            AutopilotKind::ArdupilotJson => Box::new(Ardupilot::new(self.ardupilot.clone(), motors)),
            AutopilotKind::BetaflightSitl => Box::new(Betaflight::new(self.betaflight.clone(), motors)),
        }
    }

    /// The connecting parts for this vehicle, with every option checked.
    ///
    /// # Errors
    /// [`ConfigError`] for a vehicle without attitude, a mixer that does not fit, invalid channels, times or
    /// pulses, and options that the protocol does not allow.
    pub fn parts(&self, vehicle: &Vehicle, lockstep: bool, rate_hz: f64) -> Result<Parts, ConfigError> {
        let wrong = |path: &[&str], message: String| Err(ConfigError::new(path, message));
        let names = vehicle.states.iter().map(|s| s.name.as_str());
        let states = StateMap::new(names).map_err(|e| ConfigError::new(&[], e.to_string()))?;
        let mixer = Mixer::new(&self.mixer, &self.native_order(), vehicle)?;
        let rc = Rc::new(self.rc.clone())?;
        for (key, value) in
            [("stale_s", self.flight.stale_s), ("answer_timeout_s", self.flight.answer_timeout_s)]
        {
            if !(value > 0.0 && value <= 60.0) {
                return wrong(
                    &["flight", key],
                    format!("a time above 0 and up to 60 s is expected, not {value}"),
                );
            }
        }
        let sensors = &self.sensors;
        for (key, value) in [
            ("gyro_noise", sensors.gyro_noise),
            ("accel_noise", sensors.accel_noise),
            ("mag_noise", sensors.mag_noise),
            ("baro_noise", sensors.baro_noise),
            ("gps_hz", sensors.gps_hz),
        ] {
            if !(0.0..=1e6).contains(&value) {
                return wrong(&["sensors", key], format!("a number of at least 0 is expected, not {value}"));
            }
        }
        let (low, high) = (self.ardupilot.pwm_min, self.ardupilot.pwm_max);
        if low >= high {
            return wrong(
                &["ardupilot", "pwm_min"],
                format!("it must be below pwm_max, {low} is not below {high}"),
            );
        }
        if self.kind == AutopilotKind::Px4Hil
            && let Err(message) = self.px4.state_period_ns(rate_hz, sensors.gps_hz)
        {
            return wrong(&["px4", "link"], message);
        }
        if self.kind == AutopilotKind::BetaflightSitl {
            if lockstep {
                let message = "Betaflight does not wait: mode = \"realtime\" is expected";
                return wrong(&["betaflight"], message.into());
            }
            if rate_hz < BETAFLIGHT_SLOWEST_HZ {
                let message = format!(
                    "Betaflight needs its states at no less than {BETAFLIGHT_SLOWEST_HZ} Hz: raise rate_hz"
                );
                return wrong(&["betaflight"], message);
            }
        }
        Ok(Parts { states, mixer, rc })
    }

    /// Output of each motor of a quad in the order of the mixer's frames.
    pub fn native_order(&self) -> [usize; 4] {
        match self.kind {
            AutopilotKind::Px4Hil => px4::NATIVE_ORDER,
            AutopilotKind::ArdupilotJson => ardupilot::NATIVE_ORDER,
            AutopilotKind::BetaflightSitl => betaflight::NATIVE_ORDER,
        }
    }
}

impl AutopilotKind {
    /// Name of the autopilot.
    pub fn autopilot(self) -> &'static str {
        match self {
            Self::Px4Hil => "PX4",
            Self::ArdupilotJson => "ArduPilot",
            Self::BetaflightSitl => "Betaflight",
        }
    }
}
