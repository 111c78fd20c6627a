//! Bridges in a launch file: which node requests one, and whether its options are valid.

use whirlstand_bridge::autopilot::AutopilotConfig;
use whirlstand_bridge::config::{BridgeConfig, BridgeKind, ConfigError};
use whirlstand_bridge::turning::{inputs_of, own_motion_of};
use whirlstand_bridge::vehicle::{Bench, Vehicle};
use whirlstand_bus::Transport;
use whirlstand_msgs::units::{Unit, two_readings};
use whirlstand_nodes::bridge::link::Address;
use whirlstand_nodes::config::{Mode, Role};

use super::amount::Amount;
use super::document::{LaunchError, Step, at};
use super::plan::Planner;
use super::schema::LaunchFile;

impl Planner<'_> {
    /// The bridge of the bench, with its options checked.
    pub(super) fn bridge(&self, file: &LaunchFile) -> Result<Option<BridgeConfig>, LaunchError> {
        let mut asked = file.nodes.iter().filter_map(|(name, section)| Some((name, section.bridge?)));
        let Some((name, kind)) = asked.next() else { return Ok(None) };
        let fail =
            |name: &str, message: String| Err(self.document.error_at(at!["nodes", name, "bridge"], message));
        if let Some((second, other)) = asked.next() {
            return fail(
                second,
                format!("a bench can have only one bridge, but node {name} asks for {kind} besides {other}"),
            );
        }
        let place = if kind.is_vehicle() { Role::Plant } else { Role::Controller };
        if name != place.name() {
            return fail(name, format!("the bridge {kind} replaces the {place}, not '{name}'"));
        }
        if file.transport == Transport::Inproc {
            let message =
                "a bridge runs as a separate process: transport = \"iceoryx2\" or \"zenoh\" is expected";
            return Err(self.document.error_at(at!["transport"], message));
        }
        self.check_bare_angles()?;
        self.check_trims(file)?;
        let config = BridgeConfig { kind, options: file.bridge.clone() };
        if kind.is_vehicle() {
            if file.mode == Mode::Lockstep {
                let message = "a real vehicle does not wait: mode = \"realtime\" is expected";
                return Err(self.document.error_at(at!["mode"], message));
            }
            self.check_vehicle_bridge(file, &config)?;
        }
        if let Some(autopilot) = AutopilotConfig::of(&config) {
            autopilot
                .parts(self.vehicle, file.mode == Mode::Lockstep, file.rate_hz)
                .map_err(|e| self.bridge_error(&e))?;
            let links =
                [("px4", "link", &autopilot.px4.link), ("ardupilot", "link", &autopilot.ardupilot.link)];
            let forward = autopilot.px4.forward.iter().map(|link| ("px4", "forward", link));
            let AutopilotConfig { px4, ardupilot, betaflight, .. } = &autopilot;
            let beside = px4.telemetry.iter().map(|link| ("px4", "telemetry", link));
            let beside =
                beside.chain(ardupilot.telemetry.iter().map(|link| ("ardupilot", "telemetry", link)));
            let beside = beside.chain([("betaflight", "msp", &betaflight.msp)]);
            // An empty one is none.
            let beside = beside.filter(|(.., link)| !link.is_empty());
            for (table, key, link) in links.into_iter().chain(forward).chain(beside) {
                link.parse::<Address>()
                    .map_err(|e| self.bridge_error(&ConfigError::new(&[table, key], e.to_string())))?;
            }
        }
        Ok(Some(config))
    }

    /// Requires a unit for angles, angular rates and angular accelerations of the bridge: no file declares a unit
    /// for them, so a plain number could be degrees as well as radians.
    fn check_bare_angles(&self) -> Result<(), LaunchError> {
        let refuse = |path: &[Step<'_>], amount: &Amount, symbol: &str| {
            let unit: Unit = symbol.parse().unwrap_or(Unit::ONE);
            let Amount::Si(value) = amount else { return Ok(()) };
            let why = two_readings(*value, &unit, Some(symbol));
            why.map_or(Ok(()), |why| Err(self.document.error_at(path, format!("this {why}"))))
        };
        let quantities: [(&[Step<'_>], &str); 7] = [
            (at!["bridge", "sensors", "heading"], "deg"),
            (at!["bridge", "sensors", "field", "inclination"], "deg"),
            (at!["bridge", "sensors", "field", "declination"], "deg"),
            (at!["bridge", "sensors", "gyro_noise"], "deg/s"),
            (at!["bridge", "mixer", "roll", "acceleration"], "deg/s^2"),
            (at!["bridge", "mixer", "pitch", "acceleration"], "deg/s^2"),
            (at!["bridge", "mixer", "yaw", "acceleration"], "deg/s^2"),
        ];
        for (path, symbol) in quantities {
            let amount: Option<Amount> = self.document.read_at(path)?;
            amount.map_or(Ok(()), |amount| refuse(path, &amount, symbol))?;
        }
        let azimuths: Option<Vec<Amount>> = self.document.read_at(at!["bridge", "mixer", "azimuths"])?;
        for (i, azimuth) in azimuths.unwrap_or_default().iter().enumerate() {
            refuse(at!["bridge", "mixer", "azimuths", i], azimuth, "deg")?;
        }
        Ok(())
    }

    /// Checks the offsets of measured outputs, in the unit of the vehicle's output of that name.
    fn check_trims(&self, file: &LaunchFile) -> Result<(), LaunchError> {
        for name in file.bridge.measured.keys() {
            let path: &[Step<'_>] = at!["bridge", "measured", name, "offset"];
            let amount: Option<Amount> = self.document.read_at(path)?;
            if let (Some(amount), Some(i)) = (amount, self.vehicle.output_index(name)) {
                self.signal(path, "offset", &amount, &self.vehicle.outputs[i].unit)?;
            }
        }
        Ok(())
    }

    fn check_vehicle_bridge(&self, file: &LaunchFile, config: &BridgeConfig) -> Result<(), LaunchError> {
        let bench = Bench {
            inputs: inputs_of(self.vehicle),
            own: own_motion_of(self.vehicle),
            rate_hz: file.rate_hz,
            wants_odometry: false,
            signing: None,
        };
        Vehicle::new(config, bench).map_err(|e| self.bridge_error(&e))?;
        let options = &config.options;
        let mut links: Vec<(&[&str], &str)> = Vec::new();
        match (config.kind, &options.mavlink, &options.crsf) {
            (BridgeKind::Mavlink, Some(own), _) => {
                links.push((&["mavlink", "link"], &own.link));
                links.extend(own.output_link.iter().map(|l| (&["mavlink", "output_link"][..], l.as_str())));
                links.extend(own.forward.iter().map(|l| (&["mavlink", "forward"][..], l.as_str())));
            }
            (BridgeKind::Crsf, _, Some(own)) => links.push((&["crsf", "link"], &own.link)),
            _ => {}
        }
        for (path, text) in links {
            text.parse::<Address>().map_err(|e| self.bridge_error(&ConfigError::new(path, e.to_string())))?;
        }
        Ok(())
    }

    /// An error in the `[bridge]` table, with its line.
    pub(super) fn bridge_error(&self, error: &ConfigError) -> LaunchError {
        let step = |key: &'_ str| key.parse::<usize>().ok();
        let path = error.path.iter().map(|key| match step(key) {
            Some(index) => Step::Index(index),
            None => Step::Key(key),
        });
        let path: Vec<_> = std::iter::once(Step::Key("bridge")).chain(path).collect();
        self.document.error_at(&path, error.message.clone())
    }
}
