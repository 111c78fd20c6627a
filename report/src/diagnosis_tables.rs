//! The tables of a diagnosis.

use super::labels::with_unit;
use super::page::{Cell, Level, Row, Section, Table};
use whirlstand_diagnose::Diagnosis;
use whirlstand_diagnose::answer::{Cause, Estimate};
use whirlstand_logs::shown::{instant, number};

fn head(names: &[&str]) -> Vec<String> {
    names.iter().map(|n| (*n).to_string()).collect()
}

fn row(label: String, cells: Vec<Cell>) -> Row {
    Row { label, group: false, cells }
}

/// The causes found, with their evidence; `None` without causes.
pub(crate) fn causes(answer: &Diagnosis) -> Option<Section> {
    let names = ["cause", "value", "95 % from", "to", "BIC", "held out", "of the residual", "by chance"];
    let rows: Vec<Row> = answer.causes.iter().flat_map(cause).collect();
    let mut notes = Vec::new();
    for cause in &answer.causes {
        notes.extend(cause.notes.iter().map(|n| format!("{} on {}: {n}.", cause.effect, cause.place)));
        for other in &cause.indistinguishable {
            notes.push(format!(
                "{} on {} cannot be distinguished from {} on {} here (similarity of signatures {:.3}).",
                cause.effect, cause.place, other.effect, other.place, other.kappa
            ));
        }
    }
    (!rows.is_empty()).then(|| Section {
        title: "Causes".into(),
        text: "BIC: improvement over the model without the cause, penalised for its parameters; at least 10 is \
               required. Held out: improvement on held-out data, in standard errors; at least 2 is required. By \
               chance: p-value, corrected for the number of candidates tested."
            .into(),
        tables: vec![Table { head: head(&names), rows, note: notes.join(" "), ..Table::default() }],
        ..Section::default()
    })
}

/// Rows of a cause: one with the evidence, then one for every parameter.
fn cause(cause: &Cause) -> Vec<Row> {
    let e = &cause.evidence;
    let chance = if e.p_value < 1e-4 { "< 0.0001".into() } else { format!("{:.4}", e.p_value) };
    let evidence = [
        format!("{:+.0}", e.delta_bic),
        format!("{:+.1} σ", e.heldout_gain_sigma),
        format!("{:.0} %", 100.0 * e.share_of_residual),
        chance,
    ];
    let text = cause.text.clone().unwrap_or_default();
    let cells = [text, String::new(), String::new()].into_iter().chain(evidence).map(Cell::new).collect();
    let mut rows = vec![Row { label: format!("{} on {}", cause.effect, cause.place), group: true, cells }];
    rows.extend(cause.parameters.iter().map(|(name, Estimate { value, low, high, unit })| {
        let with_unit = |v: f64| if name == "at_s" { format!("{} s", instant(v)) } else { unit.text(v) };
        let ends =
            if low == high { ["given".into(), String::new()] } else { [with_unit(*low), with_unit(*high)] };
        let cells = std::iter::once(with_unit(*value)).chain(ends).map(Cell::new);
        row(name.clone(), cells.chain((0..4).map(|_| Cell::default())).collect())
    }));
    rows
}

/// The free parameters of the vehicle that were fitted anew; `None` where its values were kept.
pub(crate) fn refitted(answer: &Diagnosis) -> Option<Section> {
    let rows = answer.refitted.iter().map(|r| {
        row(
            r.parameter.clone(),
            vec![Cell::new(number(r.given)), Cell::new(number(r.value)), Cell::new(r.unit.clone())],
        )
    });
    (!answer.refitted.is_empty()).then(|| Section {
        title: "Parameters fitted anew".into(),
        text: "The vehicle file says that these values are estimates: they were fitted to this record beside the causes. A value \
               that is far from the file's, beyond what its fit left open, is a change of the vehicle, or of the record's \
               columns."
            .into(),
        tables: vec![Table { head: head(&["parameter", "file", "this record", "unit"]), rows: rows.collect(), ..Table::default() }],
        ..Section::default()
    })
}

/// The gain in accuracy on held-out data.
pub(crate) fn gains(answer: &Diagnosis) -> Section {
    let ahead = format!("{} s", number(answer.heldout.horizon_s));
    let (ahead_before, ahead_after) = (format!("fit over {ahead} before, %"), String::from("after, %"));
    let names = [
        "output",
        "fit before, %",
        "fit after, %",
        &ahead_before,
        &ahead_after,
        "error before",
        "error after",
        "noise",
        "error / noise",
    ];
    let rows = answer.outputs.iter().map(|(name, o)| {
        let factor = o.unit.factor();
        let percent = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.1}"));
        let value = |v: Option<f64>| Cell::new(v.map_or("-".into(), |v| number(v * factor)));
        let errors = (o.rmse_before.or(o.horizon_rmse_before), o.rmse_after.or(o.horizon_rmse_after));
        let gained = match errors {
            (Some(before), Some(after)) if after < 0.98 * before => Level::Good,
            (Some(before), Some(after)) if after > 1.02 * before => Level::Bad,
            _ => Level::Neutral,
        };
        let ratio = errors.1.filter(|_| o.noise_floor > 0.0).map(|e| e / o.noise_floor);
        row(
            with_unit(name, o.unit.symbol()),
            vec![
                Cell::new(percent(o.fit_before)),
                Cell::leveled(percent(o.fit_after), gained),
                Cell::new(percent(o.horizon_fit_before)),
                Cell::leveled(percent(o.horizon_fit_after), gained),
                value(errors.0),
                value(errors.1),
                value(Some(o.noise_floor).filter(|floor| *floor > 0.0)),
                Cell::new(ratio.map_or("-".into(), |r| format!("{r:.2}"))),
            ],
        )
    });
    Section {
        title: "Improvement on held-out data".into(),
        text: format!(
            "{} to {} s, with the rest used for the fit: free runs where they are meaningful, and predictions over \
             {ahead}. Fit is 100 (1 - norm(residual) / norm(measured - its mean)). No model can do better than the \
             noise.",
            instant(answer.heldout.from_s),
            instant(answer.heldout.to_s)
        ),
        tables: vec![Table { head: head(&names), rows: rows.collect(), ..Table::default() }],
        ..Section::default()
    }
}

/// The candidates that were rejected, with reasons.
pub(crate) fn rejected(answer: &Diagnosis) -> Table {
    let rows = answer.rejected.iter().map(|r| {
        row(
            format!("{} on {}", r.effect, r.place),
            vec![Cell::new(format!("{:+.0}", r.delta_bic)), Cell::new(r.why.clone())],
        )
    });
    Table { head: head(&["rejected", "BIC", "why"]), rows: rows.collect(), ..Table::default() }
}

/// The effects that the record could not have shown.
pub(crate) fn not_testable(answer: &Diagnosis) -> Option<Section> {
    let rows: Vec<Row> = answer
        .not_testable
        .iter()
        .map(|n| row(format!("{} on {}", n.effect, n.place), vec![Cell::new(n.why.clone())]))
        .collect();
    (!rows.is_empty()).then(|| Section {
        title: "Not testable with this record".into(),
        text: "These effects may be present: this record could not have shown them.".into(),
        tables: vec![Table { head: head(&["effect", "why, and what to fly"]), rows, ..Table::default() }],
        ..Section::default()
    })
}
