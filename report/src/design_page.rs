//! The page of a design: gains and margins, Bode plots, steps and poles.

use whirlstand_control::design::Pole;
use whirlstand_control::{Design, Responses};
use whirlstand_logs::shown::number;
use whirlstand_msgs::units::ShownUnit;

use super::ReportError;
use super::page::{Attachment, Cell, Level, Page, Row, Section, Table};
use super::plot::{Plot, Style, Trace};

/// The data of the page.
#[derive(Debug, Clone, Copy)]
pub struct DesignReport<'a> {
    /// Name of the vehicle.
    pub vehicle: &'a str,
    /// The law and its figures.
    pub design: &'a Design,
    /// Frequency and step responses of the design.
    pub responses: &'a Responses,
    /// Units of the states, in their order.
    pub state_units: &'a [ShownUnit],
    /// The design as text.
    pub text: &'a str,
}

/// The page of a design.
///
/// # Errors
/// [`ReportError`], which would be a bug.
pub fn design_report(report: &DesignReport) -> Result<String, ReportError> {
    let design = report.design;
    let page = Page {
        kind: "design".into(),
        title: format!("{} under {}", report.vehicle, design.law.to_uppercase()),
        verdict: verdict(design),
        level: if design.multivariable_margins.max_sensitivity <= 2.0 { Level::Good } else { Level::Warn },
        sections: vec![steps(report), bode(report), poles(design), margins(design), gains(design)],
        facts: vec![
            ("vehicle".into(), report.vehicle.into()),
            ("period".into(), format!("{} s", number(design.plant.period_s()))),
            ("version".into(), env!("CARGO_PKG_VERSION").into()),
        ],
        attachments: vec![Attachment { title: "as text".into(), text: report.text.into() }],
        ..Page::default()
    };
    page.to_html()
}

fn verdict(design: &Design) -> String {
    let m = &design.multivariable_margins;
    let gains = match m.disk_gain_high {
        Some(high) => format!("gains from {} to {} times the model's", number(m.disk_gain_low), number(high)),
        None => format!("gains from {} times the model's", number(m.disk_gain_low)),
    };
    let delay = design.loop_margins.iter().filter_map(|m| m.delay_s).fold(f64::INFINITY, f64::min);
    let delay = if delay.is_finite() {
        format!(", or {} ms of additional delay at one input", number(1e3 * delay))
    } else {
        String::new()
    };
    let advice = if m.max_sensitivity > 2.0 { ", above the usual limit of 2" } else { "" };
    format!(
        "The loop tolerates {gains} or {:.1} deg of phase at all inputs at once{delay}; peak sensitivity {:.2}{advice}.",
        m.disk_phase_deg, m.max_sensitivity
    )
}

fn steps(report: &DesignReport) -> Section {
    let plant = &report.design.plant;
    let states = plant.state_names();
    let mut share = Plot::new("step", "setpoint step responses", "time, s", "share of the step, %");
    let mut inputs: Vec<Plot> = plant
        .input_names()
        .iter()
        .enumerate()
        .map(|(i, name)| {
            Plot::new(format!("step-input-{i}"), format!("{name} during the step"), "time, s", "")
        })
        .collect();
    let mut sizes = Vec::new();
    for (variant, step) in report.responses.steps.iter().enumerate() {
        let name = &states[step.state];
        let percent: Vec<f64> = step.value.iter().map(|v| 100.0 * v / step.size).collect();
        share.traces.push(Trace::new(name, variant, Style::Main, &step.time_s, &percent));
        for (plot, values) in inputs.iter_mut().zip(&step.inputs) {
            plot.traces.push(Trace::new(name, variant, Style::Held, &step.time_s, values));
        }
        let unit = report.state_units.get(step.state).cloned().unwrap_or_default();
        sizes.push(format!("{name} by {}", unit.text(step.size)));
    }
    for (plot, limits) in inputs.iter_mut().zip(plant.inputs()) {
        let end = plot.traces.iter().filter_map(|t| t.x.last().copied()).fold(0.0, f64::max);
        let most = plot.traces.iter().flat_map(|t| &t.y).fold(0.0f64, |m, v| m.max(v.abs()));
        for limit in [limits.lower, limits.upper] {
            if limit.is_finite() && most > 0.3 * limit.abs() {
                plot.traces.push(Trace::new("limit", 0, Style::Limit, &[0.0, end], &[limit, limit]));
            }
        }
    }
    let some = !share.traces.is_empty();
    Section {
        title: "Steps".into(),
        text: match sizes.as_slice() {
            [] => "No setpoint of this vehicle has a steady state.".into(),
            _ => format!(
                "{}: response of the linear loop, without limits and with known states.",
                sizes.join(", ")
            ),
        },
        plots: if some { std::iter::once(share).chain(inputs).collect() } else { Vec::new() },
        columns: 2,
        ..Section::default()
    }
}

