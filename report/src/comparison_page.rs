//! The report of a comparison.

use super::ReportError;
use super::labels::{density, squared, with_unit};
use super::page::{Cell, Level, Page, Row, Section, Table};
use super::plot::{Plot, Span, SpanKind, Style, Trace};
use whirlstand_ident::compare::{Comparison, OutputComparison, OutputSeries, spectrum};
use whirlstand_logs::shown::number;

/// The report of a comparison: figures; then for each output the measured and the simulated signal, the
/// residual, the quadratic error and the spectrum of the residual.
///
/// # Errors
/// [`ReportError`], when the page cannot be put together.
pub fn comparison_report(c: &Comparison) -> Result<String, ReportError> {
    let outputs = c.series.outputs.iter();
    let mut sections: Vec<Section> =
        outputs.filter_map(|s| Some(output(c, s, c.outputs.get(&s.name)?))).collect();
    let inputs = c.series.inputs.iter().enumerate().map(|(i, (name, unit, values))| {
        let mut plot = Plot::over_time(format!("input-{i}"), name.clone(), unit.symbol());
        let values: Vec<f64> = values.iter().map(|v| v * unit.factor()).collect();
        plot.traces.push(Trace::new(name.clone(), 0, Style::Held, &c.series.t, &values));
        plot.height = 200;
        plot
    });
    sections.push(Section {
        title: "Figures".into(),
        text: format!(
            "Fit is 100 (1 - norm(residual) / norm(measured - its mean)) of a free run: 100 is perfect, 0 is as good \
             as the mean of the record. Initial state: {}; the start of the record is not counted as an error. The \
             {} s fit assesses predictions over {} s from a state fitted to the previous {} s, too short for an \
             integrator to drift.",
            c.initial_state_method, c.horizon_s, c.horizon_s, c.horizon_s
        ),
        tables: vec![table(c)],
        ..Section::default()
    });
    sections.push(Section {
        title: "Inputs".into(),
        plots: inputs.collect(),
        columns: 2,
        ..Section::default()
    });
    let mut remarks: Vec<(Level, String)> = c.remarks.iter().map(|r| (Level::Warn, r.clone())).collect();
    if !c.not_compared.is_empty() {
        remarks.push((Level::Neutral, format!("Not in the record: {}.", c.not_compared.join(", "))));
    }
    let page = Page {
        kind: "comparison".into(),
        title: format!("{} compared with {}", file_name(&c.record), c.vehicle),
        verdict: c.verdict.clone(),
        level: if c.agrees() { Level::Good } else { Level::Warn },
        remarks,
        sections,
        facts: vec![
            ("record".into(), c.record.clone()),
            ("vehicle".into(), c.vehicle.clone()),
            ("compared".into(), format!("{:.3} to {:.3} s", c.from_s, c.until_s)),
            ("period".into(), format!("{} s ({} points)", number(c.period_s), c.samples)),
            ("version".into(), env!("CARGO_PKG_VERSION").into()),
            ("initial state".into(), initial_state(c)),
        ],
        attachments: Vec::new(),
        ..Page::default()
    };
    page.to_html()
}

fn file_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

fn initial_state(c: &Comparison) -> String {
    let values: Vec<String> = c.initial_state.iter().map(|(n, v)| format!("{n} {}", number(*v))).collect();
    format!("{} (SI)", values.join(", "))
}

fn table(c: &Comparison) -> Table {
    let ahead = format!("{} s fit, %", c.horizon_s);
    let head = [
        "",
        "fit, %",
        "bias removed, %",
        &ahead,
        "rmse",
        "declared noise",
        "bias",
        "correlation",
        "growth",
        "spectral peak",
    ];
    let rows = c.ordered().map(|(name, o)| {
        let factor = o.unit.factor();
        let fit = |f: Option<f64>| match f {
            None => Cell::new("-"),
            Some(f) => {
                let level = if f >= 90.0 {
                    Level::Good
                } else if f < 0.0 {
                    Level::Bad
                } else {
                    Level::Neutral
                };
                Cell::leveled(format!("{f:.1}"), level)
            }
        };
        let value = |v: Option<f64>| Cell::new(v.map_or("-".into(), |v| number(v * factor)));
        let line = o.lines.first().map_or("-".into(), |l| match 100.0 * l.share {
            share if share < 1.0 => format!("{:.2} Hz, < 1 %", l.frequency_hz),
            share => format!("{:.2} Hz, {share:.0} %", l.frequency_hz),
        });
        let noise = Some(o.declared_noise).filter(|n| *n > 0.0);
        Row {
            label: with_unit(name, o.unit.symbol()),
            group: false,
            cells: vec![
                fit(o.fit),
                fit(o.fit_bias_removed),
                fit(o.horizon_fit),
                value(o.rmse),
                value(noise),
                value(o.bias),
                Cell::new(o.correlation.map_or("-".into(), |r| format!("{r:.3}"))),
                Cell::new(o.growth.map_or("-".into(), |g| format!("{g:.2}"))),
                Cell::new(line),
            ],
        }
    });
    Table {
        head: head.iter().map(|h| h.to_string()).collect(),
        rows: rows.collect(),
        note: "Growth: rms residual in the last tenth of the record divided by that of the rest. Spectral peak: the \
               strongest one of the residual, and its share of the residual power."
            .into(),
        ..Table::default()
    }
}

