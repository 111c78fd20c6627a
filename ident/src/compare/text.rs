//! A comparison as text.

use whirlstand_vehicle::Vehicle;

use super::comparison::{Comparison, OutputComparison};
use super::grid::Grid;
use whirlstand_logs::shown::{clean, number};
use whirlstand_logs::stats::{mean, rms};

/// Remarks on the record: gaps, uneven sampling, inputs outside their limits.
pub fn remarks(grid: &Grid, vehicle: &Vehicle) -> Vec<String> {
    let mut remarks = Vec::new();
    if grid.uneven > 0.0 {
        remarks.push(format!(
            "{:.2} % of the sampling intervals deviate by more than half a period; the record was resampled to an even grid",
            100.0 * grid.uneven
        ));
    }
    for (values, &i) in grid.measured.iter().zip(&grid.outputs) {
        let missing = values.iter().filter(|v| !v.is_finite()).count();
        let every = vehicle.outputs[i].every.max(1) as usize;
        if missing * 100 > values.len() && every == 1 {
            let percent = 100.0 * missing as f64 / values.len() as f64;
            remarks.push(format!("{} has no value at {percent:.1} % of the points", vehicle.outputs[i].name));
        }
    }
    let m = vehicle.inputs.len();
    for (j, input) in vehicle.inputs.iter().enumerate() {
        let u: Vec<f64> = grid.inputs.iter().skip(j).step_by(m).copied().collect();
        let outside = u.iter().filter(|u| **u < input.lower - 1e-9 || **u > input.upper + 1e-9).count();
        if outside > 0 {
            remarks.push(format!(
                "{} exceeds the vehicle's limits ({} to {}) at {:.1} % of the points and is clipped there by the simulation",
                input.name,
                input.unit.shown().text(input.lower),
                input.unit.shown().text(input.upper),
                100.0 * outside as f64 / u.len() as f64
            ));
        }
        if u.iter().all(|v| (v - u[0]).abs() <= 1e-12 * u[0].abs()) {
            remarks.push(format!("{} never changes, so its effect is not tested", input.name));
        }
    }
    remarks
}

/// Text on the amplitude of the simulation, when in all outputs it is a tenth of the measured one or ten
/// times it: the inputs are then probably not in the unit that the vehicle file expects.
pub fn size(c: &Comparison) -> Option<String> {
    if c.diverged {
        return None;
    }
    // In the second half the fitted initial state has decayed, which would hide that nothing else moves.
    let spread = |values: &[f64]| {
        let late = &values[values.len() / 2..];
        let known: Vec<f64> = late.iter().copied().filter(|v| v.is_finite()).collect();
        let m = mean(&known);
        rms(&known.iter().map(|v| v - m).collect::<Vec<_>>())
    };
    let ratios: Vec<f64> = c
        .series
        .outputs
        .iter()
        .map(|o| (spread(&o.measured), spread(&o.simulated)))
        .filter(|(measured, _)| *measured > 0.0)
        .map(|(measured, simulated)| simulated / measured)
        .collect();
    let least = ratios.iter().copied().fold(f64::INFINITY, f64::min);
    let most = ratios.iter().copied().fold(0.0, f64::max);
    (!ratios.is_empty() && (most < 0.1 || least > 10.0)).then(|| {
        format!(
            "the simulated motion is {} to {} times the recorded motion: check that the inputs are in the units that \
             the vehicle expects; an input_gain in the vehicle file scales them",
            number(least),
            number(most)
        )
    })
}

/// True when the residual is no larger than the declared noise explains.
fn at_noise_floor(o: &OutputComparison) -> bool {
    o.rmse.is_some_and(|r| o.declared_noise > 0.0 && r <= 1.2 * o.declared_noise)
}

/// True when the simulation explains an output, down to the noise or with a fit of 90 %.
fn agrees(o: &OutputComparison) -> bool {
    at_noise_floor(o) || o.fit.is_some_and(|f| f >= 90.0)
}

/// True when the simulation explains every output.
pub fn all_agree(c: &Comparison) -> bool {
    !c.diverged && c.ordered().all(|(_, o)| agrees(o))
}

fn percent(v: Option<f64>) -> String {
    v.map_or("-".into(), |v| format!("{v:.1}"))
}

