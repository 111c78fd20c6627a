//! Causes that are found and may be something else: values at the end of their range, and factors that are ratios of units.

use whirlstand_logs::shown::number;
use whirlstand_vehicle::Kind;

use crate::answer::schema::Cause;
use crate::stages::findings::Findings;
use crate::thresholds::{AT_LIMIT_SHARE, CHANCE_FACTOR_SHARE, GREATEST_PHYSICAL_FACTOR, UNIT_RATIOS};

/// What speaks against taking the causes for the explanation, in sentences.
pub(crate) fn doubts(causes: &[Cause], findings: &Findings<'_>) -> Vec<String> {
    let selection = &findings.residual.selection;
    let mut doubts = Vec::new();
    for (term, candidate) in selection.model.terms.iter().enumerate() {
        let values = &selection.fit.values[selection.model.range(term)];
        for (tunable, value) in candidate.tunables.iter().zip(values).filter(|(t, _)| t.size) {
            let near = AT_LIMIT_SHARE * (tunable.upper - tunable.lower);
            let end = [tunable.lower, tunable.upper].into_iter().find(|end| (value - end).abs() < near);
            // Nothing at all is the natural end of a size: there, the effect is not named.
            if let Some(end) = end.filter(|end| *end != candidate.null) {
                doubts.push(format!(
                    "{} of {} on {} ends at the limit of what it may be, {}: the record asks for more than this effect can be",
                    tunable.name,
                    candidate.kind.name(),
                    candidate.place,
                    number(end)
                ));
            }
        }
    }
    doubts.extend(causes.iter().filter_map(unit));
    doubts
}

/// That a factor is the ratio of two units.
fn unit(cause: &Cause) -> Option<String> {
    let scale = [Kind::InputGain, Kind::SensorScale].iter().any(|k| k.name() == cause.effect);
    let factor = cause.parameters.get("factor").filter(|_| scale)?;
    let close = factor.high - factor.low < CHANCE_FACTOR_SHARE * GREATEST_PHYSICAL_FACTOR;
    let narrow = factor.low > GREATEST_PHYSICAL_FACTOR || close && factor.low > 0.0;
    let ratio =
        UNIT_RATIOS.iter().flat_map(|r| [*r, 1.0 / r]).find(|r| factor.low < *r && *r < factor.high)?;
    narrow.then(|| {
        format!(
            "the factor of {} on {} is the ratio of two units, {}: check in which unit the column was recorded, and write it into the head or the mapping",
            cause.effect,
            cause.place,
            number(ratio)
        )
    })
}
