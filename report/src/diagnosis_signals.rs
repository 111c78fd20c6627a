//! The signals of a diagnosis: outputs, residuals, their spectra and correlations, and the evidence.

use super::correlation::correlation;
use super::labels::{density, with_unit};
use super::page::Section;
use super::plot::{Plot, Span, SpanKind, Style, Trace};
use whirlstand_diagnose::Diagnosis;
use whirlstand_diagnose::answer::{Axis, EvidenceCurve, OutputFigure};
use whirlstand_logs::spectrum::welch;

/// Indices of the colours: measured, given vehicle, extended vehicle.
const MEASURED: usize = 5;
const BEFORE: usize = 1;
const AFTER: usize = 0;

/// One output: measured and simulated signal, the residual, its spectrum, and its correlation with the
/// inputs.
pub(crate) fn output(answer: &Diagnosis, o: &OutputFigure) -> Section {
    let f = &answer.figures;
    let (factor, unit) = (o.unit.factor(), o.unit.symbol());
    let held = Span { from: answer.heldout.from_s, until: answer.heldout.to_s, kind: SpanKind::HeldOut };
    let id = |what: &str| format!("{what}-{}", o.name);
    let scaled = |v: &[f64]| v.iter().map(|v| v * factor).collect::<Vec<f64>>();
    let runs: Vec<(&str, usize, &[f64])> = [("before", BEFORE, &o.before), ("after", AFTER, &o.after)]
        .into_iter()
        .filter(|(_, _, values)| !values.is_empty())
        .map(|(name, colour, values)| (name, colour, values.as_slice()))
        .collect();
    let mut both = Plot::over_time(id("both"), "measured and simulated", unit);
    // A slow sensor has values at some steps only; lines connect them.
    let line = |name: &str, colour: usize, style: Style, values: &[f64]| {
        let (t, y): (Vec<f64>, Vec<f64>) = present(&f.t, values);
        Trace::new(name, colour, style, &t, &scaled(&y))
    };
    both.traces.push(line("measured", MEASURED, Style::Main, &o.measured));
    let mut error = Plot::over_time(id("residual"), "residual: measured - simulated", unit);
    for (name, colour, values) in &runs {
        both.traces.push(line(name, *colour, Style::Main, values));
        error.traces.push(line(name, *colour, Style::Main, &difference(&o.measured, values)));
    }
    for plot in [&mut both, &mut error] {
        plot.spans.push(held.clone());
    }
    let mut plots = vec![both, error, spectrum(answer, o, &runs, factor, unit)];
    plots.extend(correlations(answer, o, &runs));
    let figures = answer.outputs.get(&o.name);
    let percent = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.1} %"));
    let text = match figures {
        Some(g) if !o.after.is_empty() => {
            format!(
                "Held out: fit {} before, {} after.",
                percent(g.fit_before.or(g.horizon_fit_before)),
                percent(g.fit_after.or(g.horizon_fit_after))
            )
        }
        Some(g) => format!("Held out: fit {}.", percent(g.fit_before.or(g.horizon_fit_before))),
        None => String::new(),
    };
    Section { title: o.name.clone(), text, plots, columns: 2, ..Section::default() }
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// The values that are not missing, with their times; a gap longer than two typical intervals remains a gap.
fn present(t: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let rows: Vec<usize> = (0..values.len().min(t.len())).filter(|k| values[*k].is_finite()).collect();
    let every = stride(&rows);
    let (mut times, mut kept) = (Vec::with_capacity(rows.len()), Vec::with_capacity(rows.len()));
    let mut last = None;
    for k in rows {
        if last.is_some_and(|l| k - l > 2 * every) {
            times.push(t[k]);
            kept.push(f64::NAN);
        }
        times.push(t[k]);
        kept.push(values[k]);
        last = Some(k);
    }
    (times, kept)
}

/// Typical distance between rows.
fn stride(rows: &[usize]) -> usize {
    let mut gaps: Vec<usize> = rows.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_unstable();
    gaps.get(gaps.len() / 2).copied().unwrap_or(1)
}

/// The residual at even intervals, 0 where it is missing, and the rows used.
fn even(residual: &[f64]) -> (Vec<f64>, Vec<usize>) {
    let rows: Vec<usize> = (0..residual.len()).filter(|k| residual[*k].is_finite()).collect();
    let Some(first) = rows.first() else { return (Vec::new(), Vec::new()) };
    let rows: Vec<usize> = (*first..residual.len()).step_by(stride(&rows)).collect();
    let value = |k: &usize| if residual[*k].is_finite() { residual[*k] } else { 0.0 };
    (rows.iter().map(value).collect(), rows)
}

