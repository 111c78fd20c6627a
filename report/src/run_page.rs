//! The report of a run, or of several variants of it.

use whirlstand_msgs::{LATENCY_BUCKETS, latency_bucket_upper_ns};

use super::ReportError;
use super::figures_table::{estimator_table, expected_table, input_table, output_table, timing_table};
use super::outcome::Outcome;
use super::page::{Attachment, Page, Section};
use super::plot::{Plot, Span, SpanKind, Style, Trace};
use whirlstand_evaluate::metrics::nis_bounds;
use whirlstand_evaluate::run::Run;
use whirlstand_evaluate::summary::RunSummary;
use whirlstand_logs::Line;
use whirlstand_logs::shown::{shown_factor, shown_unit};

/// The report of a bench: one run, or several variants side by side.
///
/// # Errors
/// [`ReportError`], when the page cannot be put together.
pub fn run_report(
    name: &str,
    description: &str,
    outcome: &Outcome,
    runs: &[&Run],
) -> Result<String, ReportError> {
    let summaries: Vec<RunSummary> = runs.iter().map(|run| run.figures.clone()).collect();
    let page = Page {
        kind: "run report".into(),
        title: name.into(),
        verdict: outcome.verdict.clone(),
        level: outcome.level(&summaries),
        remarks: outcome.remarks(&summaries),
        sections: sections(description, outcome, runs, &summaries),
        facts: facts(runs, &summaries),
        attachments: runs.first().map_or(Vec::new(), |run| {
            run.attachments
                .iter()
                .map(|(title, text)| Attachment { title: title.clone(), text: text.clone() })
                .collect()
        }),
    };
    page.to_html()
}

fn sections(description: &str, outcome: &Outcome, runs: &[&Run], summaries: &[RunSummary]) -> Vec<Section> {
    let Some(first) = runs.first() else { return Vec::new() };
    let outputs = (0..first.vehicle.outputs.len()).map(|i| output_plot(runs, summaries, i)).collect();
    let inputs = (0..first.vehicle.inputs.len()).map(|i| input_plot(runs, summaries, i)).collect();
    let mut sections = vec![
        Section {
            title: "Figures".into(),
            text: description.into(),
            tables: vec![output_table(summaries), input_table(summaries)],
            ..Section::default()
        },
        Section { title: "Outputs".into(), plots: outputs, columns: 2, ..Section::default() },
        Section {
            title: "Commands".into(),
            text: "What the plant applied, after its limits.".into(),
            plots: inputs,
            columns: 2,
            ..Section::default()
        },
    ];
    if !outcome.expected.is_empty() {
        sections.insert(
            0,
            Section {
                title: "Expected".into(),
                tables: vec![expected_table(&outcome.expected)],
                ..Section::default()
            },
        );
    }
    let estimator = estimator_plots(runs, summaries);
    if !estimator.is_empty() {
        sections.push(Section {
            title: "Estimator".into(),
            text: format!(
                "Errors of the estimate against the truth, with the two standard deviations that the filter claims{}. \
                 A consistent filter keeps 95 % of its errors inside them, and its NIS near 1.",
                if runs.len() > 1 { format!(" ({})", first.name) } else { String::new() }
            ),
            tables: estimator_table(summaries).into_iter().collect(),
            plots: estimator,
            columns: 2,
            ..Section::default()
        });
    }
    sections.push(Section {
        title: "Timing".into(),
        text: "Percentiles are upper edges of histogram buckets, two an octave. The plant's latency runs from publishing \
               a measurement to holding its command; that of the other nodes from being asked to answering."
            .into(),
        tables: vec![timing_table(summaries)],
        plots: latency_plot(runs).into_iter().collect(),
        ..Section::default()
    });
    sections
}

/// Longest list of spans that a plot gets; beyond, neighbours are joined.
const MOST_SPANS: usize = 60;

/// Disturbances of the first run that has some, held and failsafe steps of all.
fn spans(runs: &[&Run], summaries: &[RunSummary]) -> Vec<Span> {
    let mut spans = Vec::new();
    if let Some(s) = summaries.iter().find(|s| !s.disturbances.is_empty()) {
        for event in &s.disturbances {
            // A disturbance that stays would shade all that follows: its onset says as much.
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

/// A line of a run in the unit of its plot.
fn trace(name: impl Into<String>, variant: usize, style: Style, line: &Line, factor: f64) -> Trace {
    let (t, y) = line.points();
    Trace::new(name, variant, style, &t, &scaled(&y, factor))
}

fn scaled(values: &[f64], factor: f64) -> Vec<f64> {
    values.iter().map(|v| v * factor).collect()
}

fn output_plot(runs: &[&Run], summaries: &[RunSummary], i: usize) -> Plot {
    let output = &runs[0].vehicle.outputs[i];
    let si = output.unit.si_symbol();
    let factor = shown_factor(&si);
    let mut plot = Plot::over_time(format!("output-{i}"), output.name.clone(), shown_unit(&si));
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
            let style = if main { Style::Second } else { Style::Main };
            plot.traces.push(line("estimate".into(), style, &lines.estimate).hide_if(several && main));
        }
        let setpoint = line("setpoint".into(), Style::Wanted, &lines.wanted);
        if wanted.is_none() && setpoint.y.iter().any(|v| v.is_finite()) {
            wanted = Some(setpoint);
        }
    }
    plot.traces.extend(wanted);
    plot.spans = spans(runs, summaries);
    plot
}

fn input_plot(runs: &[&Run], summaries: &[RunSummary], i: usize) -> Plot {
    let input = &runs[0].vehicle.inputs[i];
    let si = input.unit.si_symbol();
    let factor = shown_factor(&si);
    let mut plot = Plot::over_time(format!("input-{i}"), input.name.clone(), shown_unit(&si));
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
        plot.y_label =
            format!("{} limits {} to {}", plot.y_label, input.lower * factor, input.upper * factor);
    }
    plot.spans = spans(runs, summaries);
    plot
}

