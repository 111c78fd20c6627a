//! What happened, as sentences on the time axis.

use serde::Serialize;
use whirlstand_logs::finding_text::finding_text;
use whirlstand_logs::shown::{number, shown};
use whirlstand_msgs::{
    Adjustment, AdjustmentKind, AdjustmentVerdict, Disturbance, Finding, FindingStage, Imu, MAX_STATES, flags,
};

use crate::scene::{Scene, Signal};

/// Bench time after which late commands are told again, s.
const LATE_S: f64 = 1.0;

/// How an event is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum EventKind {
    /// Somebody asked for it from outside.
    Asked,
    /// Something acts on the vehicle.
    Disturbance,
    /// Something is not as it should be.
    Warning,
    /// Anything else.
    Note,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Event {
    /// Bench time, s.
    pub t: f64,
    pub kind: EventKind,
    pub text: String,
}

/// Makes events of what changes from message to message.
pub(crate) struct Events {
    disturbance: [f64; MAX_STATES],
    flags: u32,
    /// Bench time at which commands were last said to be late, s.
    told_late: Option<f64>,
}

impl Events {
    pub fn new() -> Self {
        Self { disturbance: [0.0; MAX_STATES], flags: 0, told_late: None }
    }

    /// The vehicle is pushed by something else now.
    pub fn disturbed(&mut self, scene: &Scene, m: &Disturbance) -> Option<Event> {
        let before = std::mem::replace(&mut self.disturbance, m.dx);
        if before == m.dx {
            return None;
        }
        let acting = scene.states.iter().zip(m.dx).filter(|(_, dx)| *dx != 0.0);
        let texts: Vec<_> = acting
            .map(|(state, dx)| {
                format!("{} {} on {}", number(dx * state.factor), state.derivative_unit, state.name)
            })
            .collect();
        let text = match texts.is_empty() {
            true => "no disturbance any more".into(),
            false => format!("disturbance of {}", texts.join(" and ")),
        };
        Some(Event { t: seconds(m.head.stamp_ns), kind: EventKind::Disturbance, text })
    }

    /// What the plant does about commands.
    pub fn measured(&mut self, m: &Imu) -> Option<Event> {
        let before = std::mem::replace(&mut self.flags, m.flags);
        let began = |flag| m.flags & flag != 0 && before & flag == 0;
        let ended = |flag| m.flags & flag == 0 && before & flag != 0;
        let t = seconds(m.head.stamp_ns);
        let (kind, text) = if began(flags::FAILSAFE) {
            (EventKind::Warning, "failsafe: inputs at neutral")
        } else if ended(flags::FAILSAFE) {
            (EventKind::Note, "failsafe is over")
        } else if began(flags::HELD)
            && m.flags & flags::FAILSAFE == 0
            && self.told_late.is_none_or(|told| t > told + LATE_S)
        {
            self.told_late = Some(t);
            (EventKind::Warning, "commands are late, the last one is held")
        } else {
            return None;
        };
        Some(Event { t, kind, text: text.into() })
    }
}

/// What was asked for from outside, and what became of it; `None` for a message of another version.
pub(crate) fn adjusted(scene: &Scene, m: &Adjustment) -> Option<Event> {
    let verdict = AdjustmentVerdict::from_u32(m.verdict)?;
    let state = scene.states.get(m.index as usize);
    let valued = |unit: fn(&Signal) -> &str| {
        let text = state.map(|s| format!("{}: {} {}", s.name, number(m.value * s.factor), unit(s)));
        text.unwrap_or_default().trim_end().to_string()
    };
    let what = match AdjustmentKind::from_u32(m.what)? {
        AdjustmentKind::Gust => {
            format!(
                "gust on {} for {}",
                valued(|s| &s.derivative_unit),
                shown(m.length_ns as f64 * 1e-9, "s")
            )
        }
        AdjustmentKind::Engine => {
            let engine = ["off", "on", "flying"].get(m.value as usize).copied().unwrap_or("unknown");
            format!("engine {engine}")
        }
        AdjustmentKind::Setpoint => format!("setpoint of {}", valued(|s| &s.unit)),
        AdjustmentKind::Gain => format!("gain {}", number(m.value)),
        AdjustmentKind::Stop => "end of the run".into(),
        AdjustmentKind::Effect => {
            let effect = scene.effects.iter().find(|e| e.number == m.index + 1);
            let effect = effect.map_or_else(|| format!("effect {}", m.index + 1), |e| e.text.clone());
            format!("{effect} {}", if m.value == 0.0 { "off" } else { "on" })
        }
    };
    let (kind, text) = match verdict {
        AdjustmentVerdict::Done => (EventKind::Asked, what),
        _ => (EventKind::Warning, format!("{what} was refused")),
    };
    Some(Event { t: seconds(m.head.stamp_ns), kind, text })
}

/// What the mirror says; `None` for a message of another version.
pub(crate) fn found(scene: &Scene, m: &Finding) -> Option<Event> {
    let outputs: Vec<&str> = scene.outputs.iter().map(|o| o.name.as_str()).collect();
    let is_good = [FindingStage::Over, FindingStage::Law, FindingStage::FirstLaw];
    let kind = match is_good.iter().any(|s| *s as u32 == m.stage) {
        true => EventKind::Note,
        false => EventKind::Warning,
    };
    let text = format!("mirror: {}", finding_text(m, &outputs)?);
    Some(Event { t: seconds(m.head.stamp_ns), kind, text })
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Controls;
    use whirlstand_msgs::Message;
    use whirlstand_vehicle::Vehicle;

    #[test]
    fn changes_are_events_and_what_stays_is_none() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let scene = Scene::new("lab", "", 5_000_000, &vehicle, Controls::Nothing);
        let rate = vehicle.state_index("roll_rate").unwrap();
        let mut events = Events::new();
        let mut m = Disturbance::zeroed();
        assert_eq!(events.disturbed(&scene, &m), None);
        m.dx[rate] = std::f64::consts::PI;
        m.head.stamp_ns = 6_000_000_000;
        let event = events.disturbed(&scene, &m).unwrap();
        assert_eq!((event.t, event.text.as_str()), (6.0, "disturbance of 180 deg/s^2 on roll_rate"));
        assert_eq!(events.disturbed(&scene, &m), None);
        let gust = Adjustment {
            what: AdjustmentKind::Gust as u32,
            verdict: AdjustmentVerdict::Done as u32,
            index: rate as u32,
            value: std::f64::consts::PI,
            length_ns: 200_000_000,
            ..Adjustment::zeroed()
        };
        assert_eq!(adjusted(&scene, &gust).unwrap().text, "gust on roll_rate: 180 deg/s^2 for 0.200 s");
        let refused = Adjustment { verdict: AdjustmentVerdict::OutOfRange as u32, ..gust };
        assert_eq!(adjusted(&scene, &refused).unwrap().kind, EventKind::Warning);
        let held = Imu { flags: flags::HELD, ..Imu::zeroed() };
        assert!(events.measured(&held).is_some() && events.measured(&held).is_none());
    }
}
