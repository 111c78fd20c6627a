//! Decodes PX4's events with the reasons why it does not arm.
//!
//! An EVENT has a number and arguments; their texts are metadata of each build. The summary of the arming
//! checks is decoded without them: its number is the hash of its name (FNV-1a of 32 bits, the lower 24,
//! component 1 above), and its arguments are `u8` part, `u32` components with failing checks, `u32`
//! components with warnings, `u32` modes in which it can be armed, little-endian without gaps. Bits of
//! components are those of `health_component_t`.
//!
//! Source: <https://mavlink.io/en/services/events.html>, `src/lib/events/enums.json`,
//! `platforms/common/include/px4_platform_common/events.h` and
//! `src/modules/commander/HealthAndArmingChecks/Common.cpp` of PX4.

use super::dialect::EVENT_DATA;

/// Names of the components by their bit; the first one is unspecified.
const COMPONENTS: [&str; 31] = [
    "no component",
    "absolute pressure",
    "differential pressure",
    "GPS",
    "optical flow",
    "vision position estimate",
    "distance sensor",
    "remote control",
    "motors or ESCs",
    "UTM",
    "logging",
    "battery",
    "communication links",
    "rate controller",
    "attitude controller",
    "position controller",
    "attitude estimate",
    "local position estimate",
    "mission",
    "avoidance",
    "system",
    "camera",
    "gimbal",
    "payload",
    "global position estimate",
    "storage",
    "parachute",
    "magnetometer",
    "accelerometer",
    "gyroscope",
    "Open Drone ID",
];

/// Event number of the summary of the arming checks.
const SUMMARY: u32 = id("commander_arming_check_summary");

/// Number of the autopilot's event with this name.
const fn id(name: &str) -> u32 {
    let bytes = name.as_bytes();
    let mut hash = 0x811c_9dc5_u32;
    let mut at = 0;
    while at < bytes.len() {
        hash = (hash ^ bytes[at] as u32).wrapping_mul(0x0100_0193);
        at += 1;
    }
    (hash & 0x00ff_ffff) | 1 << 24
}

/// Summary of the arming checks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ArmingChecks {
    /// Bit mask of components with failing checks.
    failing: u32,
    /// Bit mask of modes in which it can be armed.
    modes: u32,
}

impl ArmingChecks {
    /// Decodes the summary in an event; `None` for another event.
    pub(super) fn of(event: &EVENT_DATA) -> Option<Self> {
        let word = |at: usize| event.arguments[at..].first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
        let (failing, modes) = (word(1)?, word(9)?);
        (event.id == SUMMARY).then_some(Self { failing, modes })
    }

    /// Reason why it cannot be armed, as text; `None` when there is none.
    pub(super) fn reason(self) -> Option<String> {
        if self.failing == 0 && self.modes != 0 {
            return None;
        }
        let named = COMPONENTS.iter().enumerate().filter(|(bit, _)| self.failing >> bit & 1 == 1);
        let named: Vec<_> = named.map(|(_, name)| *name).collect();
        Some(match (named.is_empty(), self.modes) {
            (true, _) => "its arming checks let no mode be armed".into(),
            (false, 0) => format!("its arming checks fail, in every mode: {}", named.join(", ")),
            (false, _) => format!("its arming checks fail: {}", named.join(", ")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(id: u32, failing: u32, modes: u32) -> EVENT_DATA {
        let mut arguments = [0; 40];
        arguments[1..5].copy_from_slice(&failing.to_le_bytes());
        arguments[9..13].copy_from_slice(&modes.to_le_bytes());
        EVENT_DATA { id, arguments, ..Default::default() }
    }

    #[test]
    fn numbers_are_hashes_of_names() {
        // Values of libevents' own test of the health and arming checks.
        assert_eq!(SUMMARY, 1 << 24 | 11_047_904);
        assert_eq!(id("commander_health_summary"), 1 << 24 | 1_914_663);
    }

    #[test]
    fn a_summary_names_the_components_whose_checks_fail() {
        let reason = |failing, modes| ArmingChecks::of(&event(SUMMARY, failing, modes)).unwrap().reason();
        assert_eq!(reason(0, 7), None);
        let all = reason(1 << 3 | 1 << 27, 0).unwrap();
        assert_eq!(all, "its arming checks fail, in every mode: GPS, magnetometer");
        assert_eq!(reason(1 << 11, 1).unwrap(), "its arming checks fail: battery");
        assert_eq!(reason(0, 0).unwrap(), "its arming checks let no mode be armed");
        assert_eq!(ArmingChecks::of(&event(1, 8, 0)), None, "another event");
    }
}
