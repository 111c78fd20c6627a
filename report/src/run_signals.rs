//! Plots of the measured, commanded and applied signals of a run.

use whirlstand_evaluate::run::Run;
use whirlstand_evaluate::summary::RunSummary;
use whirlstand_logs::Line;

use super::plot::{Plot, Span, SpanKind, Style, Trace};

/// Most spans in a plot; beyond that, neighbouring spans are joined.
const MOST_SPANS: usize = 60;

/// Spans of the plots: disturbances of the first run that has any, and held and failsafe steps of all runs.
pub(super) fn spans(runs: &[&Run], summaries: &[RunSummary]) -> Vec<Span> {
    let mut spans = Vec::new();
    if let Some(s) = summaries.iter().find(|s| !s.disturbances.is_empty()) {
        for event in &s.disturbances {
            // A lasting disturbance would shade the whole rest of the plot, so only its onset is marked.
            let lasting = event.until_s - event.at_s > 0.4 * s.duration_s;
            spans.push(Span {
                from: event.at_s,
                until: if lasting { event.at_s } else { event.until_s },
                kind: SpanKind::Disturbance,
            });
        }
    }
    for run in runs {
        let (held, failsafe) = (&run.lines.held, &run.lines.failsafe);
        for (parts, kind) in [(held, SpanKind::Held), (failsafe, SpanKind::Failsafe)] {
            let parts = parts.at_most(MOST_SPANS, 0.002 * run.figures.duration_s);
            spans.extend(parts.into_iter().map(|(from, until)| Span { from, until, kind }));
        }
    }
    spans
}

/// A line of a run, in the unit of its plot.
pub(super) fn trace(
    name: impl Into<String>,
    variant: usize,
    style: Style,
    line: &Line,
    factor: f64,
) -> Trace {
    let (t, y) = line.points();
    Trace::new(name, variant, style, &t, &scaled(&y, factor))
}

fn scaled(values: &[f64], factor: f64) -> Vec<f64> {
    values.iter().map(|v| v * factor).collect()
}

pub(super) fn output_plot(runs: &[&Run], summaries: &[RunSummary], i: usize) -> Plot {
    let output = &runs[0].vehicle.outputs[i];
    let unit = output.unit.shown();
    let factor = unit.factor();
    let mut plot = Plot::over_time(format!("output-{i}"), output.name.clone(), unit.symbol());
    let several = runs.len() > 1;
    let mut wanted = None;
    for (variant, run) in runs.iter().enumerate() {
        if i >= run.vehicle.outputs.len() {
            continue;
        }
        let lines = &run.lines.outputs[i];
        let line = |name: String, style, line: &Line| trace(name, variant, style, line, factor);
        let main = !lines.truth.is_empty();
        if !lines.measured.is_empty() {
            let hidden = several && main;
            plot.traces.push(line("measured".into(), Style::Sensor, &lines.measured).hide_if(hidden));
        }
        if main {
            let name = if several { run.name.clone() } else { "truth".into() };
            plot.traces.push(line(name, Style::Main, &lines.truth));
        }
        if !lines.estimate.is_empty() {
            let style = match (main, several) {
                (true, false) => Style::Estimate,
                (true, true) => Style::Second,
                (false, _) => Style::Main,
            };
            plot.traces.push(line("estimate".into(), style, &lines.estimate).hide_if(several && main));
        }
        let setpoint = line("setpoint".into(), Style::Wanted, &lines.wanted);
        if wanted.is_none() && setpoint.y.iter().any(|v| v.is_finite()) {
            wanted = Some(setpoint);
        }
    }
    plot.traces.extend(wanted);
    plot.spans = spans(runs, summaries);
    // The initial transient of the truth is real; that of a filter is an artefact.
    plot.leave_out_start(|t| matches!(t.style, Style::Estimate | Style::Second));
    plot
}

pub(super) fn input_plot(runs: &[&Run], summaries: &[RunSummary], i: usize) -> Plot {
    let input = &runs[0].vehicle.inputs[i];
    let unit = input.unit.shown();
    let factor = unit.factor();
    let mut plot = Plot::over_time(format!("input-{i}"), input.name.clone(), unit.symbol());
    let (mut least, mut most, mut end) = (0.0f64, 0.0f64, 0.0f64);
    for (variant, run) in runs.iter().enumerate() {
        let Some(line) = run.lines.inputs.get(i) else { continue };
        let name = if runs.len() > 1 { run.name.clone() } else { "applied".into() };
        let applied = trace(name, variant, Style::Held, line, factor);
        (least, most) = applied.y.iter().fold((least, most), |(l, m), v| (l.min(*v), m.max(*v)));
        end = end.max(run.figures.duration_s);
        plot.traces.push(applied);
    }
    // A limit far beyond all commands would only flatten them.
    for (limit, near) in [(input.upper, most), (input.lower, least)] {
        let limit = limit * factor;
        if limit.is_finite() && near.abs() > 0.3 * limit.abs() {
            plot.traces.push(Trace::new("limit", 0, Style::Limit, &[0.0, end], &[limit, limit]));
        }
    }
    if input.lower.is_finite() && input.upper.is_finite() {
        plot.aside = format!("limits {} to {} {}", input.lower * factor, input.upper * factor, unit);
    }
    plot.spans = spans(runs, summaries);
    plot
}
