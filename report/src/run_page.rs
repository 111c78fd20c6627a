//! The report of a run, or of several variants of it.

use whirlstand_msgs::{LATENCY_BUCKETS, flags, latency_bucket_upper_ns};

use super::ReportError;
use super::figures_table::{estimator_table, expected_table, input_table, output_table, timing_table};
use super::outcome::Outcome;
use super::page::{Attachment, Page, Section};
use super::plot::{Plot, Span, SpanKind, Style, Trace};
use whirlstand_evaluate::metrics::nis_bounds;
use whirlstand_evaluate::run::Run;
use whirlstand_evaluate::summary::RunSummary;
use whirlstand_logs::shown::{shown_factor, shown_unit};
use whirlstand_logs::stats::moving_average;

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
    let summaries: Vec<RunSummary> = runs.iter().map(|r| RunSummary::of(r)).collect();
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
        for (flag, kind) in [(flags::HELD, SpanKind::Held), (flags::FAILSAFE, SpanKind::Failsafe)] {
            let mut parts = run.flagged(flag).0;
            let mut gap = 0.002 * run.end_s();
            while parts.len() > MOST_SPANS {
                let mut joined: Vec<(f64, f64)> = Vec::new();
                for part in parts {
                    match joined.last_mut() {
                        Some(last) if part.0 - last.1 <= gap => last.1 = part.1,
                        _ => joined.push(part),
                    }
                }
                parts = joined;
                gap *= 2.0;
            }
            spans.extend(parts.into_iter().map(|(from, until)| Span { from, until, kind }));
        }
    }
    spans
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
        let line = |name: String, style, t: &[f64], y: &[f64]| {
            Trace::new(name, variant, style, t, &scaled(y, factor))
        };
        let main = !run.truth.is_empty();
        let measured = &run.measured[i];
        if !measured.is_empty() {
            let hidden = several && main;
            plot.traces.push(
                line("measured".into(), Style::Sensor, &measured.t, &measured.signals[0]).hide_if(hidden),
            );
        }
        if main {
            let name = if several { run.name.clone() } else { "truth".into() };
            plot.traces.push(line(name, Style::Main, &run.truth.t, &run.output_of(&run.truth, i)));
        }
        if !run.estimate.is_empty() {
            let estimate = run.output_of(&run.estimate, i);
            let style = if main { Style::Second } else { Style::Main };
            plot.traces
                .push(line("estimate".into(), style, &run.estimate.t, &estimate).hide_if(several && main));
        }
        let w = run.wanted(i);
        if wanted.is_none() && w.iter().any(|v| v.is_finite()) {
            wanted = Some(line("setpoint".into(), Style::Wanted, &run.setpoint.t, &w));
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
        let applied = run.truth.signals.get(run.vehicle.states.len() + i).filter(|u| !u.is_empty());
        let (t, u) = match (applied, run.command.signals.get(i)) {
            (Some(u), _) => (&run.truth.t, u),
            (None, Some(u)) => (&run.command.t, u),
            (None, None) => continue,
        };
        let u = scaled(u, factor);
        (least, most) = u.iter().fold((least, most), |(l, m), v| (l.min(*v), m.max(*v)));
        end = end.max(run.end_s());
        let name = if runs.len() > 1 { run.name.clone() } else { "applied".into() };
        plot.traces.push(Trace::new(name, variant, Style::Held, t, &u));
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

fn estimator_plots(runs: &[&Run], summaries: &[RunSummary]) -> Vec<Plot> {
    let run = runs[0];
    let n = run.vehicle.states.len();
    let estimate = &run.estimate;
    if estimate.t.len() < 8 {
        return Vec::new();
    }
    let mut nis_plot = Plot::over_time("nis", "NIS over its degrees of freedom, mean over 1 s", "");
    let half = ((0.5 / run.period_s()).round() as usize).max(1);
    for (variant, run) in runs.iter().enumerate() {
        let e = &run.estimate;
        let (Some(nis), Some(dof)) = (e.signals.get(2 * n), e.signals.get(2 * n + 1)) else { continue };
        // A step without a fresh measurement has nothing to judge.
        let used: Vec<usize> = (0..e.t.len()).filter(|&k| dof[k] > 0.0 && nis[k].is_finite()).collect();
        if used.len() < 8 {
            continue;
        }
        let pick = |f: &dyn Fn(usize) -> f64| used.iter().map(|&k| f(k)).collect::<Vec<f64>>();
        let (sum, degrees) =
            (moving_average(&pick(&|k| nis[k]), half), moving_average(&pick(&|k| dof[k]), half));
        let ratio: Vec<f64> = sum.iter().zip(&degrees).map(|(a, b)| a / b).collect();
        nis_plot.traces.push(Trace::new(run.name.clone(), variant, Style::Main, &pick(&|k| e.t[k]), &ratio));
        if variant == 0 {
            let (low, high) = nis_bounds(degrees[degrees.len() / 2] * (2 * half + 1) as f64);
            let ends = [e.t[0], e.t[e.t.len() - 1]];
            for (name, bound) in [("95 % interval", high), ("95 % interval", low)] {
                nis_plot.traces.push(Trace::new(name, 0, Style::Limit, &ends, &[bound, bound]));
            }
        }
    }
    nis_plot.spans = spans(runs, summaries);
    let mut plots = if nis_plot.traces.is_empty() { Vec::new() } else { vec![nis_plot] };
    if run.truth.t != estimate.t {
        return plots;
    }
    for (i, state) in run.vehicle.states.iter().enumerate() {
        let si = state.unit.si_symbol();
        let factor = shown_factor(&si);
        let mut plot =
            Plot::over_time(format!("error-{i}"), format!("{} estimate error", state.name), shown_unit(&si));
        let error: Vec<f64> =
            estimate.signals[i].iter().zip(&run.truth.signals[i]).map(|(e, x)| factor * (e - x)).collect();
        plot.traces.push(Trace::new("error", 0, Style::Main, &estimate.t, &error));
        for (name, sign) in [("± 2 std", 2.0), ("± 2 std", -2.0)] {
            let bound = scaled(&estimate.signals[n + i], sign * factor);
            plot.traces.push(Trace::new(name, 0, Style::Limit, &estimate.t, &bound));
        }
        plot.spans = spans(&runs[..1], &summaries[..1]);
        plot.height = 230;
        plots.push(plot);
    }
    plots
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
