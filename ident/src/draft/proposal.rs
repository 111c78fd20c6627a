//! Proposes which signals of a log are inputs and outputs, by name and by unit.

use super::controls;
use super::error::DraftError;
use super::names::{bare, last_part, valid_name, vehicle_name};
use super::presets::{FAMILIES, Family, Known, NONLINEAR_INPUTS};

/// A signal in a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Offered {
    /// Name in the log.
    pub name: String,
    /// Unit that the log states, if any.
    pub unit: Option<String>,
    /// Samples per second, where the log keeps every topic on a clock of its own.
    pub rate_hz: Option<f64>,
    /// Largest absolute value, in the stated unit, of a column of a table.
    pub largest: Option<f64>,
}

/// A chosen signal.
#[derive(Debug, Clone, PartialEq)]
pub struct Chosen {
    /// Name in the vehicle.
    pub name: String,
    /// Name in the log, with a unit where the log states none, in the syntax of `--map`.
    pub source: String,
    /// Time between two samples where the log keeps every topic on a clock of its own, s.
    pub interval_s: Option<f64>,
    /// Reason for the choice, as the end of a sentence.
    pub why: String,
}

/// Signals proposed for a log.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Proposal {
    /// Groups of inputs, those closest to the actuators first.
    pub inputs: Vec<Vec<Chosen>>,
    /// Outputs.
    pub outputs: Vec<Chosen>,
    /// Motor commands.
    pub motors: Vec<Chosen>,
    /// Rates in whose place their angles are outputs, as the inputs do not explain them.
    pub unexplained: Vec<Chosen>,
}

/// Signals chosen by the user: `SIGNAL[unit]` or `NAME=SIGNAL[unit]`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Choice {
    /// Inputs; the known ones when empty.
    pub inputs: Vec<String>,
    /// Outputs; the known ones when empty.
    pub outputs: Vec<String>,
}

/// Lowest rate of a topic of motion: slower topics report states of the system.
const SLOWEST_TOPIC_HZ: f64 = 2.0;

/// Description of an input, for users who have to choose one.
const INPUT_HINT: &str = "Inputs are control signals: motor commands, torques or rate setpoints";
/// Description of an output, for users who have to choose one.
const OUTPUT_HINT: &str = "An output is a rate, an angle, an acceleration or a speed in body axes; positions and quaternions are not supported, since a linear model of the motors does not produce them: convert them to rates first";

/// Proposes inputs and outputs. `clocks` is true when every topic of the log has a clock of its own, in which
/// case the reader holds signals whose name begins with `u_`.
///
/// # Errors
/// [`DraftError::NoSignal`] and [`DraftError::Choice`].
pub fn propose(
    log: &str,
    offered: &[Offered],
    clocks: bool,
    choice: &Choice,
) -> Result<Proposal, DraftError> {
    let family = family(offered);
    let mut proposal = Proposal::default();
    let by_hand = |texts: &[String], flag, held| {
        texts.iter().map(|text| chosen_by_hand(text, flag, offered, held)).collect::<Result<Vec<_>, _>>()
    };
    if choice.inputs.is_empty() {
        proposal.inputs = family.map_or(Vec::new(), |family| known_inputs(family, offered));
        if proposal.inputs.is_empty() {
            proposal.inputs = steering(offered, clocks);
        }
    } else {
        proposal.inputs = vec![by_hand(&choice.inputs, "--input", clocks)?];
    }
    if choice.outputs.is_empty() {
        proposal.outputs = family.map_or(Vec::new(), |family| known_outputs(family, offered));
        if proposal.outputs.is_empty() {
            let first = proposal.inputs.iter().find(|group| !group.is_empty());
            let inputs: Vec<&str> = first.into_iter().flatten().map(|c| bare(&c.source)).collect();
            proposal.outputs = rates(offered, &inputs);
        }
    } else {
        proposal.outputs = by_hand(&choice.outputs, "--measure", false)?;
    }
    proposal.motors = family.map_or(Vec::new(), |family| motors(family, offered));
    let Proposal { inputs, outputs, .. } = &mut proposal;
    let is_output = |input: &Chosen| outputs.iter().any(|output| bare(&output.source) == bare(&input.source));
    if choice.inputs.is_empty() {
        inputs.iter_mut().for_each(|group| group.retain(|input| !is_output(input)));
    }
    inputs.retain(|group| !group.is_empty());
    let missing = |what, flag, hint| DraftError::NoSignal { log: log.into(), what, flag, hint };
    if proposal.outputs.is_empty() {
        return Err(missing("an output", "--measure", OUTPUT_HINT));
    }
    if proposal.inputs.is_empty() {
        return Err(missing("an input", "--input", INPUT_HINT));
    }
    distinct(&mut proposal);
    Ok(proposal)
}

