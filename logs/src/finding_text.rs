//! A finding of the mirror as a sentence.

use whirlstand_msgs::units::{ShownSignals, ShownUnit};
use whirlstand_msgs::{Finding, FindingStage, text_of};

use crate::shown::number;

/// The sentence. `outputs` are the names of the vehicle's outputs, `units` are the units in which its signals are
/// shown. `None` for a stage that this version does not know.
pub fn finding_text(finding: &Finding, outputs: &[&str], units: &ShownSignals) -> Option<String> {
    let cause = |finding| cause(finding, units);
    let since = format!("since {:.2} s", finding.since_ns as f64 * 1e-9);
    let output = outputs.get(finding.output as usize).copied().unwrap_or("an output");
    Some(match FindingStage::from_u32(finding.stage)? {
        FindingStage::Wrong => {
            format!("the prediction of {output} has been wrong {since}; looking for the cause")
        }
        FindingStage::Named => format!("{since}: {}", cause(finding)),
        FindingStage::Revised => format!("{since}, revised: {}", cause(finding)),
        FindingStage::Withdrawn => {
            format!("previous finding withdrawn; the prediction of {output} has been wrong {since}")
        }
        FindingStage::Over => "prediction is right again".into(),
        FindingStage::Law if finding.evidence > 0.0 => {
            let cost = number(finding.evidence);
            format!("switched to the law for {}; its cost is {cost} of the previous one's", cause(finding))
        }
        FindingStage::Law => {
            format!("switched to the law for {}; the previous one is lost", cause(finding))
        }
        FindingStage::FirstLaw => "switched back to the first law".into(),
    })
}

fn cause(finding: &Finding, units: &ShownSignals) -> String {
    let place_unit = units.of(text_of(&finding.place));
    let (place, onto) = (text_of(&finding.place), text_of(&finding.onto));
    let place = match (text_of(&finding.effect), onto) {
        ("mode_transition", to) => format!("to {to}"),
        (_, "") => format!("on {place}"),
        ("misalignment", other) => format!("of {place},{other}"),
        (_, onto) => format!("on {place}->{onto}"),
    };
    let mut text = format!("{} {place}", text_of(&finding.effect));
    let names = text_of(&finding.names).split(',');
    let units = text_of(&finding.units).split(',').chain(std::iter::repeat(""));
    for (i, (name, si)) in
        names.zip(units).enumerate().take((finding.count as usize).min(finding.value.len()))
    {
        let unit = parameter_unit(name, si, place_unit.as_ref());
        let [value, low, high] =
            [finding.value[i], finding.low[i], finding.high[i]].map(|v| number(v * unit.factor()));
        let unit = if unit.symbol().is_empty() { String::new() } else { format!(" {unit}") };
        text.push_str(if i == 0 { ": " } else { ", " });
        text.push_str(&format!("{name} {value}{unit} ({low} to {high}{unit})"));
    }
    if finding.alike > 0 {
        let other = format!("{} on {}", text_of(&finding.alike_effect), text_of(&finding.alike_place));
        text.push_str(&match finding.alike {
            1 => format!("; or {other}, which cannot be distinguished"),
            more => format!("; or {other} or {} more, which cannot be distinguished", more - 1),
        });
    }
    text
}

/// The unit in which a parameter with the SI unit `si` is shown: that of the signal or matrix entry at `place`, or
/// of its derivative, where the parameter has that unit; else one that the parameter's name implies; else the
/// default for values that no file declares.
fn parameter_unit(name: &str, si: &str, place: Option<&ShownUnit>) -> ShownUnit {
    if name.ends_with("_rad") {
        return ShownUnit::si(si);
    }
    let own = place.into_iter().flat_map(|unit| [unit.clone(), unit.per_second()]);
    own.into_iter().find(|unit| unit.si_symbol() == si).unwrap_or_else(|| ShownUnit::of(si))
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::{Message, text_field};

    #[test]
    fn a_finding_is_told_with_its_interval_and_what_looks_the_same() {
        let mut finding = Finding { stage: 1, since_ns: 12_300_000_000, output: 1, ..Finding::zeroed() };
        let text = |f: &Finding| finding_text(f, &["roll", "roll_rate"], &ShownSignals::default());
        assert_eq!(
            text(&finding).unwrap(),
            "the prediction of roll_rate has been wrong since 12.30 s; looking for the cause"
        );
        finding.stage = FindingStage::Named as u32;
        (finding.effect, finding.place) = (text_field("sensor_bias"), text_field("roll_rate"));
        (finding.names, finding.units, finding.count) = (text_field("offset"), text_field("rad/s"), 1);
        (finding.value[0], finding.low[0], finding.high[0]) = (0.01, 0.009, 0.011);
        (finding.alike, finding.alike_effect, finding.alike_place) =
            (1, text_field("input_bias"), text_field("u_roll"));
        assert_eq!(
            text(&finding).unwrap(),
            "since 12.30 s: sensor_bias on roll_rate: offset 0.573 deg/s (0.516 to 0.630 deg/s); or input_bias on u_roll, \
             which cannot be distinguished"
        );
        finding.alike = 0;
        (finding.stage, finding.evidence) = (FindingStage::Law as u32, 0.62);
        assert_eq!(
            text(&finding).unwrap(),
            "switched to the law for sensor_bias on roll_rate: offset 0.573 deg/s (0.516 to 0.630 deg/s); its cost is \
             0.620 of the previous one's"
        );
        finding.stage = FindingStage::FirstLaw as u32;
        assert_eq!(text(&finding).unwrap(), "switched back to the first law");
        finding.stage = 9;
        assert_eq!(text(&finding), None);
    }

    #[test]
    fn an_entry_is_told_in_the_units_that_the_vehicle_declares() {
        let named = |names: [&str; 2], units: [&str; 2]| {
            let unit = |unit: &str| ShownUnit::declared(&unit.parse().unwrap(), unit);
            names.into_iter().map(str::to_string).zip(units.map(unit)).collect::<Vec<_>>()
        };
        let mut finding = Finding { stage: FindingStage::Named as u32, count: 1, ..Finding::zeroed() };
        (finding.effect, finding.place) = (text_field("parameter_change"), text_field("B[2,1]"));
        (finding.names, finding.units) = (text_field("value"), text_field("rad/s^2"));
        (finding.value[0], finding.low[0], finding.high[0]) = (0.5, 0.4, 0.6);
        for (rate, told) in
            [("rad/s", "0.500 rad/s^2"), ("deg/s", "28.6 deg/s^2"), ("mrad/s", "500 mrad/s^2")]
        {
            let states = named(["roll", "roll_rate"], ["rad", rate]);
            let units = ShownSignals::new(states, named(["u", "v"], ["1", "V"]), []);
            let text = finding_text(&finding, &["roll"], &units).unwrap();
            assert!(text.contains(&format!("parameter_change on B[2,1]: value {told} (")), "{text}");
        }
    }
}
