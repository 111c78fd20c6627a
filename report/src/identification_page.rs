//! The report of an identification: the paper's figures 2 to 9, frequency responses, parameters.

use super::ReportError;
use super::page::{Attachment, Cell, Level, Page, Row, Section, Table};
use super::plot::{Plot, Style, Trace};
use whirlstand_ident::identify::answer::{Identification, PartSeries, Role};
use whirlstand_ident::identify::data::filled;
use whirlstand_ident::identify::response::{Response, TRUSTED, response};
use whirlstand_logs::shown::{clean, number};

/// The report of an identification as one HTML text.
///
/// # Errors
/// [`ReportError`], which would be a bug.
pub fn identification_report(answer: &Identification) -> Result<String, ReportError> {
    let parts = answer.series.iter().enumerate();
    let mut sections: Vec<Section> = parts.map(|(index, part)| real_and_simulated(part, index)).collect();
    sections.extend([figures(answer), parameters(answer)]);
    for (index, part) in answer.series.iter().enumerate() {
        sections.push(quadratic_errors(part, index));
    }
    sections.extend(responses(answer));
    sections.extend(residuals(answer));
    let doubtful = !answer.search.converged
        || !answer.standard_errors_hold
        || !answer.fixed.is_empty()
        || answer.parameters.iter().any(|p| p.at_bound);
    let level = if doubtful { Level::Warn } else { Level::Good };
    let mut attachments = Vec::new();
    if let Some(vehicle) = &answer.fitted {
        attachments.push(Attachment { title: "fitted vehicle file".into(), text: vehicle.to_toml() });
    }
    Page {
        kind: "identification".into(),
        title: answer.vehicle.clone(),
        verdict: answer.verdict.clone(),
        level,
        remarks: answer.remarks.iter().map(|r| (Level::Warn, r.clone())).collect(),
        sections,
        facts: facts(answer),
        attachments,
        ..Page::default()
    }
    .to_html()
}

fn facts(answer: &Identification) -> Vec<(String, String)> {
    let mut facts: Vec<(String, String)> = answer
        .data
        .iter()
        .map(|d| {
            let role = if d.role == Role::Identification { "identification data" } else { "validation data" };
            let text = format!(
                "{} from {} s to {} s, {} steps",
                d.log.file,
                number(d.from_s),
                number(d.until_s),
                d.samples
            );
            (role.to_string(), text)
        })
        .collect();
    let s = &answer.search;
    facts.push(("method".into(), format!("{} with {} residuals", answer.method.word(), noise_word(answer))));
    facts.push((
        "search".into(),
        format!("{} iterations, {} evaluations, {:.2} s", s.iterations, s.evaluations, s.seconds),
    ));
    facts.push(("period".into(), format!("{} s", clean(answer.period_s))));
    facts.push(("seed".into(), answer.seed.to_string()));
    facts.push(("program".into(), format!("whirlstand {}", answer.version)));
    facts
}

fn noise_word(answer: &Identification) -> String {
    serde_json::to_value(answer.noise).ok().and_then(|v| v.as_str().map(str::to_string)).unwrap_or_default()
}