fn bode(report: &DesignReport) -> Section {
    let r = report.responses;
    let mut gain = Plot::new("gain", "gain of each loop with the others closed", "frequency, rad/s", "dB");
    let mut phase = Plot::new("phase", "phase of each loop", "frequency, rad/s", "deg");
    let mut sensitivity =
        Plot::new("sensitivity", "sensitivity, largest singular value", "frequency, rad/s", "dB");
    for plot in [&mut gain, &mut phase, &mut sensitivity] {
        plot.log_x = true;
        plot.group = Some("frequency");
    }
    let w = &r.frequency_rad_s;
    for (i, (name, values)) in report.design.plant.input_names().iter().zip(&r.loops).enumerate() {
        let decibel: Vec<f64> = values.iter().map(|l| 20.0 * l.norm().log10()).collect();
        gain.traces.push(Trace::new(name, i, Style::Main, w, &decibel));
        phase.traces.push(Trace::new(name, i, Style::Main, w, &unwrapped(values.iter().map(|l| l.arg()))));
    }
    if let (Some(first), Some(last)) = (w.first(), w.last()) {
        gain.traces.push(Trace::new("0 dB", 0, Style::Limit, &[*first, *last], &[0.0, 0.0]));
        phase.traces.push(Trace::new("-180 deg", 0, Style::Limit, &[*first, *last], &[-180.0, -180.0]));
    }
    let decibel: Vec<f64> = r.sensitivity.iter().map(|s| 20.0 * s.log10()).collect();
    sensitivity.traces.push(Trace::new("sensitivity", 0, Style::Main, w, &decibel));
    if let Some((at, most)) = w.iter().zip(&decibel).max_by(|a, b| a.1.total_cmp(b.1)) {
        sensitivity.notes.push((*at, *most, format!("{most:.1} dB at {} rad/s", number(*at))));
    }
    Section {
        title: "Frequency responses".into(),
        text: "The loop is broken at the plant input; it includes the latency of one period.".into(),
        plots: vec![gain, phase, sensitivity],
        columns: 2,
        ..Section::default()
    }
}

/// Phases in degrees without jumps; the first one is within half a turn of -90 deg.
fn unwrapped(phases: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut last: f64 = -90.0;
    phases
        .map(|phase| {
            let degrees = phase.to_degrees();
            last = degrees + 360.0 * ((last - degrees) / 360.0).round();
            last
        })
        .collect()
}

