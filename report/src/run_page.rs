//! The report of a run, or of several variants of it.

use whirlstand_msgs::{LATENCY_BUCKETS, latency_bucket_upper_ns};

use super::ReportError;
use super::figures_table::{estimator_table, expected_table, input_table, output_table, timing_table};
use super::outcome::Outcome;
use super::page::{Attachment, Page, Section};
use super::plot::{Plot, Style, Trace};
use super::run_events::events_table;
use super::run_signals::{input_plot, output_plot, spans, trace};
use super::run_spectra::spectra;
use super::winner::winner;
use whirlstand_evaluate::metrics::nis_bounds;
use whirlstand_evaluate::run::Run;
use whirlstand_evaluate::summary::RunSummary;

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
        verdict: match winner(&summaries, &outcome.expected) {
            Some(winner) if outcome.ok != Some(false) => format!("{winner} {}", outcome.verdict),
            _ => outcome.verdict.clone(),
        },
        level: outcome.level(&summaries),
        remarks: outcome.remarks(&summaries),
        sections: sections(description, outcome, runs, &summaries),
        facts: facts(runs, &summaries),
        files: outcome.files.clone(),
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
    let drawn = |plots: Vec<Plot>| -> Vec<Plot> {
        plots.into_iter().filter(|plot| plot.traces.iter().any(|trace| !trace.x.is_empty())).collect()
    };
    let outputs = (0..first.vehicle.outputs.len()).map(|i| output_plot(runs, summaries, i)).collect();
    let inputs = (0..first.vehicle.inputs.len()).map(|i| input_plot(runs, summaries, i)).collect();
    let mut sections = vec![
        Section {
            title: "Outputs".into(),
            text: description.into(),
            plots: drawn(outputs),
            columns: 2,
            ..Section::default()
        },
        Section {
            title: "Commands".into(),
            text: "Commands as applied by the plant, after its limits.".into(),
            plots: drawn(inputs),
            columns: 2,
            ..Section::default()
        },
        Section {
            title: "Figures".into(),
            tables: if summaries.iter().any(|s| s.duration_s > 0.0) {
                vec![output_table(summaries), input_table(summaries)]
            } else {
                Vec::new()
            },
            ..Section::default()
        },
    ];
    if !outcome.expected.is_empty() {
        sections.push(Section {
            title: "Expected".into(),
            tables: vec![expected_table(&outcome.expected)],
            ..Section::default()
        });
    }
    sections.extend(events_table(runs).map(|table| Section {
        title: "Events".into(),
        tables: vec![table],
        ..Section::default()
    }));
    sections.extend(spectra(runs));
    sections.extend(estimator_section(runs, summaries));
    sections.push(Section {
        title: "Timing".into(),
        text: "Percentiles are upper edges of histogram buckets, two per octave. Latency of the plant: from publishing a \
               measurement to receiving its command; of the other nodes: from input to output."
            .into(),
        tables: vec![timing_table(summaries)],
        plots: latency_plot(runs).into_iter().collect(),
        ..Section::default()
    });
    // A run that ended at once has nothing to plot.
    sections.retain(|section| !section.plots.is_empty() || section.tables.iter().any(|t| !t.rows.is_empty()));
    sections
}

/// The estimator's errors; `None` where no run has any.
fn estimator_section(runs: &[&Run], summaries: &[RunSummary]) -> Option<Section> {
    let plots = estimator_plots(runs, summaries);
    let first = runs.first().filter(|_| !plots.is_empty())?;
    let of = if runs.len() > 1 { format!(" ({})", first.name) } else { String::new() };
    Some(Section {
        title: "Estimator".into(),
        text: format!(
            "Estimation errors relative to the truth, with the filter's bounds of two standard deviations{of}. \
             For a consistent filter 95 % of the errors are within them, and the NIS is near 1."
        ),
        tables: estimator_table(summaries).into_iter().collect(),
        plots,
        columns: 2,
        ..Section::default()
    })
}

/// Fewest steps with an estimate for a plot.
const FEWEST_ESTIMATES: u64 = 8;

fn estimator_plots(runs: &[&Run], summaries: &[RunSummary]) -> Vec<Plot> {
    let nis = nis_plot(runs, summaries);
    let errors = runs.first().map_or(Vec::new(), |run| error_plots(run, &summaries[..1]));
    nis.into_iter().chain(errors).collect()
}

fn nis_plot(runs: &[&Run], summaries: &[RunSummary]) -> Option<Plot> {
    let mut plot = Plot::over_time("nis", "NIS per degree of freedom, mean over 1 s", "");
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
    plot.leave_out_start(|_| true);
    (!plot.traces.is_empty()).then_some(plot)
}

fn error_plots(run: &Run, summaries: &[RunSummary]) -> Vec<Plot> {
    let states = run.vehicle.states.iter().zip(&run.lines.errors).enumerate();
    let plots = states.filter(|(_, (_, lines))| !lines.error.is_empty()).map(|(i, (state, lines))| {
        let unit = state.unit.shown();
        let factor = unit.factor();
        let mut plot =
            Plot::over_time(format!("error-{i}"), format!("{} estimate error", state.name), unit.symbol());
        plot.traces.push(trace("error", 0, Style::Main, &lines.error, factor));
        for sign in [2.0, -2.0] {
            plot.traces.push(trace("± 2 std", 0, Style::Limit, &lines.claimed, sign * factor));
        }
        plot.spans = spans(&[run], summaries);
        plot.leave_out_start(|_| true);
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
            // A step of the outline begins at the lower edge of a bucket; the last step ends at the next
            // edge.
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