/// Fit of every output.
fn figures(answer: &Identification) -> Section {
    let head = [
        "output",
        "free run, %",
        "one step, %",
        "held out: free run",
        "bias removed",
        "one step",
        "noise",
        "residual white",
    ];
    let percent = |v: Option<f64>| Cell::new(v.map_or("-".into(), |v| format!("{v:.2}")));
    let rows = answer.outputs.iter().map(|(name, o)| {
        let (own, other) = (o.identification, o.control);
        let mut cells = vec![
            percent(own.and_then(|q| q.free_run_fit)),
            percent(own.and_then(|q| q.one_step_fit)),
            percent(other.and_then(|q| q.free_run_fit)),
            percent(other.and_then(|q| q.free_run_fit_bias_removed)),
            percent(other.and_then(|q| q.one_step_fit)),
        ];
        cells.push(Cell::new(o.unit.text(o.noise_std)));
        cells.push(match &o.whiteness {
            None => Cell::new("-"),
            Some(w) if w.white => Cell::leveled("yes", Level::Good),
            Some(w) => Cell::leveled(format!("no ({:+.2})", w.greatest), Level::Warn),
        });
        Row { label: name.clone(), group: false, cells }
    });
    Section {
        title: "Fit to the records".into(),
        tables: vec![Table {
            head: head.iter().map(|h| h.to_string()).collect(),
            rows: rows.collect(),
            note: "Fit is 100 (1 - norm(y - y_sim) / norm(y - mean y)), including sensor noise. Noise: what cannot \
                   be predicted one step ahead. White: Ljung-Box test at 1 %, with the largest autocorrelation."
                .into(),
            ..Table::default()
        }],
        ..Section::default()
    }
}

fn role_words(part: &PartSeries) -> &'static str {
    match part.role {
        Role::Identification => "identification data",
        Role::Control => "validation data",
    }
}

fn real_and_simulated(part: &PartSeries, index: usize) -> Section {
    let mut plots = Vec::new();
    for o in &part.outputs {
        let factor = o.unit.factor();
        let scaled = |v: &[f64]| filled(v).iter().map(|v| v * factor).collect::<Vec<f64>>();
        let mut plot = Plot::over_time(format!("real-{index}-{}", o.name), o.name.clone(), o.unit.symbol());
        plot.traces.push(Trace::new("real", 5, Style::Main, &part.t, &scaled(&o.measured)));
        plot.traces.push(Trace::new("simulated", 1, Style::Second, &part.t, &scaled(&o.simulated)));
        plots.push(plot);
    }
    for (name, unit, values) in &part.inputs {
        let factor = unit.factor();
        let mut plot = Plot::over_time(format!("input-{index}-{name}"), name.clone(), unit.symbol());
        let values: Vec<f64> = values.iter().map(|v| v * factor).collect();
        plot.traces.push(Trace::new(name.clone(), 2, Style::Held, &part.t, &values));
        plot.height = 200;
        plots.push(plot);
    }
    Section {
        title: format!("Real and simulated, {}", role_words(part)),
        text: format!("{}. The simulation is a free run from the first step.", part.origin),
        plots,
        columns: 2,
        ..Section::default()
    }
}

fn quadratic_errors(part: &PartSeries, index: usize) -> Section {
    let plots = part.outputs.iter().map(|o| {
        let factor = o.unit.factor();
        let unit = o.unit.symbol();
        let square: Vec<f64> =
            o.measured.iter().zip(&o.simulated).map(|(y, s)| ((y - s) * factor).powi(2)).collect();
        let label = if unit.is_empty() { String::new() } else { format!("({unit})²") };
        let mut plot = Plot::over_time(format!("quadratic-{index}-{}", o.name), o.name.clone(), label);
        plot.traces.push(Trace::new("quadratic error", 0, Style::Main, &part.t, &filled(&square)));
        plot
    });
    Section {
        title: format!("Quadratic error, {}", role_words(part)),
        text: part.origin.clone(),
        plots: plots.collect(),
        columns: 2,
        ..Section::default()
    }
}

