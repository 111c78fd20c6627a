//! Spectra of a run's signals: power spectral densities of all variants, and spectrograms of a single run.

use whirlstand_evaluate::run::Run;
use whirlstand_evaluate::spectra::Spectrum;
use whirlstand_logs::stats::quantile;
use whirlstand_msgs::units::ShownUnit;

use super::page::Section;
use super::plot::{Heat, Plot, Style, Trace};

/// Most spectrograms on a page; rates come before inputs.
const MOST_SPECTROGRAMS: usize = 8;

/// Share of the values that have the palest colour.
const LEAST_COLOUR: f64 = 0.1;

/// A signal whose spectrum is shown.
struct Signal<'a> {
    id: String,
    name: &'a str,
    unit: ShownUnit,
    /// Spectra, one per variant.
    spectra: Vec<(&'a str, &'a Spectrum)>,
}

/// Spectra of rates and inputs; `None` when every run was too short for one.
pub(super) fn spectra(runs: &[&Run]) -> Option<Section> {
    let signals = signals(runs);
    let mut plots: Vec<Plot> = signals.iter().filter_map(density_plot).collect();
    if let [_] = runs {
        plots.extend(signals.iter().filter_map(spectrogram_plot).take(MOST_SPECTROGRAMS));
    }
    (!plots.is_empty()).then(|| Section {
        title: "Spectra".into(),
        text: "Rates as measured and inputs as applied (Welch's method, Hann windows of about a second)."
            .into(),
        plots,
        columns: 2,
        ..Section::default()
    })
}

/// The signals whose spectra are shown: the rates, or all outputs where a vehicle has no rate; then the
/// inputs.
fn signals<'a>(runs: &[&'a Run]) -> Vec<Signal<'a>> {
    let Some(first) = runs.first() else { return Vec::new() };
    let outputs = &first.vehicle.outputs;
    let is_rate = |i: usize| outputs[i].unit.si_symbol().starts_with("rad/s");
    let any = (0..outputs.len()).any(is_rate);
    let rates = (0..outputs.len()).filter(|&i| is_rate(i) || !any).map(|i| Signal {
        id: format!("output-spectrum-{i}"),
        name: &outputs[i].name,
        unit: outputs[i].unit.shown(),
        spectra: of_runs(runs, |run| run.lines.output_spectra.get(i)),
    });
    let inputs = first.vehicle.inputs.iter().enumerate().map(|(i, input)| Signal {
        id: format!("input-spectrum-{i}"),
        name: &input.name,
        unit: input.unit.shown(),
        spectra: of_runs(runs, |run| run.lines.input_spectra.get(i)),
    });
    rates.chain(inputs).collect()
}

fn of_runs<'a>(
    runs: &[&'a Run],
    spectrum: impl Fn(&'a Run) -> Option<&'a Spectrum>,
) -> Vec<(&'a str, &'a Spectrum)> {
    let some = |run: &&'a Run| Some((run.name.as_str(), spectrum(run)?));
    runs.iter().filter_map(some).filter(|(_, s)| s.segments > 0).collect()
}

fn density_plot(signal: &Signal) -> Option<Plot> {
    let (factor, unit) = (signal.unit.factor(), signal.unit.symbol());
    let mut plot = Plot::new(signal.id.clone(), signal.name, "frequency, Hz", root_density(unit));
    plot.log_y = true;
    for (variant, (name, spectrum)) in signal.spectra.iter().enumerate() {
        // The first bin, the mean, was removed.
        let density: Vec<f64> = spectrum.density[1..].iter().map(|d| factor * d.sqrt()).collect();
        if density.iter().any(|d| *d > 0.0) {
            plot.traces.push(Trace::new(*name, variant, Style::Main, &spectrum.frequency_hz[1..], &density));
        }
    }
    (!plot.traces.is_empty()).then_some(plot)
}

fn spectrogram_plot(signal: &Signal) -> Option<Plot> {
    let (factor, unit) = (signal.unit.factor(), signal.unit.symbol());
    let (_, spectrum) = signal.spectra.first()?;
    let found = &spectrum.spectrogram;
    // Two columns show no course over time.
    if found.time_s.len() < 3 || found.density.iter().flatten().all(|d| *d <= 0.0) {
        return None;
    }
    let decibel = |d: &f64| if *d > 0.0 { 10.0 * (factor * factor * d).log10() } else { f64::NAN };
    let z: Vec<Vec<f64>> = found.density.iter().map(|row| row.iter().map(decibel).collect()).collect();
    // The deep minima of noise would take most of the colour scale.
    let all: Vec<f64> = z.iter().flatten().copied().filter(|v| v.is_finite()).collect();
    let least = quantile(&all, LEAST_COLOUR);
    let z = z.into_iter().map(|row| row.into_iter().map(|v| v.max(least)).collect()).collect();
    let title = format!("{} over time", signal.name);
    let mut plot = Plot::over_time(format!("{}-time", signal.id), title, "frequency, Hz");
    let unit = format!("dB of 1 {}", root_density(unit));
    plot.aside.clone_from(&unit);
    plot.heat = Some(Heat { x: found.time_s.clone(), y: found.frequency_hz.clone(), z, unit });
    Some(plot)
}

/// Unit of the square root of a density.
fn root_density(unit: &str) -> String {
    match unit {
        "" => "1/√Hz".into(),
        unit => format!("{unit}/√Hz"),
    }
}