/// Fewest steps with an estimate that are worth a plot.
const FEWEST_ESTIMATES: u64 = 8;

fn estimator_plots(runs: &[&Run], summaries: &[RunSummary]) -> Vec<Plot> {
    let nis = nis_plot(runs, summaries);
    let errors = runs.first().map_or(Vec::new(), |run| error_plots(run, &summaries[..1]));
    nis.into_iter().chain(errors).collect()
}

fn nis_plot(runs: &[&Run], summaries: &[RunSummary]) -> Option<Plot> {
    let mut plot = Plot::over_time("nis", "NIS over its degrees of freedom, mean over 1 s", "");
    for (variant, run) in runs.iter().enumerate() {
        let nis = &run.lines.nis;
        if nis.steps < FEWEST_ESTIMATES {
            continue;
        }
        plot.traces.push(trace(run.name.clone(), variant, Style::Main, &nis.ratio, 1.0));
        if variant == 0 {
            let (low, high) = nis_bounds(nis.degrees());
            let ends = [nis.ends_s.0, nis.ends_s.1];
            for (name, bound) in [("95 % interval", high), ("95 % interval", low)] {
                plot.traces.push(Trace::new(name, 0, Style::Limit, &ends, &[bound, bound]));
            }
        }
    }
    plot.spans = spans(runs, summaries);
    (!plot.traces.is_empty()).then_some(plot)
}

fn error_plots(run: &Run, summaries: &[RunSummary]) -> Vec<Plot> {
    let states = run.vehicle.states.iter().zip(&run.lines.errors).enumerate();
    let plots = states.filter(|(_, (_, lines))| !lines.error.is_empty()).map(|(i, (state, lines))| {
        let si = state.unit.si_symbol();
        let factor = shown_factor(&si);
        let mut plot =
            Plot::over_time(format!("error-{i}"), format!("{} estimate error", state.name), shown_unit(&si));
        plot.traces.push(trace("error", 0, Style::Main, &lines.error, factor));
        for sign in [2.0, -2.0] {
            plot.traces.push(trace("± 2 std", 0, Style::Limit, &lines.claimed, sign * factor));
        }
        plot.spans = spans(&[run], summaries);
        plot.height = 230;
        plot
    });
    plots.collect()
}

fn latency_plot(runs: &[&Run]) -> Option<Plot> {
    let mut plot = Plot::new("latency", "Latency", "latency, us", "answers");
    plot.log_x = true;
    plot.log_y = true;
    let mut variant = 0;
    for run in runs {
        for health in &run.health {
            let histogram = health.histogram();
            let (Some(from), Some(until)) =
                (histogram.iter().position(|c| *c > 0), histogram.iter().rposition(|c| *c > 0))
            else {
                continue;
            };
            // The lower edge of a bucket begins its step; the last step ends at the next edge.
            let edge = |b: usize| {
                if b == 0 { 0.35 } else { latency_bucket_upper_ns((b - 1).min(LATENCY_BUCKETS - 2)) * 1e-3 }
            };
            let x: Vec<f64> = (from..=until + 1).map(edge).collect();
            let mut y: Vec<f64> =
                histogram[from..=until].iter().map(|c| if *c > 0 { *c as f64 } else { f64::NAN }).collect();
            y.push(y[y.len() - 1]);
            let name =
                if runs.len() > 1 { format!("{} {}", run.name, health.node) } else { health.node.clone() };
            let hidden = runs.len() > 1 && health.node != "plant";
            plot.traces.push(Trace::new(name, variant, Style::Histogram, &x, &y).hide_if(hidden));
            variant += 1;
        }
    }
    (!plot.traces.is_empty()).then_some(plot)
}

fn facts(runs: &[&Run], summaries: &[RunSummary]) -> Vec<(String, String)> {
    let Some((run, s)) = runs.first().zip(summaries.first()) else { return Vec::new() };
    let mut facts = vec![
        ("vehicle".to_string(), s.vehicle.clone()),
        ("mode".into(), s.mode.clone()),
        ("transport".into(), s.transport.clone()),
        ("rate".into(), format!("{} Hz", (1.0 / s.period_s * 1e6).round() / 1e6)),
        ("duration".into(), format!("{:.3} s", s.duration_s)),
        ("seed".into(), s.seed.to_string()),
        ("version".into(), run.info.version.clone()),
    ];
    facts.extend(
        summaries.iter().map(|s| {
            (if runs.len() > 1 { format!("log of {}", s.name) } else { "log".into() }, s.log.clone())
        }),
    );
    facts.extend(run.info.extra.iter().map(|(k, v)| (k.clone(), v.clone())));
    facts
}
