//! Composes the answer: turns findings into figures and sentences.

use std::collections::BTreeMap;

use whirlstand_logs::shown::instant;
use whirlstand_vehicle::Vehicle;

use super::causes::causes;
use super::correlations::correlations;
use super::schema::*;
use super::unforeseen::unforeseen;
use super::{doubts, evidence, experiments, remainder};
use crate::candidates::Candidate;
use crate::data::record::Data;
use crate::model::optimum::ModelError;
use crate::model::predictor::gain_of_inputs;
use crate::residual::excess_noise::louder_than_declared;
use crate::residual::lack_of_fit::LackOfFit;
use crate::search::selection::Refused;
use crate::stages::check::Checked;
use crate::stages::findings::Findings;
use crate::thresholds::{EXPLAINED_SHARE, MIN_BIC_GAIN, REJECTED_TOLD};

fn empty_answer(checked: &Checked<'_>) -> Diagnosis {
    let loaded = checked.loaded;
    Diagnosis {
        schema: DIAGNOSIS_SCHEMA.into(),
        verdict: Verdict::Inconclusive,
        summary: String::new(),
        version: env!("CARGO_PKG_VERSION").into(),
        records: loaded.origins.clone(),
        partial: loaded.options.watch.is_stopped(),
        vehicle: loaded.vehicle.name.clone(),
        period_s: checked.data.period_s,
        causes: Vec::new(),
        correlations: Vec::new(),
        refitted: Vec::new(),
        rejected: Vec::new(),
        not_testable: Vec::new(),
        outputs: BTreeMap::new(),
        heldout: HeldOut::default(),
        unexplained: Unexplained::default(),
        data: checked.found.clone(),
        remarks: if loaded.options.watch.is_stopped() { vec![ENDED_EARLY.into()] } else { Vec::new() },
        advice: Vec::new(),
        extended_vehicle: None,
        extended: None,
        figures: Figures::default(),
    }
}

/// The answer when the given vehicle has no valid prediction of the record.
pub(crate) fn no_prediction(checked: &Checked<'_>, why: ModelError) -> Diagnosis {
    let mut answer = empty_answer(checked);
    let vehicle = &checked.loaded.vehicle.name;
    if answer.data.iter().any(|f| f.blocking) {
        answer.summary = summary(&answer);
        return answer;
    }
    answer.summary = match why {
        ModelError::Diverged => {
            format!("Inconclusive: the free run of {vehicle} over this record diverges.")
        }
        ModelError::Inapplicable | ModelError::NotDetermined => {
            format!("Inconclusive: {vehicle} cannot be fitted to this record: {why}.")
        }
    };
    answer.advice.push(format!(
        "Check the units of the inputs and the vehicle file (whirlstand compare shows both), or identify the vehicle from this record first: whirlstand identify {} --vehicle {vehicle}.",
        checked.data.origin
    ));
    answer
}