/// The program whose signal names the log has: the one with the most outputs in it.
fn family(offered: &[Offered]) -> Option<&'static Family> {
    let found = |family: &Family| known_outputs(family, offered).len();
    // The first of several equal ones: max_by_key returns the last.
    FAMILIES.iter().rev().max_by_key(|family| found(family)).filter(|family| found(family) > 0)
}

/// The signal in the log that a known name matches.
fn find<'o>((name, _): &Known, offered: &'o [Offered]) -> Option<&'o Offered> {
    offered.iter().find(|o| match name.strip_prefix('*') {
        Some(ending) => o.name.ends_with(ending),
        None => o.name == *name,
    })
}

fn known(name: &str, (_, unit): &Known, signal: &Offered, family: &Family) -> Chosen {
    let stated = signal.unit.as_deref().is_some_and(|u| !u.is_empty());
    let source =
        if stated || unit.is_empty() { signal.name.clone() } else { format!("{}[{unit}]", signal.name) };
    let nonlinear = NONLINEAR_INPUTS.iter().find(|(name, _)| signal.name.starts_with(name));
    let remark = nonlinear.map_or(String::new(), |(_, why)| format!("; {why}"));
    Chosen {
        name: name.into(),
        source,
        interval_s: signal.rate_hz.map(|rate| 1.0 / rate),
        why: format!("recognised by name ({}){remark}", family.name),
    }
}

fn alive(signal: &Offered) -> bool {
    signal.rate_hz.is_none_or(|rate| rate >= SLOWEST_TOPIC_HZ)
}

fn known_inputs(family: &Family, offered: &[Offered]) -> Vec<Vec<Chosen>> {
    let group = |group: &&[(&str, Known)]| {
        let mut chosen: Vec<Chosen> = Vec::new();
        for (name, source) in group.iter() {
            if let Some(signal) = find(source, offered).filter(|s| alive(s))
                && !chosen.iter().any(|c| c.name == *name)
            {
                chosen.push(known(name, source, signal, family));
            }
        }
        chosen
    };
    family.inputs.iter().map(group).filter(|group| !group.is_empty()).collect()
}

fn known_outputs(family: &Family, offered: &[Offered]) -> Vec<Chosen> {
    let mut all: Vec<Chosen> = Vec::new();
    for (name, sources) in family.outputs {
        let there: Vec<(&Known, &Offered)> =
            sources.iter().filter_map(|s| Some((s, find(s, offered).filter(|o| alive(o))?))).collect();
        let fastest = there.iter().filter_map(|(_, o)| o.rate_hz).fold(0.0, f64::max);
        // The first known name, unless another is logged more than twice as often.
        let best = there.iter().find(|(_, o)| o.rate_hz.is_none_or(|rate| rate >= 0.5 * fastest));
        all.extend(best.map(|(source, signal)| known(name, source, signal, family)));
    }
    // One output suffices for the vertical axis.
    if all.iter().any(|c| c.name == "vertical_acceleration") {
        all.retain(|c| c.name != "vertical_speed");
    }
    all
}

fn motors(family: &Family, offered: &[Offered]) -> Vec<Chosen> {
    let signals = family.motors.iter().filter_map(|m| find(&(m, ""), offered).filter(|o| alive(o)));
    signals.enumerate().map(|(i, s)| known(&format!("motor_{}", i + 1), &("", ""), s, family)).collect()
}

/// Groups of signals with names of control signals, each signal in the first that its name fits; references of loops last.
fn steering(offered: &[Offered], clocks: bool) -> Vec<Vec<Chosen>> {
    let group = |o: &Offered| controls::group(last_part(&o.name), o.unit.as_deref());
    let chosen = |o: &Offered| Chosen {
        name: vehicle_name(&o.name, clocks),
        source: o.name.clone(),
        interval_s: o.rate_hz.map(|rate| 1.0 / rate),
        why: "named like a control signal".into(),
    };
    let of =
        |index: usize| offered.iter().filter(|o| alive(o) && group(o) == Some(index)).map(chosen).collect();
    (0..controls::GROUPS).map(of).collect()
}