/// Frequency responses of record and simulation over the identification data.
fn responses(answer: &Identification) -> Option<Section> {
    let parts: Vec<&PartSeries> = answer.series.iter().filter(|p| p.role == Role::Identification).collect();
    let first = parts.first()?;
    let inputs: Vec<Vec<Vec<f64>>> =
        parts.iter().map(|p| p.inputs.iter().map(|(.., v)| v.clone()).collect()).collect();
    let of = |o: usize, real: bool| -> Option<Response> {
        let output: Vec<Vec<f64>> = parts
            .iter()
            .map(|p| filled(if real { &p.outputs[o].measured } else { &p.outputs[o].simulated }))
            .collect();
        if output.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
        response(&inputs, &output, first.period_s)
    };
    let (mut plots, mut silent) = (Vec::new(), Vec::new());
    for (o, output) in first.outputs.iter().enumerate() {
        let Some(real) = of(o, true) else { continue };
        let simulated = of(o, false);
        for (i, (input, ..)) in first.inputs.iter().enumerate() {
            let pair = format!("{} / {input}", output.name);
            match real.trusted(i) {
                Some(range) => {
                    plots.extend(bode(&pair, &real, simulated.as_ref(), i, *range.start(), *range.end()));
                }
                None => silent.push(pair),
            }
        }
    }
    let mut text = format!(
        "Identification data; each response is conditioned on the other inputs. Shown up to the highest frequency \
         with a partial coherence of {TRUSTED} or more."
    );
    if !silent.is_empty() {
        text.push_str(&format!(" Hardly any coherence: {}.", silent.join(", ")));
    }
    (!plots.is_empty() || !silent.is_empty()).then(|| Section {
        title: "Frequency responses".into(),
        text,
        plots,
        columns: 3,
        ..Section::default()
    })
}

/// Gain, phase and coherence of one input-output pair, side by side.
fn bode(
    pair: &str,
    real: &Response,
    simulated: Option<&Response>,
    input: usize,
    first: usize,
    last: usize,
) -> [Plot; 3] {
    let plot = |what: &str, unit: &str| {
        let id = format!("{}-{}", what.replace(' ', "-"), pair.replace(" / ", "-"));
        let mut plot = Plot::new(id, format!("{pair}: {what}"), "frequency, Hz", unit);
        plot.log_x = true;
        plot.height = 230;
        plot
    };
    let (mut gain, mut phase) = (plot("gain", "dB"), plot("phase", "deg"));
    let mut coherence = plot("partial coherence", "");
    // The plot ends slightly beyond the last trusted frequency, where the coherence falls.
    let end = (last + last / 2 + 2).min(real.frequency_hz.len());
    let f = &real.frequency_hz[..end];
    let trusted = |k: usize| (first..=last).contains(&k) && real.coherence[input][k] >= TRUSTED;
    let (db, deg) = real.bode(input, trusted);
    gain.traces.push(Trace::new("real", 5, Style::Main, f, &db[..end]));
    phase.traces.push(Trace::new("real", 5, Style::Main, f, &deg[..end]));
    if let Some(simulated) = simulated {
        let (db, mut own) = simulated.bode(input, |k| (first..=last).contains(&k));
        // Shifts the phase to the same turn as the record's.
        let apart = (0..end).find(|k| deg[*k].is_finite() && own[*k].is_finite()).map(|k| own[k] - deg[k]);
        let turns = (apart.unwrap_or(0.0) / 360.0).round();
        own.iter_mut().for_each(|v| *v -= 360.0 * turns);
        gain.traces.push(Trace::new("simulated", 1, Style::Second, f, &db[..end]));
        phase.traces.push(Trace::new("simulated", 1, Style::Second, f, &own[..end]));
    }
    coherence.traces.push(Trace::new("partial coherence", 5, Style::Main, f, &real.coherence[input][..end]));
    coherence.traces.push(Trace::new(
        "trusted from",
        5,
        Style::Limit,
        &[f[0], f[end - 1]],
        &[TRUSTED, TRUSTED],
    ));
    coherence.y_range = Some((0.0, 1.02));
    [gain, phase, coherence]
}