/// Composes the answer from all findings.
pub(crate) fn answer(mut findings: Findings<'_>) -> Diagnosis {
    let (data, vehicle) = (findings.baseline.data(), findings.baseline.vehicle());
    let mut answer = empty_answer(&findings.baseline.checked);
    answer.heldout = findings.gains.heldout;
    answer.outputs = outputs(&findings);
    answer.causes = causes(&findings);
    answer.correlations = correlations(&findings);
    // Beside columns that are wrong, the fit says nothing.
    if !answer.data.iter().any(|finding| finding.blocking) {
        answer.refitted = refitted(&findings);
    }
    answer.rejected = rejected(&findings, &answer.causes);
    answer.not_testable = experiments::not_testable(&findings, data, vehicle);
    answer.unexplained = remainder::unexplained(&findings, data, vehicle);
    answer.verdict = verdict(&answer, &findings, data, vehicle);
    let left = answer.verdict == Verdict::Unexplained && leaves_more_than_noise(&findings, data);
    if left && answer.unexplained.description.is_empty() {
        answer.unexplained.description = remainder::beside(&answer.outputs, answer.heldout.horizon_s);
    }
    if let Some(refused) = contested(&findings).filter(|_| answer.verdict == Verdict::Unexplained)
        && answer.unexplained.description.is_empty()
    {
        answer.unexplained.description = remainder::undecided(refused);
    }
    if answer.verdict == Verdict::Unexplained {
        let random = remainder::at_random(&findings.residual.random_forces);
        let parts = random.into_iter().chain(Some(std::mem::take(&mut answer.unexplained.description)));
        answer.unexplained.description = parts.filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ");
    }
    let mut doubts = doubts::doubts(&answer.causes, &findings);
    // Advice on extrapolation is only given for an explained or a consistent record.
    let claims = matches!(answer.verdict, Verdict::Explained | Verdict::Consistent);
    if let Some(unforeseen) = claims.then(|| unforeseen(&findings, answer.verdict)).flatten() {
        if answer.verdict == Verdict::Consistent {
            answer.verdict = Verdict::Unexplained;
            answer.unexplained.description = format!("{}.", unforeseen.replacen("held-out", "Held-out", 1));
        } else {
            doubts.push(unforeseen);
        }
    }
    if answer.verdict == Verdict::Explained && !doubts.is_empty() {
        answer.verdict = Verdict::PartlyExplained;
    }
    // An incomplete search cannot claim that the record is consistent or that a part stays unexplained.
    if answer.partial && matches!(answer.verdict, Verdict::Consistent | Verdict::Unexplained) {
        answer.verdict = Verdict::Inconclusive;
    }
    answer.remarks.extend(doubts);
    answer.advice = experiments::advice(&answer);
    answer.summary = summary(&answer);
    answer.figures = evidence::figures(&findings, &answer);
    answer.extended = findings.extended.take().filter(|_| !answer.causes.is_empty()).map(Box::new);
    answer
}

/// Adds what speaks against the causes of an answer as the explanation of the record.
pub(crate) fn doubt(answer: &mut Diagnosis, doubt: String) {
    if answer.verdict == Verdict::Explained {
        answer.verdict = Verdict::PartlyExplained;
    }
    answer.remarks.push(doubt);
    answer.advice = experiments::advice(answer);
    answer.summary = summary(answer);
}

/// The free parameters before and after the fit.
fn refitted(findings: &Findings<'_>) -> Vec<Refitted> {
    let vehicle = findings.baseline.vehicle();
    let model = &findings.residual.selection.model;
    let free = model.free.iter().zip(&findings.values[model.states()..]);
    free.map(|(free, value)| Refitted {
        parameter: vehicle.free_name(&free.target),
        given: vehicle.free_value(&free.target),
        value: *value,
        unit: vehicle.free_unit_si(&free.target),
    })
    .collect()
}

/// Fit and error of each output on the held-out part of the record, by output name.
fn outputs(findings: &Findings<'_>) -> BTreeMap<String, OutputGain> {
    let channels = findings.baseline.data().channels.iter().zip(&findings.gains.channels);
    let gain = channels.map(|(channel, gain)| {
        let output = &findings.baseline.vehicle().outputs[channel.output];
        let free_run = gain.free_run.unwrap_or_default();
        let figures = OutputGain {
            unit: output.unit.shown(),
            fit_before: free_run.0.fit,
            fit_after: free_run.1.fit,
            rmse_before: free_run.0.rmse,
            rmse_after: free_run.1.rmse,
            horizon_fit_before: gain.horizon.0.fit,
            horizon_fit_after: gain.horizon.1.fit,
            horizon_rmse_before: gain.horizon.0.rmse,
            horizon_rmse_after: gain.horizon.1.rmse,
            noise_floor: gain.floor,
            noise_model_share: gain.noise_model_share,
        };
        (output.name.clone(), figures)
    });
    gain.collect()
}