/// Signals in a unit of angular rate.
fn rates(offered: &[Offered], inputs: &[&str]) -> Vec<Chosen> {
    let turns = |o: &&Offered| matches!(o.unit.as_deref(), Some("rad/s" | "deg/s" | "1/s*rad"));
    let chosen = |o: &Offered| Chosen {
        name: valid_name(last_part(&o.name)),
        source: o.name.clone(),
        interval_s: o.rate_hz.map(|rate| 1.0 / rate),
        why: "an angular rate, from its unit".into(),
    };
    let free = offered.iter().filter(|o| alive(o) && !inputs.contains(&o.name.as_str()));
    free.filter(turns).map(chosen).collect()
}

fn chosen_by_hand(
    text: &str,
    flag: &'static str,
    offered: &[Offered],
    held: bool,
) -> Result<Chosen, DraftError> {
    let wrong = |reason: String| DraftError::Choice { flag, text: text.into(), reason };
    let (name, source) = match text.split_once('=') {
        Some((name, source)) => (Some(name.trim()), source.trim()),
        None => (None, text.trim()),
    };
    let plain = source.strip_prefix('-').unwrap_or(source);
    let signal = offered.iter().find(|o| o.name == plain || o.name == bare(plain)).ok_or_else(|| {
        let names: Vec<&str> = offered.iter().map(|o| o.name.as_str()).collect();
        wrong(format!("the log has no signal '{}'. It has: {}", bare(plain), names.join(", ")))
    })?;
    let name = name.map_or_else(|| vehicle_name(&signal.name, held), String::from);
    if name.is_empty() || valid_name(&name) != name {
        return Err(wrong(format!(
            "'{name}' is not a name: write NAME=SIGNAL with letters, digits, '_', '-' and '.'"
        )));
    }
    if held && !name.starts_with("u_") {
        let reason = format!(
            "in logs with several topics the name of an input must begin with u_, so that it is held between samples: write u_{name}={source}"
        );
        return Err(wrong(reason));
    }
    Ok(Chosen {
        name,
        source: source.into(),
        interval_s: signal.rate_hz.map(|rate| 1.0 / rate),
        why: format!("chosen with {flag}"),
    })
}

/// Numbers names that occur twice.
fn distinct(proposal: &mut Proposal) {
    let Proposal { inputs, outputs, .. } = proposal;
    for group in inputs {
        let mut seen: Vec<String> = Vec::new();
        for chosen in group.iter_mut().chain(outputs.iter_mut()) {
            let own = chosen.name.clone();
            let mut count = 2;
            while seen.contains(&chosen.name) {
                chosen.name = format!("{own}_{count}");
                count += 1;
            }
            seen.push(chosen.name.clone());
        }
    }
}

impl Proposal {
    /// The same with angles in place of their rates; `None` where no rate has its angle.
    pub fn with_angles(&self) -> Option<Self> {
        let angle = |rate: &Chosen| self.outputs.iter().any(|o| is_integral(&o.name, &rate.name));
        let (unexplained, outputs): (Vec<_>, Vec<_>) = self.outputs.iter().cloned().partition(angle);
        (!unexplained.is_empty()).then(|| Self { outputs, unexplained, ..self.clone() })
    }
}

