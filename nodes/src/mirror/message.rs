//! Converts findings of the mirror to messages.

use whirlstand_mirror::{Finding as Found, Stage};
use whirlstand_msgs::{Finding, FindingStage, MAX_PARAMETERS, Message, text_field};
use whirlstand_vehicle::Vehicle;

/// The message of a finding, without its head.
pub(super) fn message(found: &Found, vehicle: &Vehicle, period_ns: u64) -> Finding {
    let stage = match found.stage {
        Stage::Wrong => FindingStage::Wrong,
        Stage::Named => FindingStage::Named,
        Stage::Revised => FindingStage::Revised,
        Stage::Withdrawn => FindingStage::Withdrawn,
        Stage::Over => FindingStage::Over,
    };
    let mut finding = Finding {
        number: found.number,
        since_ns: found.since * period_ns,
        evidence: found.evidence,
        stage: stage as u32,
        output: found.output as u32,
        ..Finding::zeroed()
    };
    let Some(cause) = &found.cause else { return finding };
    let effect = &cause.effect;
    let place = effect.place();
    let (first, second) = place.split_once("->").or_else(|| place.split_once(',')).unwrap_or((place, ""));
    // A matrix entry contains a comma as well.
    let (first, second) = if place.contains('[') { (place, "") } else { (first, second) };
    finding.effect = text_field(effect.kind().name());
    finding.place = text_field(first);
    finding.onto = text_field(effect.text().unwrap_or(second));
    finding.probability = cause.probability;
    let values = &cause.values[..cause.values.len().min(MAX_PARAMETERS)];
    finding.count = values.len() as u32;
    for (i, v) in values.iter().enumerate() {
        (finding.value[i], finding.low[i], finding.high[i]) = (v.value, v.low, v.high);
    }
    let unit = |name: &str| effect.unit(name, vehicle).map_or(String::new(), |u| u.si_symbol());
    let joined = |texts: Vec<String>| text_field(&texts.join(","));
    finding.names = joined(values.iter().map(|v| v.name.to_string()).collect());
    finding.units = joined(values.iter().map(|v| unit(v.name)).collect());
    finding.alike = cause.indistinguishable.len() as u32;
    if let Some((kind, place)) = cause.indistinguishable.first() {
        (finding.alike_effect, finding.alike_place) = (text_field(kind.name()), text_field(place));
    }
    finding
}