/// Effects that are not causes, largest gain first: refused by the search, withdrawn afterwards, and rivals.
fn rejected(findings: &Findings<'_>, causes: &[Cause]) -> Vec<Rejected> {
    let selection = &findings.residual.selection;
    let rejection = |candidate: &Candidate, delta_bic: f64, why: String| Rejected {
        effect: candidate.kind.name().into(),
        place: candidate.place.clone(),
        delta_bic,
        why,
    };
    let refused = selection.refused.iter().filter(|t| t.values.is_some()).take(REJECTED_TOLD);
    let mut all: Vec<Rejected> =
        refused.map(|t| rejection(&t.candidate, t.delta_bic, t.why.clone())).collect();
    let withheld = findings.residual.withheld.iter();
    all.extend(withheld.map(|w| rejection(&w.candidate, w.delta_bic, w.why.clone())));
    for rival in selection.accepted.iter().flat_map(|a| &a.rivals).filter(|r| !r.indistinguishable()) {
        let (effect, place) = (rival.candidate.kind.name(), &rival.candidate.place);
        let known = |e: &str, p: &str| e == effect && p == place;
        if all.iter().any(|r| known(&r.effect, &r.place)) || causes.iter().any(|c| known(&c.effect, &c.place))
        {
            continue;
        }
        let why = format!(
            "in place of the accepted cause it would lose {:.0} in BIC (similarity of signatures {:.2})",
            rival.gap, rival.kappa
        );
        all.push(rejection(&rival.candidate, -rival.gap, why));
    }
    all.sort_by(|a, b| b.delta_bic.total_cmp(&a.delta_bic));
    all.truncate(REJECTED_TOLD);
    all
}

fn verdict(answer: &Diagnosis, findings: &Findings<'_>, data: &Data, vehicle: &Vehicle) -> Verdict {
    if answer.data.iter().any(|f| f.blocking) && answer.causes.is_empty() {
        return Verdict::Inconclusive;
    }
    if !answer.causes.is_empty() {
        let all = answer.unexplained.share < EXPLAINED_SHARE && !lacks_fit(findings);
        return if all { Verdict::Explained } else { Verdict::PartlyExplained };
    }
    if leaves_more_than_noise(findings, data) || !findings.residual.random_forces.is_empty() {
        Verdict::Unexplained
    } else if answer.data.iter().any(|f| f.kind == "no_excitation" && f.blocking)
        || hardly_testable(findings, answer)
    {
        Verdict::Inconclusive
    } else if commands_tell_nothing(data, vehicle) || contested(findings).is_some() {
        Verdict::Unexplained
    } else {
        Verdict::Consistent
    }
}

/// A cause that was found, and that another contradicts which explains as much: neither is named, but the record is not
/// consistent either.
fn contested<'f>(findings: &'f Findings<'_>) -> Option<&'f Refused> {
    findings.residual.selection.refused.iter().find(|refused| refused.contested)
}

/// Remark on a partial answer.
const ENDED_EARLY: &str = "The search was ended early: these are the results up to that point.";

/// True when the final residual is significantly not noise.
fn lacks_fit(findings: &Findings<'_>) -> bool {
    findings.residual.lack.as_ref().is_some_and(LackOfFit::is_significant)
}

/// True when the final residual is not noise, exceeds the noise that the vehicle file declares, or correlates
/// with an input.
fn leaves_more_than_noise(findings: &Findings<'_>, data: &Data) -> bool {
    let fit = &findings.residual.selection.fit;
    let loud = !louder_than_declared(data, fit, &findings.baseline.sizes.noise).is_empty();
    loud || lacks_fit(findings) || remainder::structured(findings, data)
}

/// True when most effects of the table would not be detectable in this record.
fn hardly_testable(findings: &Findings<'_>, answer: &Diagnosis) -> bool {
    let weighed = findings.residual.selection.refused.len();
    let untestable: usize = answer.not_testable.iter().map(|n| n.effects).sum();
    2 * untestable > weighed && weighed > 0
}

/// True when the vehicle makes the record no more likely than the same vehicle without commands.
fn commands_tell_nothing(data: &Data, vehicle: &Vehicle) -> bool {
    let all: Vec<usize> = (0..data.m).collect();
    let nothing = |gain: f64| gain < MIN_BIC_GAIN;
    let filter = data.likeliest_filter.as_deref();
    gain_of_inputs(vehicle, data, &all).is_some_and(nothing)
        && filter.and_then(|filter| filter.gain_of_inputs(vehicle, data, &all)).is_none_or(nothing)
}

/// The verdict in one sentence. Of a search that was stopped early, that is said first.
fn summary(answer: &Diagnosis) -> String {
    let whole = whole_summary(answer);
    if answer.partial { format!("Partial, as the search was ended early. {whole}") } else { whole }
}