/// True where the names of two outputs say that the first is the integral of the second: `roll` or `roll_angle` of
/// `roll_rate`.
pub fn is_integral(angle: &str, rate: &str) -> bool {
    let stem = rate.strip_suffix("_rate");
    stem.is_some_and(|stem| angle == stem || angle.strip_suffix("_angle") == Some(stem))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offered(signals: &[(&str, &str, f64)]) -> Vec<Offered> {
        let one = |&(name, unit, rate): &(&str, &str, f64)| Offered {
            name: name.into(),
            unit: (!unit.is_empty()).then(|| unit.into()),
            rate_hz: (rate > 0.0).then_some(rate),
            largest: None,
        };
        signals.iter().map(one).collect()
    }

    fn pairs(chosen: &[Chosen]) -> Vec<(&str, &str)> {
        chosen.iter().map(|c| (c.name.as_str(), c.source.as_str())).collect()
    }

    #[test]
    fn names_say_which_angle_is_the_integral_of_which_rate() {
        for (angle, rate) in [("roll", "roll_rate"), ("body", "body_rate"), ("arm_2_angle", "arm_2_rate")] {
            assert!(is_integral(angle, rate) && !is_integral(rate, angle) && !is_integral(rate, rate));
        }
        assert!(!is_integral("pitch", "roll_rate") && !is_integral("roll", "roll"));
    }

    #[test]
    fn signals_of_px4_are_known_and_the_faster_topic_is_taken() {
        let log = offered(&[
            ("actuator_controls_0.control[0]", "", 250.0),
            ("vehicle_rates_setpoint.roll", "", 250.0),
            ("sensor_combined.gyro_rad[0]", "", 9.6),
            ("vehicle_attitude.rollspeed", "", 31.0),
            ("sensor_gyro.x", "", 1.0),
        ]);
        let found = propose("x.ulg", &log, true, &Choice::default()).unwrap();
        assert_eq!(pairs(&found.inputs[0]), [("u_roll", "actuator_controls_0.control[0]")]);
        assert_eq!(pairs(&found.inputs[1]), [("u_roll", "vehicle_rates_setpoint.roll[rad/s]")]);
        assert_eq!(pairs(&found.outputs), [("roll_rate", "vehicle_attitude.rollspeed[rad/s]")]);
    }

    #[test]
    fn a_stated_unit_is_kept_and_a_missing_one_comes_from_the_format() {
        let log = offered(&[
            ("main.setpoint[0]", "deg/s", 1000.0),
            ("main.gyroADC[0]", "deg/s", 1000.0),
            ("main.motor[0]", "", 1000.0),
        ]);
        let found = propose("x.bbl", &log, true, &Choice::default()).unwrap();
        assert_eq!(pairs(&found.inputs[0]), [("u_roll", "main.setpoint[0]")]);
        assert_eq!(pairs(&found.outputs), [("roll_rate", "main.gyroADC[0]")]);
        assert_eq!(found.motors.len(), 1);
        let flow = offered(&[("gyro.x", "", 0.0), ("controller.cmd_roll", "", 0.0)]);
        let found = propose("x.csv", &flow, false, &Choice::default()).unwrap();
        assert_eq!(pairs(&found.outputs), [("roll_rate", "gyro.x[deg/s]")]);
    }

    #[test]
    fn unknown_columns_are_told_by_unit_and_by_what_they_are_called() {
        let log =
            offered(&[("in_lat", "", 0.0), ("cmdtail", "", 0.0), ("wx", "rad/s", 0.0), ("h", "m", 0.0)]);
        let found = propose("x.csv", &log, false, &Choice::default()).unwrap();
        assert_eq!(pairs(&found.inputs[0]), [("in_lat", "in_lat"), ("cmdtail", "cmdtail")]);
        assert_eq!(pairs(&found.outputs), [("wx", "wx")]);
    }

    #[test]
    fn names_of_actuators_are_known_as_words() {
        let log = offered(&[
            ("roll_cmd", "", 0.0),
            ("motor1", "", 0.0),
            ("pwmFL", "us", 0.0),
            ("u2", "", 0.0),
            ("motor_current", "A", 0.0),
            ("u", "m/s", 0.0),
            ("resp", "", 0.0),
            ("roll_rate", "rad/s", 0.0),
        ]);
        let found = propose("x.csv", &log, false, &Choice::default()).unwrap();
        let groups: Vec<_> = found.inputs.iter().map(|group| pairs(group)).collect();
        assert_eq!(groups[0], [("u2", "u2")]);
        assert_eq!(groups[1], [("roll_cmd", "roll_cmd")]);
        assert_eq!(groups[2], [("motor1", "motor1"), ("pwmFL", "pwmFL")]);
    }

    #[test]
    fn a_choice_by_hand_goes_before_what_is_known() {
        let log = offered(&[("a.b[3]", "", 50.0), ("gyro.x", "", 50.0), ("y", "", 50.0)]);
        let by_hand = |input: &str, output: &str| {
            let choice = Choice { inputs: vec![input.into()], outputs: vec![output.into()] };
            propose("x", &log, true, &choice)
        };
        let found = by_hand("a.b[3]", "rate=y[deg/s]").unwrap();
        assert_eq!(pairs(&found.inputs[0]), [("u_b_3", "a.b[3]")]);
        assert_eq!(pairs(&found.outputs), [("rate", "y[deg/s]")]);
        for (input, output, word) in
            [("nothing", "y", "has no signal"), ("tail=y", "y", "u_tail"), ("u x=y", "y", "not a name")]
        {
            let error = by_hand(input, output).unwrap_err().to_string();
            assert!(error.starts_with("--input") && error.contains(word), "{error}");
        }
    }

    #[test]
    fn what_is_missing_is_told() {
        let log = offered(&[("/cub1/pose.pose.position.x", "", 100.0), ("/cub1/joy.data[0]", "", 10.0)]);
        let error = propose("x.mcap", &log, true, &Choice::default()).unwrap_err().to_string();
        assert!(error.contains("--measure") && error.contains("quaternions"), "{error}");
        let error = propose("x.csv", &offered(&[("p", "", 0.0)]), false, &Choice::default()).unwrap_err();
        assert!(error.to_string().contains("as an input"), "{error}");
    }
}
