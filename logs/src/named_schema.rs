//! The schema of a message with the vehicle's own names in it: `x.roll` instead of `x[0]`.
//!
//! In CDR an array of numbers and a message of as many numbers have the same bytes (OMG DDS-RTPS 2.5, section
//! 10.2.1.2: neither has a header, and all elements are aligned alike). A log can therefore name every element
//! without another layout.

use std::collections::BTreeMap;

use whirlstand_msgs::{Each, Message};

use crate::bench_info::{BenchInfo, SignalInfo};

/// Types with an element for each state, input or output.
const TYPES: [(Each, &str); 3] =
    [(Each::State, "VehicleStates"), (Each::Input, "VehicleInputs"), (Each::Output, "VehicleOutputs")];

/// Name of an element without a signal of the vehicle.
const UNUSED: &str = "unused";

const PACKAGE: &str = "whirlstand/";

/// The schema of `M` in ROS 2 message syntax, for the vehicle of a bench. Arrays without a name keep their form.
pub fn named_schema<M: Message>(info: &BenchInfo) -> String {
    let mut text = M::SCHEMA.to_string();
    let mut types = BTreeMap::new();
    for field in M::FIELDS {
        let Some(each) = field.each else { continue };
        let signals = match each {
            Each::State => &info.states,
            Each::Input => &info.inputs,
            Each::Output => &info.outputs,
        };
        let Some((_, name)) = TYPES.iter().find(|(e, _)| *e == each) else { continue };
        if !signals.is_empty() && signals.len() <= field.count {
            text = text.replace(&array(field.count, field.name), &format!("{name} {}\n", field.name));
            types.entry(*name).or_insert_with(|| elements(signals, field.count));
        }
    }
    for (name, elements) in types {
        text += &format!("{}\nMSG: {PACKAGE}{name}\n{elements}", "=".repeat(80));
    }
    text
}

fn array(count: usize, field: &str) -> String {
    format!("float64[{count}] {field}\n")
}

/// A line for each element.
fn elements(signals: &[SignalInfo], count: usize) -> String {
    let mut names: Vec<String> = Vec::with_capacity(signals.len());
    for signal in signals {
        let mut name = field_name(&signal.name);
        while name == UNUSED || names.contains(&name) {
            name.push('_');
        }
        names.push(name);
    }
    let mut text: String = names.iter().map(|name| format!("float64 {name}\n")).collect();
    if count > signals.len() {
        text += &format!("float64[{}] {UNUSED}\n", count - signals.len());
    }
    text
}

/// A name that is valid in message syntax: letters, digits and `_`, a letter first.
fn field_name(name: &str) -> String {
    let plain = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    let begins = name.starts_with(|c: char| c.is_ascii_alphabetic());
    if begins { plain.collect() } else { "s".chars().chain(plain).collect() }
}

/// The schema without the names of a vehicle, as in [`Message::SCHEMA`]. A schema of another kind is unchanged.
pub(crate) fn without_names(schema: &str) -> String {
    let mut own = String::new();
    let mut counts = BTreeMap::new();
    let mut current = None;
    let mut rule = None;
    for line in schema.split_inclusive('\n') {
        if line.starts_with("===") {
            rule = Some(line);
            continue;
        }
        if let Some(rule) = rule.take() {
            current = line.trim().strip_prefix("MSG: ").and_then(|name| name.strip_prefix(PACKAGE));
            current = current.filter(|name| TYPES.iter().any(|(_, known)| known == name));
            if current.is_some() {
                continue;
            }
            own += rule;
        }
        match current {
            None => own += line,
            Some(name) => *counts.entry(name).or_insert(0) += elements_of(line),
        }
    }
    let lines = own.split_inclusive('\n').map(|line| {
        let (of, field) = line.trim().split_once(' ').unwrap_or_default();
        counts.get(of).map_or_else(|| line.to_string(), |count| array(*count, field))
    });
    lines.collect()
}

/// Number of array elements that a line stands for.
fn elements_of(line: &str) -> usize {
    let of = line.split_whitespace().next().unwrap_or_default();
    match of.strip_prefix("float64[").and_then(|rest| rest.strip_suffix(']')) {
        Some(count) => count.parse().unwrap_or(0),
        None => usize::from(of == "float64"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use whirlstand_msgs::{Autopilot, Command, Imu, Outputs, Setpoint, Truth};

    fn signals(names: &[String]) -> Vec<SignalInfo> {
        names.iter().map(|name| SignalInfo::new(name.as_str(), "rad")).collect()
    }

    fn info(states: &[String]) -> BenchInfo {
        BenchInfo { states: signals(states), inputs: signals(&["u_roll".into()]), ..BenchInfo::default() }
    }

    #[test]
    fn elements_have_the_names_of_the_vehicle() {
        let info =
            info(&["roll".into(), "roll rate".into(), "2nd".into(), "roll-rate".into(), "unused".into()]);
        let text = named_schema::<Setpoint>(&info);
        assert!(
            text.starts_with("Head head\nVehicleStates x\nVehicleInputs stick\nuint64 tracked\n===="),
            "{text}"
        );
        let states = "MSG: whirlstand/VehicleStates\nfloat64 roll\nfloat64 roll_rate\nfloat64 s2nd\nfloat64 roll_rate_\n\
                      float64 unused_\nfloat64[11] unused\n";
        assert!(text.ends_with(states), "{text}");
        assert!(
            text.contains("MSG: whirlstand/VehicleInputs\nfloat64 u_roll\nfloat64[7] unused\n"),
            "{text}"
        );
        assert_eq!(named_schema::<Imu>(&info), Imu::SCHEMA);
        assert_eq!(named_schema::<Outputs>(&info), Outputs::SCHEMA, "no output has a name here");
        assert_eq!(named_schema::<Autopilot>(&info), Autopilot::SCHEMA, "its outputs are not the vehicle's");
    }

    proptest! {
        #[test]
        fn names_do_not_change_the_layout(states in proptest::collection::vec("[a-zäµ0-9_.-]{1,9}", 0..20)) {
            let info = info(&states);
            prop_assert_eq!(without_names(&named_schema::<Truth>(&info)), Truth::SCHEMA);
            prop_assert_eq!(without_names(&named_schema::<Command>(&info)), Command::SCHEMA);
        }

        #[test]
        fn other_schemas_are_no_message_of_ours(text in "(=== *\n|MSG: whirlstand/VehicleStates\n|float64(\\[9{1,30}\\])? x\n|.*\n){0,9}") {
            prop_assert_ne!(without_names(&text), Truth::SCHEMA);
        }
    }
}