fn whole_summary(answer: &Diagnosis) -> String {
    let cause = |c: &Cause| {
        let mut parameters: Vec<String> = Vec::new();
        for (name, p) in c.parameters.iter().filter(|(n, _)| *n != "phase_rad") {
            parameters.push(interval(name, p));
        }
        let alike = match c.indistinguishable.first() {
            Some(l) => format!(", or {} on {}", l.effect, l.place),
            None => String::new(),
        };
        format!("{} on {}{alike}: {}", c.effect, c.place, parameters.join(", "))
    };
    let list: Vec<String> = answer.causes.iter().map(cause).collect();
    let blocking: Vec<&str> = answer.data.iter().filter(|f| f.blocking).map(|f| f.text.as_str()).collect();
    let left = 100.0 * answer.unexplained.share;
    match answer.verdict {
        Verdict::Consistent => {
            format!(
                "Consistent: no effect was found; the record matches {} within its noise.",
                answer.vehicle
            )
        }
        Verdict::Explained => format!("Explained by {}.", list.join("; and ")),
        Verdict::PartlyExplained => {
            let remains = (left >= 0.5).then(|| format!("{left:.0} % of the residual power remains"));
            let doubts = answer.remarks.iter().filter(|remark| *remark != ENDED_EARLY).cloned();
            let mut reasons: Vec<String> = remains.into_iter().chain(doubts).collect();
            if reasons.is_empty() {
                reasons.push("the remaining residual is small, but not noise".into());
            }
            format!("Partly explained by {}; {}.", list.join("; and "), reasons.join("; "))
        }
        Verdict::Unexplained if answer.unexplained.description.is_empty() => {
            let text = remainder::untold(&answer.vehicle, &answer.outputs, answer.heldout.horizon_s);
            format!("Unexplained: {text}.")
        }
        Verdict::Unexplained => {
            format!(
                "Unexplained: no effect of the table explains the record. {}",
                answer.unexplained.description
            )
        }
        Verdict::Inconclusive if !blocking.is_empty() => format!("Inconclusive: {}.", blocking.join("; ")),
        Verdict::Inconclusive if answer.partial => {
            let left = &answer.unexplained.description;
            let text = "Inconclusive: no effect had been found by then, and not all were tested.";
            if left.is_empty() { text.into() } else { format!("{text} {left}") }
        }
        Verdict::Inconclusive => {
            "Inconclusive: this record is not informative enough to show an effect.".into()
        }
    }
}

/// Text of a parameter with its interval and its unit.
fn interval(name: &str, p: &Estimate) -> String {
    let unit = p.unit.symbol();
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let number = |v: f64| if name == "at_s" { instant(v) } else { short(v * p.unit.factor()) };
    format!("{name} {}{unit} ({} to {}{unit})", number(p.value), number(p.low), number(p.high))
}

#[cfg(test)]
mod tests {
    use whirlstand_logs::shown::ShownUnit;

    use super::*;

    #[test]
    fn parameters_are_told_with_their_units() {
        let told = |name: &str, unit: &str, [value, low, high]: [f64; 3]| {
            let unit = if name.ends_with("_rad") { ShownUnit::si(unit) } else { ShownUnit::of(unit) };
            interval(name, &Estimate { value, low, high, unit })
        };
        assert_eq!(told("delay_s", "s", [0.0599, 0.059, 0.061]), "delay_s 0.0599 s (0.0590 to 0.0610 s)");
        assert_eq!(
            told("magnitude", "rad/s^2", [2.59, 2.55, 2.63]),
            "magnitude 148 deg/s^2 (146 to 151 deg/s^2)"
        );
        assert_eq!(
            told("at_s", "s", [1_690_000_012.34, 1_690_000_012.3, 1_690_000_012.38]),
            "at_s 1690000012.34 s (1690000012.30 to 1690000012.38 s)"
        );
        assert_eq!(told("factor", "", [0.8, 0.7, 0.9]), "factor 0.800 (0.700 to 0.900)");
        assert_eq!(
            told("angle_rad", "rad", [0.05, 0.04, 0.06]),
            "angle_rad 0.0500 rad (0.0400 to 0.0600 rad)"
        );
    }
}
