//! Decodes the health bits of SYS_STATUS as reasons against arming.
//!
//! Source: `MAV_SYS_STATUS_SENSOR` of <https://mavlink.io/en/messages/common.html>.

use super::dialect::{MavSysStatusSensor, SYS_STATUS_DATA};

/// Names of the parts by their bit.
const PARTS: [&str; 31] = [
    "gyroscope",
    "accelerometer",
    "magnetometer",
    "absolute pressure",
    "differential pressure",
    "GPS",
    "optical flow",
    "vision position",
    "laser position",
    "external ground truth",
    "angular rate control",
    "attitude stabilisation",
    "yaw position",
    "altitude control",
    "position control",
    "motor outputs",
    "remote control",
    "second gyroscope",
    "second accelerometer",
    "second magnetometer",
    "geofence",
    "attitude and heading",
    "terrain",
    "reversed motors",
    "logging",
    "battery",
    "proximity",
    "satellite link",
    "pre-arm checks",
    "obstacle avoidance",
    "propulsion",
];

const CHECKS: u32 = MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK.bits();

/// The health of an autopilot's parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Health {
    /// Bit mask of parts that are present, enabled, and unhealthy.
    ill: u32,
    /// True when it reports whether its pre-arm checks pass.
    has_checks: bool,
}

impl Health {
    pub(super) fn of(status: &SYS_STATUS_DATA) -> Self {
        let used = (status.onboard_control_sensors_present & status.onboard_control_sensors_enabled).bits();
        Self { ill: used & !status.onboard_control_sensors_health.bits(), has_checks: used & CHECKS != 0 }
    }

    /// Reason why it cannot be armed, as text; `None` when there is none. An unhealthy part is no reason when
    /// the checks pass.
    pub(super) fn reason(self) -> Option<String> {
        let failing = self.ill & CHECKS != 0;
        let named = PARTS.iter().enumerate().filter(|(bit, _)| (self.ill & !CHECKS) >> bit & 1 == 1);
        let named = named.map(|(_, name)| *name).collect::<Vec<_>>().join(", ");
        match (named.is_empty(), failing) {
            (true, true) => Some("its pre-arm checks fail".into()),
            (false, true) => Some(format!("its pre-arm checks fail; not healthy: {named}")),
            (false, false) if !self.has_checks => Some(format!("not healthy: {named}")),
            (_, false) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_in_use_that_are_not_well_are_named_unless_the_checks_pass() {
        use MavSysStatusSensor as Sensor;
        let (gyro, gps, checks) = (
            Sensor::MAV_SYS_STATUS_SENSOR_3D_GYRO,
            Sensor::MAV_SYS_STATUS_SENSOR_GPS,
            Sensor::MAV_SYS_STATUS_PREARM_CHECK,
        );
        let reason = |enabled: Sensor, health: Sensor| {
            let status = SYS_STATUS_DATA {
                onboard_control_sensors_present: gyro | gps | checks,
                onboard_control_sensors_enabled: enabled,
                onboard_control_sensors_health: health,
                ..Default::default()
            };
            Health::of(&status).reason()
        };
        assert_eq!(reason(gyro | gps | checks, gyro | checks), None, "its checks pass");
        let both = reason(gyro | gps | checks, gyro).unwrap();
        assert_eq!(both, "its pre-arm checks fail; not healthy: GPS");
        assert_eq!(reason(gyro | checks, gyro).unwrap(), "its pre-arm checks fail");
        assert_eq!(reason(gyro | gps, gps).unwrap(), "not healthy: gyroscope");
        assert_eq!(reason(gyro, gyro), None, "what is not in use may be ill");
    }
}