fn poles(design: &Design) -> Section {
    let mut plot = Plot::new("poles", "poles", "real part, 1/s", "imaginary part, 1/s");
    plot.square = true;
    plot.height = 420;
    for (variant, name, poles) in
        [(5, "open loop", &design.open_loop_poles), (0, "closed loop", &design.closed_loop_poles)]
    {
        let places = || poles.iter().filter_map(|pole| pole.continuous);
        let (x, y): (Vec<f64>, Vec<f64>) = places().map(|[re, im]| (re, im)).unzip();
        plot.traces.push(Trace::new(name, variant, Style::Crosses, &x, &y));
    }
    let delays = design.closed_loop_poles.iter().filter(|pole| pole.continuous.is_none()).count();
    let rows = |name: &str, poles: &[Pole]| {
        let heading = Row { label: name.into(), group: true, cells: vec![Cell::default(); 3] };
        let rows = poles.iter().filter_map(|pole| {
            let [re, im] = pole.continuous?;
            let place = if im == 0.0 { format!("{re:.4}") } else { format!("{re:.4} {im:+.4}i") };
            let optional = |v: Option<f64>| Cell::new(v.map_or("-".into(), |v| format!("{v:.3}")));
            let cells = vec![Cell::new(place), optional(pole.frequency_rad_s), optional(pole.damping)];
            Some(Row { label: String::new(), group: false, cells })
        });
        std::iter::once(heading).chain(rows).collect::<Vec<Row>>()
    };
    Section {
        title: "Poles".into(),
        text: match delays {
            0 => String::new(),
            1 => "One more pole is a pure delay (z = 0).".into(),
            n => format!("{n} more poles are pure delays (z = 0)."),
        },
        tables: vec![Table {
            head: ["", "pole, 1/s", "frequency, rad/s", "damping"].map(String::from).to_vec(),
            rows: [
                rows("open loop", &design.open_loop_poles),
                rows("closed loop", &design.closed_loop_poles),
            ]
            .concat(),
            ..Table::default()
        }],
        plots: vec![plot],
        columns: 2,
        ..Section::default()
    }
}

fn margins(design: &Design) -> Section {
    let or = |v: Option<f64>, none: &str| Cell::new(v.map_or(none.into(), number));
    let rows = design.plant.input_names().iter().zip(&design.loop_margins).map(|(name, m)| Row {
        label: name.clone(),
        group: false,
        cells: vec![
            or(m.gain_decrease, "0"),
            or(m.gain_increase, "infinite"),
            or(m.phase_deg, "infinite"),
            or(m.delay_s.map(|s| 1e3 * s), "infinite"),
            or(m.crossover_rad_s, "-"),
        ],
    });
    Section {
        title: "Margins, one input at a time".into(),
        tables: vec![Table {
            head: ["", "gain, from", "gain, to", "phase, deg", "delay, ms", "crossover, rad/s"]
                .map(String::from)
                .to_vec(),
            rows: rows.collect(),
            ..Table::default()
        }],
        ..Section::default()
    }
}

fn gains(design: &Design) -> Section {
    let (inputs, states) = (design.plant.input_names(), design.plant.state_names());
    let gain = &design.linear.gain;
    let rows = inputs.iter().enumerate().map(|(i, name)| Row {
        label: name.clone(),
        group: false,
        cells: gain.row(i).iter().take(states.len()).map(|v| Cell::new(number(*v))).collect(),
    });
    Section {
        title: "Gain".into(),
        text: match design.plant.memory_names().len() {
            0 => "K in u = -K x, SI.".into(),
            past => {
                format!("K in u = -K x, SI. The law also feeds back {past} past commands of the late inputs.")
            }
        },
        tables: vec![Table {
            head: std::iter::once(String::new()).chain(states.iter().cloned()).collect(),
            rows: rows.collect(),
            ..Table::default()
        }],
        ..Section::default()
    }
}

#[cfg(test)]
mod tests {
    use super::unwrapped;

    #[test]
    fn phases_do_not_jump() {
        let phases = (0..80).map(|i| {
            let phase = -0.1 * f64::from(i);
            phase.sin().atan2(phase.cos())
        });
        let found = unwrapped(phases);
        assert!(found.windows(2).all(|w| (w[1] - w[0] + 0.1f64.to_degrees()).abs() < 1e-9), "{found:?}");
    }
}
