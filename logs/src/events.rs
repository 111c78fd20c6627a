//! Events of a run as sentences on the time axis.

use std::collections::BTreeMap;
use whirlstand_msgs::units::{ShownSignals, ShownUnit};

use serde::Serialize;
use whirlstand_msgs::{
    Adjustment, AdjustmentKind, AdjustmentVerdict, Disturbance, Finding, FindingStage, Health, Imu,
    MAX_STATES, flags,
};

use crate::bench_info::BenchInfo;
use crate::bench_log::BenchMessage;
use crate::finding_text::finding_text;
use crate::shown::{number, shown};

/// Bench time after which late commands are reported again, s.
const LATE_S: f64 = 1.0;

/// Kind of an event, which determines how it is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A request from outside.
    Asked,
    /// A disturbance of the vehicle.
    Disturbance,
    /// A condition that is not as it should be.
    Warning,
    /// Any other event.
    Note,
}

/// An event of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Event {
    /// Bench time, s.
    pub t: f64,
    /// Kind of the event.
    pub kind: EventKind,
    /// Description of the event.
    pub text: String,
}

/// A state with the unit in which it is shown.
struct Shown {
    name: String,
    unit: ShownUnit,
    derivative: ShownUnit,
}

/// Derives events from a bench's messages.
pub struct Events {
    states: Vec<Shown>,
    outputs: Vec<String>,
    units: ShownSignals,
    effects: BTreeMap<u32, String>,
    period_s: f64,
    disturbance: [f64; MAX_STATES],
    flags: u32,
    /// Bench time of the last report of late commands, s.
    told_late: Option<f64>,
    /// Process number of each node.
    nodes: BTreeMap<String, u32>,
}

impl Events {
    /// The state before the first event of a bench. `effects`: the switchable effects by their number from 1.
    pub fn new(info: &BenchInfo, effects: BTreeMap<u32, String>) -> Self {
        let state = |s: &crate::SignalInfo| {
            let unit = s.shown_unit();
            Shown { name: s.name.clone(), derivative: unit.per_second(), unit }
        };
        let named = |s: &crate::SignalInfo| (s.name.clone(), s.shown_unit());
        Self {
            states: info.states.iter().map(state).collect(),
            outputs: info.outputs.iter().map(|o| o.name.clone()).collect(),
            units: ShownSignals::new(
                info.states.iter().map(named),
                info.inputs.iter().map(named),
                info.outputs.iter().map(named),
            ),
            effects,
            period_s: info.period_ns as f64 * 1e-9,
            disturbance: [0.0; MAX_STATES],
            flags: 0,
            told_late: None,
            nodes: BTreeMap::new(),
        }
    }

    /// The event that a message reports, if it is new.
    pub fn hear(&mut self, message: &BenchMessage) -> Option<Event> {
        match message {
            BenchMessage::Disturbance(m) => self.disturbed(m),
            BenchMessage::Imu(m) => self.measured(m),
            BenchMessage::Adjustment(m) => self.adjusted(m),
            BenchMessage::Finding(m) => self.found(m),
            BenchMessage::Health(m) => self.reported(m),
            _ => None,
        }
    }

    /// Resets the state for a new run of the plant.
    pub fn begin_run(&mut self) {
        (self.disturbance, self.flags, self.told_late) = ([0.0; MAX_STATES], 0, None);
    }

    /// A change of the disturbance.
    fn disturbed(&mut self, m: &Disturbance) -> Option<Event> {
        let before = std::mem::replace(&mut self.disturbance, m.dx);
        if before == m.dx {
            return None;
        }
        let acting = self.states.iter().zip(m.dx).filter(|(_, dx)| *dx != 0.0);
        let texts: Vec<_> =
            acting.map(|(state, dx)| format!("{} on {}", state.derivative.text(dx), state.name)).collect();
        let text = match texts.is_empty() {
            true => "disturbance over".into(),
            false => format!("disturbance of {}", texts.join(" and ")),
        };
        Some(Event { t: seconds(m.head.stamp_ns), kind: EventKind::Disturbance, text })
    }

    /// The plant's handling of late commands.
    fn measured(&mut self, m: &Imu) -> Option<Event> {
        let before = std::mem::replace(&mut self.flags, m.flags);
        let began = |flag| m.flags & flag != 0 && before & flag == 0;
        let ended = |flag| m.flags & flag == 0 && before & flag != 0;
        let t = seconds(m.head.stamp_ns);
        let (kind, text) = if began(flags::FAILSAFE) {
            (EventKind::Warning, "failsafe: inputs at neutral")
        } else if ended(flags::FAILSAFE) {
            (EventKind::Note, "failsafe over")
        } else if began(flags::HELD)
            && m.flags & flags::FAILSAFE == 0
            && self.told_late.is_none_or(|told| t > told + LATE_S)
        {
            self.told_late = Some(t);
            (EventKind::Warning, "commands are late, last one held")
        } else {
            return None;
        };
        Some(Event { t, kind, text: text.into() })
    }