/// The verdict in a sentence or two.
pub fn verdict(c: &Comparison) -> String {
    if c.diverged {
        let ahead: Vec<String> =
            c.ordered().map(|(name, o)| format!("{name} {} %", percent(o.horizon_fit))).collect();
        return format!(
            "The free run diverges, so only predictions over {} s can be assessed: fit {}.",
            clean(c.horizon_s),
            ahead.join(", ")
        );
    }
    let name = |(name, o): (&str, &OutputComparison)| match o.fit {
        Some(f) => format!("{name} ({f:.1} %)"),
        None => format!("{name} (constant)"),
    };
    let (agree, differ): (Vec<_>, Vec<_>) = c.ordered().partition(|(_, o)| agrees(o));
    if differ.is_empty() {
        let noise =
            if agree.iter().all(|(_, o)| at_noise_floor(o)) { " down to the declared noise" } else { "" };
        return format!(
            "The simulation agrees with the record{noise}: fit {}.",
            agree.into_iter().map(name).collect::<Vec<_>>().join(", ")
        );
    }
    let mut differ = differ;
    differ.sort_by(|a, b| a.1.fit.unwrap_or(0.0).total_cmp(&b.1.fit.unwrap_or(0.0)));
    let finding = differ.iter().find_map(|(n, o)| peculiarity(n, o));
    let mut sentence = if differ.iter().all(|(_, o)| o.fit.is_none_or(|f| f <= 0.0)) {
        // A fit of zero is that of the record's mean.
        "The simulation is no better than the mean of the record".to_string()
    } else {
        "The simulation differs from the record".to_string()
    };
    sentence += &format!(" in {}", differ.into_iter().map(name).collect::<Vec<_>>().join(", "));
    if !agree.is_empty() {
        sentence += &format!("; it agrees in {}", agree.into_iter().map(name).collect::<Vec<_>>().join(", "));
    }
    sentence + &finding.map_or(".".into(), |f| format!(". {f}."))
}

/// The most notable feature of an output's residual.
fn peculiarity(name: &str, o: &OutputComparison) -> Option<String> {
    let unit = o.unit.symbol();
    if let (Some(fit), Some(without), Some(bias)) = (o.fit, o.fit_bias_removed, o.bias)
        && without - fit > 20.0
    {
        return Some(format!(
            "A constant offset of {} explains much of {name}: without it the fit is {without:.1} %",
            o.unit.text(bias)
        ));
    }
    if let Some(line) = o.lines.first()
        && line.share > 0.2
    {
        return Some(format!(
            "A tone at {:.1} Hz accounts for {:.0} % of the residual of {name} (amplitude {})",
            line.frequency_hz,
            100.0 * line.share,
            o.unit.text(line.amplitude)
        ));
    }
    let growth = o.growth.filter(|g| *g > 2.0)?;
    Some(format!(
        "The error of {name} grows towards the end: its last tenth is {growth:.1} times the rest, in {unit}"
    ))
}

/// The comparison as at most 15 lines, each with a line end.
pub fn text(c: &Comparison) -> String {
    let mut lines = vec![
        c.verdict.clone(),
        format!(
            "{} compared with {}: {:.1} s, {} points at {:.4} Hz",
            c.record,
            c.vehicle,
            c.until_s - c.from_s,
            c.samples,
            1.0 / c.period_s
        ),
        format!(
            "{:<22} {:>7} {:>9} {:>9} {:>14} {:>14}  {}",
            "output",
            "fit %",
            "unbiased",
            format!("{} s fit", clean(c.horizon_s)),
            "rmse",
            "bias",
            "worst part"
        ),
    ];
    let most = 8;
    for (name, o) in c.ordered().take(most) {
        let value = |v: Option<f64>| v.map_or("-".into(), |v| o.unit.text(v));
        let worst = o.worst.map_or("-".into(), |w| {
            format!("{:.1}-{:.1} s, {}", w.from_s, w.until_s, o.unit.text(w.mean_square.sqrt()))
        });
        lines.push(format!(
            "{name:<22} {:>7} {:>9} {:>9} {:>14} {:>14}  {worst}",
            percent(o.fit),
            percent(o.fit_bias_removed),
            percent(o.horizon_fit),
            value(o.rmse),
            value(o.bias),
        ));
    }
    if c.outputs.len() > most {
        lines.push(format!("and {} more outputs: see the report", c.outputs.len() - most));
    }
    let tones: Vec<String> = c
        .ordered()
        .filter_map(|(name, o)| {
            // Lines with a smaller share exist, but explain nothing.
            let l = o.lines.first().filter(|l| l.share >= 0.01)?;
            Some(format!("{name} {:.2} Hz ({:.0} %)", l.frequency_hz, 100.0 * l.share))
        })
        .collect();
    if !tones.is_empty() {
        lines.push(format!("spectral peaks of the residual: {}", tones.join(", ")));
    }
    if !c.not_compared.is_empty() {
        lines.push(format!("not in the record: {}", c.not_compared.join(", ")));
    }
    lines.push("the initial state is fitted, so the start of the record is not counted as an error".into());
    lines.extend(c.remarks.iter().take(15usize.saturating_sub(lines.len())).cloned());
    lines.truncate(15);
    lines.join("\n") + "\n"
}

impl Comparison {
    /// The comparison as at most 15 lines of text, without colour.
    pub fn text(&self) -> String {
        text(self)
    }

    /// True when the simulation explains every output: down to the declared noise, or with a fit of 90 % or more.
    pub fn agrees(&self) -> bool {
        all_agree(self)
    }
}