fn output(c: &Comparison, s: &OutputSeries, o: &OutputComparison) -> Section {
    let factor = o.unit.factor();
    let unit = o.unit.symbol();
    let t = &c.series.t;
    let scaled = |v: &[f64]| v.iter().map(|v| v * factor).collect::<Vec<f64>>();
    let residual: Vec<f64> = s.measured.iter().zip(&s.simulated).map(|(y, m)| y - m).collect();
    let worst: Vec<Span> =
        o.worst.iter().map(|w| Span { from: w.from_s, until: w.until_s, kind: SpanKind::Worst }).collect();
    let id = |what: &str| format!("{what}-{}", s.name);

    let mut both = Plot::over_time(id("both"), "measured and simulated", unit);
    both.traces.push(Trace::new("measured", 5, Style::Main, t, &scaled(&s.measured)));
    let mut error = Plot::over_time(id("residual"), "residual", unit);
    let ahead: Vec<f64> = scaled(&s.prediction_error);
    let name = format!("{} s prediction", c.horizon_s);
    if !c.diverged {
        both.traces.push(Trace::new("simulated", 0, Style::Main, t, &scaled(&s.simulated)));
        error.traces.push(Trace::new("free run", 0, Style::Main, t, &scaled(&residual)));
    }
    let predicted: Vec<f64> =
        s.measured.iter().zip(&s.prediction_error).map(|(y, e)| factor * (y - e)).collect();
    both.traces.push(Trace::new(name.clone(), 1, Style::Second, t, &predicted).hide_if(!c.diverged));
    error.traces.push(Trace::new(name, 1, Style::Second, t, &ahead).hide_if(!c.diverged));
    both.spans.clone_from(&worst);
    error.spans = worst;
    let mut plots = vec![both, error];
    if !c.diverged {
        let mut quadratic = Plot::over_time(id("quadratic"), "quadratic error", squared(unit));
        let squares: Vec<f64> = scaled(&residual).iter().map(|e| e * e).collect();
        quadratic.traces.push(Trace::new("quadratic error", 0, Style::Main, t, &squares));
        let step_t: Vec<f64> = o.quadratic_error.iter().flat_map(|i| [i.from_s, i.until_s]).collect();
        let step: Vec<f64> =
            o.quadratic_error.iter().flat_map(|i| [i.mean_square * factor * factor; 2]).collect();
        quadratic.traces.push(Trace::new("mean over 5 % of the record", 1, Style::Main, &step_t, &step));
        plots.push(quadratic);
        plots.push(spectrum_plot(c, s, &residual, o, unit));
    }
    let fit = o.fit.map_or("no free-run fit".into(), |f| format!("fit {f:.1} %"));
    Section {
        title: s.name.clone(),
        text: format!(
            "{fit}, {}.",
            o.horizon_fit.map_or("no prediction".into(), |f| format!("{f:.1} % over {} s", c.horizon_s))
        ),
        plots,
        columns: 2,
        ..Section::default()
    }
}

fn spectrum_plot(
    c: &Comparison,
    s: &OutputSeries,
    residual: &[f64],
    o: &OutputComparison,
    unit: &str,
) -> Plot {
    let factor = o.unit.factor();
    let id = format!("spectrum-{}", s.name);
    let spectrum = spectrum(residual, &s.measured, c.period_s);
    let mut plot = Plot::new(id, "spectrum of the residual", "frequency, Hz", density(unit));
    plot.log_x = true;
    plot.log_y = true;
    let density: Vec<f64> = spectrum.density.iter().map(|d| d * factor * factor).collect();
    if density.len() > 2 {
        // Frequency zero has no place on a logarithmic axis; it holds only the mean, which was removed.
        plot.traces.push(Trace::new("residual", 0, Style::Main, &spectrum.frequency_hz[1..], &density[1..]));
        let df = spectrum.frequency_hz[1];
        for line in &o.lines {
            let bin = ((line.frequency_hz / df).round() as usize).min(density.len() - 1);
            plot.notes.push((line.frequency_hz, density[bin], format!("{:.2} Hz", line.frequency_hz)));
        }
    }
    plot
}