    /// A request from outside and its result; `None` for a message of another version.
    fn adjusted(&self, m: &Adjustment) -> Option<Event> {
        let verdict = AdjustmentVerdict::from_u32(m.verdict)?;
        let state = self.states.get(m.index as usize);
        let valued = |unit: fn(&Shown) -> &ShownUnit| {
            state.map(|s| format!("{}: {}", s.name, unit(s).text(m.value))).unwrap_or_default()
        };
        let what = match AdjustmentKind::from_u32(m.what)? {
            AdjustmentKind::Gust => {
                format!("gust on {} for {}", valued(|s| &s.derivative), shown(m.length_ns as f64 * 1e-9, "s"))
            }
            AdjustmentKind::Engine => {
                let engine = ["off", "on", "flying"].get(m.value as usize).copied().unwrap_or("unknown");
                format!("engine {engine}")
            }
            AdjustmentKind::Setpoint => format!("setpoint of {}", valued(|s| &s.unit)),
            AdjustmentKind::Gain => format!("gain {}", number(m.value)),
            AdjustmentKind::Stop => "end of the run".into(),
            AdjustmentKind::Stick if m.value == 0.0 => "stick released".into(),
            AdjustmentKind::Stick => "stick taken over".into(),
            AdjustmentKind::Effect => {
                let number = m.index.saturating_add(1);
                let effect = self.effects.get(&number).cloned().unwrap_or_else(|| format!("effect {number}"));
                format!("{effect} {}", if m.value == 0.0 { "off" } else { "on" })
            }
        };
        let (kind, text) = match verdict {
            AdjustmentVerdict::Done => (EventKind::Asked, what),
            _ => (EventKind::Warning, format!("{what} was refused")),
        };
        Some(Event { t: seconds(m.head.stamp_ns), kind, text })
    }

    /// A finding of the mirror; `None` for a message of another version.
    fn found(&self, m: &Finding) -> Option<Event> {
        let outputs: Vec<&str> = self.outputs.iter().map(String::as_str).collect();
        let is_good = [FindingStage::Over, FindingStage::Law, FindingStage::FirstLaw];
        let kind = match is_good.iter().any(|s| *s as u32 == m.stage) {
            true => EventKind::Note,
            false => EventKind::Warning,
        };
        let text = format!("mirror: {}", finding_text(m, &outputs, &self.units)?);
        Some(Event { t: seconds(m.head.stamp_ns), kind, text })
    }

    /// A restart of a node, which shows as another process number.
    fn reported(&mut self, m: &Health) -> Option<Event> {
        let name = m.node_name();
        match self.nodes.get_mut(name) {
            Some(pid) if *pid == m.pid => return None,
            Some(pid) => *pid = m.pid,
            None => {
                self.nodes.insert(name.into(), m.pid);
                return None;
            }
        }
        let t = m.head.step as f64 * self.period_s;
        Some(Event { t, kind: EventKind::Warning, text: format!("{name} was started again") })
    }
}

fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SignalInfo;
    use whirlstand_msgs::{Head, Message};

    #[test]
    fn changes_are_events_and_what_stays_is_none() {
        let states = vec![SignalInfo::new("roll", "rad"), SignalInfo::new("roll_rate", "rad/s")];
        let info = BenchInfo { period_ns: 5_000_000, states, ..BenchInfo::default() };
        let mut events = Events::new(&info, BTreeMap::from([(2, "input_delay at u_roll".into())]));
        let mut m = Disturbance::zeroed();
        assert_eq!(events.hear(&m.into()), None);
        m.dx[1] = std::f64::consts::PI;
        m.head.stamp_ns = 6_000_000_000;
        let event = events.hear(&m.into()).unwrap();
        assert_eq!((event.t, event.text.as_str()), (6.0, "disturbance of 180 deg/s^2 on roll_rate"));
        assert_eq!(events.hear(&m.into()), None);
        let gust = Adjustment {
            what: AdjustmentKind::Gust as u32,
            verdict: AdjustmentVerdict::Done as u32,
            index: 1,
            value: std::f64::consts::PI,
            length_ns: 200_000_000,
            ..Adjustment::zeroed()
        };
        let text = |event: Option<Event>| event.unwrap().text;
        assert_eq!(text(events.hear(&gust.into())), "gust on roll_rate: 180 deg/s^2 for 0.200 s");
        let refused = Adjustment { verdict: AdjustmentVerdict::OutOfRange as u32, ..gust };
        assert_eq!(events.hear(&refused.into()).unwrap().kind, EventKind::Warning);
        let switched = Adjustment { what: AdjustmentKind::Effect as u32, value: 1.0, ..gust };
        assert_eq!(text(events.hear(&switched.into())), "input_delay at u_roll on");
        let held = Imu { flags: flags::HELD, ..Imu::zeroed() };
        assert!(events.hear(&held.into()).is_some() && events.hear(&held.into()).is_none());
        events.begin_run();
        assert!(events.hear(&held.into()).is_some(), "a new run");
        let head = Head { seq: 0, step: 400, stamp_ns: 77 };
        let mut health = Health { head, pid: 7, ..Health::zeroed() };
        health.set_node_name("plant");
        assert_eq!(events.hear(&health.into()), None);
        health.pid = 8;
        let event = events.hear(&health.into()).unwrap();
        assert_eq!((event.t, event.text.as_str()), (2.0, "plant was started again"));
    }
}