/// Autocorrelation of the one-step residuals.
fn residuals(answer: &Identification) -> Option<Section> {
    let plots: Vec<Plot> = answer
        .outputs
        .iter()
        .filter_map(|(name, o)| {
            let white = o.whiteness.as_ref()?;
            let lags: Vec<f64> = (1..=white.autocorrelation.len()).map(|l| l as f64).collect();
            let mut plot = Plot::new(format!("residual-{name}"), name.clone(), "lag, steps", "");
            plot.traces.push(Trace::new("autocorrelation", 0, Style::Points, &lags, &white.autocorrelation));
            let ends = [0.0, lags.len() as f64 + 1.0];
            for bound in [white.bound, -white.bound] {
                plot.traces.push(Trace::new("99 % of white noise", 5, Style::Limit, &ends, &[bound, bound]));
            }
            plot.height = 230;
            Some(plot)
        })
        .collect();
    (!plots.is_empty()).then(|| Section {
        title: "Residuals".into(),
        text: "Autocorrelation of the one-step residuals, after the noise model. Values beyond the dotted lines \
               indicate vibration, a gust or unmodelled dynamics."
            .into(),
        plots,
        columns: 3,
        ..Section::default()
    })
}

fn parameters(answer: &Identification) -> Section {
    Section {
        title: "Parameters".into(),
        tables: vec![values(answer), poles(answer), correlations(answer)],
        ..Section::default()
    }
}

/// The free parameters with their standard errors and bounds, then the parameters that the data did not
/// determine.
fn values(answer: &Identification) -> Table {
    let rows = answer.parameters.iter().map(|p| Row {
        label: p.name.clone(),
        group: false,
        cells: vec![
            Cell::new(format!("{:.5}", p.value)),
            Cell::new(p.unit.clone()),
            Cell::new(p.standard_error.map_or("-".into(), number)),
            Cell::new(number(p.lower)),
            Cell::new(number(p.upper)),
            if p.at_bound { Cell::leveled("at bound", Level::Warn) } else { Cell::default() },
        ],
    });
    let fixed = answer.fixed.iter().map(|f| Row {
        label: f.name.clone(),
        group: false,
        cells: vec![
            Cell::new(format!("{:.5}", f.value)),
            Cell::new(f.unit.clone()),
            Cell::new("-"),
            Cell::default(),
            Cell::default(),
            Cell::leveled(format!("fixed: {}", f.why), Level::Warn),
        ],
    });
    let head = ["parameter", "value", "unit", "standard error", "lower", "upper", ""];
    Table {
        head: head.iter().map(|h| h.to_string()).collect(),
        rows: rows.chain(fixed).collect(),
        note: if answer.standard_errors_hold {
            "In the units of the vehicle file. Standard errors are Cramér-Rao bounds, corrected for coloured residuals."
        } else {
            "In the units of the vehicle file. The standard errors are not reliable: see the remarks."
        }
        .into(), ..Table::default() }
}

/// The poles of the identified model, one row per conjugate pair.
fn poles(answer: &Identification) -> Table {
    let poles = answer.poles.iter().filter(|p| p.im >= 0.0).map(|p| Row {
        label: if p.im > 0.0 { format!("{:.4} ± {:.4}i", p.re, p.im) } else { format!("{:.4}", p.re) },
        group: false,
        cells: vec![
            Cell::new(number(p.frequency_hz)),
            Cell::leveled(number(p.damping_ratio), if p.re > 0.0 { Level::Bad } else { Level::Neutral }),
        ],
    });
    Table {
        head: ["pole, 1/s", "frequency, Hz", "damping ratio"].iter().map(|h| h.to_string()).collect(),
        rows: poles.collect(),
        note: String::new(),
        ..Table::default()
    }
}

/// The correlations of the parameters' errors; a pair above 0.9 is marked.
fn correlations(answer: &Identification) -> Table {
    let names = || answer.parameters.iter().map(|p| p.name.clone());
    let rows = answer.correlations.iter().zip(names()).enumerate().map(|(i, (row, name))| Row {
        label: name,
        group: false,
        cells: row
            .iter()
            .enumerate()
            .map(|(j, r)| {
                let strong = i != j && r.abs() > 0.9;
                Cell::leveled(format!("{r:.2}"), if strong { Level::Warn } else { Level::Neutral })
            })
            .collect(),
    });
    Table {
        head: std::iter::once("correlation".to_string()).chain(names()).collect(),
        rows: rows.collect(),
        note: String::new(),
        ..Table::default()
    }
}