fn spectrum(
    answer: &Diagnosis,
    o: &OutputFigure,
    runs: &[(&str, usize, &[f64])],
    factor: f64,
    unit: &str,
) -> Plot {
    let title = "spectrum of the residual";
    let mut plot = Plot::new(format!("spectrum-{}", o.name), title, "frequency, Hz", density(unit));
    (plot.log_x, plot.log_y) = (true, true);
    for (place, (name, colour, values)) in runs.iter().enumerate() {
        let (residual, rows) = even(&difference(&o.measured, values));
        let spectrum = welch(&residual, answer.period_s * stride(&rows) as f64);
        let density: Vec<f64> = spectrum.density.iter().map(|d| d * factor * factor).collect();
        if density.len() < 3 {
            continue;
        }
        // Frequency zero has no place on a logarithmic axis.
        plot.traces.push(Trace::new(*name, *colour, Style::Main, &spectrum.frequency_hz[1..], &density[1..]));
        let df = spectrum.frequency_hz[1];
        for tone in o.tones.iter().filter(|_| place == 0) {
            let bin = ((tone / df).round() as usize).clamp(1, density.len() - 1);
            plot.notes.push((*tone, density[bin], format!("{tone:.2} Hz")));
        }
    }
    plot
}

fn correlations(answer: &Diagnosis, o: &OutputFigure, runs: &[(&str, usize, &[f64])]) -> Vec<Plot> {
    let f = &answer.figures;
    let mut plots = Vec::new();
    for (j, (input, _, values)) in f.inputs.iter().enumerate() {
        let mut plot = Plot::new(
            format!("correlation-{}-{j}", o.name),
            format!("correlation of the residual with {input}"),
            "lag of the residual behind the input, s",
            "",
        );
        plot.height = 230;
        let mut band = 0.0f64;
        for (name, colour, simulated) in runs {
            let (residual, rows) = even(&difference(&o.measured, simulated));
            let u: Vec<f64> = rows.iter().map(|k| values[*k]).collect();
            let Some(c) = correlation(&u, &residual, answer.period_s * stride(&rows) as f64) else {
                continue;
            };
            band = band.max(c.band);
            plot.traces.push(Trace::new(*name, *colour, Style::Main, &c.lag_s, &c.value));
        }
        let Some(lags) = plot.traces.first().map(|t| t.x.clone()) else { continue };
        let ends = [lags[0], lags[lags.len() - 1]];
        for bound in [band, -band] {
            plot.traces.push(Trace::new("99 % bound", MEASURED, Style::Limit, &ends, &[bound, bound]));
        }
        plots.push(plot);
    }
    plots
}

/// Plots of the evidence of causes: of the `accepted` ones, or of the nearest rejected ones.
pub(crate) fn evidence(answer: &Diagnosis, accepted: bool) -> Vec<Plot> {
    let all = answer.figures.evidence.iter().filter(|c| c.accepted == accepted);
    all.enumerate().map(|(i, c)| evidence_plot(c, i)).collect()
}

fn label(axis: &Axis) -> String {
    with_unit(&axis.name, axis.unit.symbol())
}

fn evidence_plot(curve: &EvidenceCurve, place: usize) -> Plot {
    let kind = if curve.accepted { "cause" } else { "rejected" };
    let title = format!("{}{}", if curve.accepted { "" } else { "rejected: " }, curve.cause);
    let id = format!("evidence-{kind}-{place}");
    let mut plot = Plot::new(id, title, label(&curve.x), label(&curve.y));
    plot.caption.clone_from(&curve.caption);
    plot.height = 320;
    (plot.log_x, plot.log_y) = (curve.logarithmic, curve.logarithmic);
    let factors = (curve.x.unit.factor(), curve.y.unit.factor());
    let mut add = |name: &str, colour: usize, style: Style, points: &(Vec<f64>, Vec<f64>)| {
        if !points.0.is_empty() {
            let scaled = |v: &[f64], factor: f64| v.iter().map(|v| v * factor).collect::<Vec<f64>>();
            let (x, y) = (scaled(&points.0, factors.0), scaled(&points.1, factors.1));
            plot.traces.push(Trace::new(name, colour, style, &x, &y));
        }
    };
    // Isolated points are means over parts of the axis; nothing is known between them.
    add("record, single samples", MEASURED, Style::Cloud, &curve.cloud);
    add("given vehicle", MEASURED, Style::Limit, &curve.without);
    let marked = curve.measured.0.len() <= 60;
    add("record", BEFORE, if marked { Style::Points } else { Style::Main }, &curve.measured);
    add("this cause", AFTER, Style::Main, &curve.explained);
    if let Some((name, points)) = &curve.rival {
        add(&format!("{name} instead"), 3, Style::Second, points);
    }
    plot
}
