//! An identification as text.

use super::answer::{Identification, Role};
use super::options::Method;
use super::pem::Noise;
use super::prepare::Levels;
use whirlstand_logs::shown::{counted, number};
use whirlstand_vehicle::Vehicle;

/// Name of a noise model on the command line.
pub fn noise(noise: Noise) -> &'static str {
    match noise {
        Noise::White => "white",
        Noise::Coloured => "coloured",
        Noise::Kalman => "kalman",
    }
}

/// The result of an identification in a sentence.
pub fn verdict(answer: &Identification) -> String {
    let fits = |role: Role| -> Option<(f64, &str)> {
        let of = |o: &super::answer::OutputAnswer| match role {
            Role::Identification => o.identification,
            Role::Control => o.control,
        };
        let all = answer.outputs.iter().filter_map(|(n, o)| Some((of(o)?.free_run_fit?, n.as_str())));
        all.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    let partial = if answer.partial { "Partial, as the search was ended early. " } else { "" };
    let mut text =
        format!("{partial}{} of '{}' fitted", counted(answer.parameters.len(), "parameter"), answer.vehicle);
    if !answer.fixed.is_empty() {
        text.push_str(&format!(", {} left out (not determined by the data)", answer.fixed.len()));
    }
    match (fits(Role::Control), fits(Role::Identification)) {
        // Worse than the mean of the record: what nobody measured moves the vehicle as much as its inputs do, or its
        // integrators sum it up. Then only predictions tell something of the model.
        (Some((fit, _)), _) | (None, Some((fit, _))) if answer.noise == Noise::Kalman && fit <= 0.0 => {
            text.push_str("; the free run leaves the record, so only predictions could be assessed");
        }
        (Some((fit, name)), _) => {
            text.push_str(&format!(
                "; free-run fit on held-out data at least {fit:.1} % (worst output: {name})"
            ));
        }
        (None, Some((fit, name))) => {
            text.push_str(&format!(
                "; free-run fit at least {fit:.1} % (worst output: {name}); no data were held out"
            ));
        }
        _ => text.push_str("; the free run diverges, so only predictions could be assessed"),
    }
    text + "."
}

/// The subtracted levels as text, SI.
pub fn levels(vehicle: &Vehicle, levels: &Levels) -> String {
    let inputs = vehicle.inputs.iter().map(|u| (&u.name, u.unit.si_symbol())).zip(&levels.inputs);
    let outputs = vehicle.outputs.iter().map(|y| (&y.name, y.unit.si_symbol())).zip(&levels.outputs);
    let one = |((name, unit), level)| format!("{name} = {level:.6} {unit}").trim_end().to_string();
    inputs.chain(outputs).map(one).collect::<Vec<_>>().join(", ")
}

/// False when an unmodelled disturbance acts in a part of the data, which no standard error accounts for, or
/// when the search was stopped before its minimum. Coloured noise, as of a vibration, does not count:
/// standard errors are corrected for it, or too large in the innovations form.
pub fn standard_errors_hold(answer: &Identification) -> bool {
    answer.disturbed.is_empty() && !answer.partial
}

/// Text on unmodelled disturbances, with advice.
fn disturbances(answer: &Identification) -> Option<String> {
    const MOST_SUGGESTIONS: usize = 4;
    let worst = answer.disturbed.iter().max_by(|a, b| a.ratio.total_cmp(&b.ratio))?;
    let mut strongest: Vec<_> = answer.disturbed.iter().collect();
    strongest.sort_by(|a, b| b.ratio.total_cmp(&a.ratio));
    let options: Vec<String> = strongest
        .iter()
        .take(MOST_SUGGESTIONS)
        .map(|d| format!("--hold-out {:.2}:{:.2}", d.from_s, d.until_s))
        .collect();
    let more = answer.disturbed.len().saturating_sub(MOST_SUGGESTIONS);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    Some(format!(
        "There is an effect that the model does not include: residuals of {} are {:.1} times larger than usual from \
         {:.2} s to {:.2} s. If it was a gust, exclude it: {}{more}.",
        worst.output,
        worst.ratio,
        worst.from_s,
        worst.until_s,
        options.join(" ")
    ))
}

/// Remarks on the data and on the result.
pub fn remarks(answer: &Identification) -> Vec<String> {
    let mut all = Vec::new();
    if answer.partial {
        all.push(
            "The search was ended early: the values are the best found so far, and the standard errors are those of \
             a point that is not yet a minimum."
                .into(),
        );
    } else if !answer.search.converged {
        all.push(match answer.method {
            Method::Ga => {
                "The genetic algorithm used up its simulations before it converged: allow more with --evaluations.".into()
            }
            _ => "The search ended before it reached a minimum.".to_string(),
        });
    }
    let at_bound: Vec<&str> =
        answer.parameters.iter().filter(|p| p.at_bound).map(|p| p.name.as_str()).collect();
    if !at_bound.is_empty() {
        all.push(format!("Parameters at a bound of the vehicle file: {}.", at_bound.join(", ")));
    }
    let coloured: Vec<&str> = answer
        .outputs
        .iter()
        .filter(|(_, o)| o.whiteness.as_ref().is_some_and(|w| !w.white))
        .map(|(n, _)| n.as_str())
        .collect();
    if !coloured.is_empty() {
        all.push(format!(
            "One-step residuals are not white ({}): there is an effect that the model does not include.",
            coloured.join(", ")
        ));
    }
    if !answer.wandering_forces.is_empty() {
        all.push(format!(
            "A force that nobody measured wanders on {} (wind, a swinging load, a changing trim): it was estimated beside the \
             parameters, and is not part of the model.",
            answer.wandering_forces.join(", ")
        ));
    }
    all.extend(disturbances(answer));
    if !answer.disturbed.is_empty() {
        let answered = if answer.closed_loop { " and the controller's response to it" } else { "" };
        all.push(format!(
            "The standard errors are not reliable: they do not account for this effect{answered}; where there is \
             little other excitation, parameters can be off by many standard errors."
        ));
    }
    let mut pairs = Vec::new();
    for (i, row) in answer.correlations.iter().enumerate() {
        for (j, r) in row.iter().enumerate().take(i) {
            if r.abs() > 0.98 {
                pairs.push((r, &answer.parameters[j].name, &answer.parameters[i].name));
            }
        }
    }
    pairs.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    if let Some((r, a, b)) = pairs.first() {
        let more =
            if pairs.len() > 1 { format!(" and {} more pairs", pairs.len() - 1) } else { String::new() };
        all.push(format!("The data hardly distinguish {a} from {b} (correlation {r:.3}){more}."));
    }
    if answer.poles.iter().any(|p| p.re > 1e-6) {
        all.push("The fitted model has an unstable pole.".into());
    }
    all
}

impl Identification {
    /// The identification as text for a terminal, without colour.
    pub fn text(&self) -> String {
        let mut out = format!("{}\n\n", self.verdict);
        out.push_str(&self.parameter_rows());
        let names = self.outputs.keys().map(String::len).chain([6]).max().unwrap_or(6);
        out.push_str(&format!(
            "\n{:names$}  {:>9} {:>9}  {:>9} {:>9}  {:>12}  white\n",
            "fit, %", "free run", "one step", "held out", "one step", "noise"
        ));
        for (name, o) in &self.outputs {
            let (own, other) = (o.identification, o.control);
            let white = o.whiteness.as_ref().map_or("-".into(), |w| {
                if w.white { "yes".into() } else { format!("no ({:+.2})", w.greatest) }
            });
            out.push_str(&format!(
                "{name:names$}  {:>9} {:>9}  {:>9} {:>9}  {:>12}  {white}\n",
                percent(own.and_then(|q| q.free_run_fit)),
                percent(own.and_then(|q| q.one_step_fit)),
                percent(other.and_then(|q| q.free_run_fit)),
                percent(other.and_then(|q| q.one_step_fit)),
                o.unit.text(o.noise_std),
            ));
        }
        let poles: Vec<String> = self
            .poles
            .iter()
            .filter(|p| p.im >= 0.0)
            .map(|p| if p.im > 0.0 { format!("{:.3}±{:.3}i", p.re, p.im) } else { format!("{:.3}", p.re) })
            .collect();
        out.push_str(&format!("\npoles   {}  1/s\n", poles.join("  ")));
        let s = &self.search;
        out.push_str(&format!(
            "search  {} with {} residuals, {} iterations, {} evaluations, {:.2} s\n",
            self.method.word(),
            noise(self.noise),
            s.iterations,
            s.evaluations,
            s.seconds
        ));
        for remark in &self.remarks {
            out.push_str(&format!("note    {remark}\n"));
        }
        out
    }

    /// The parameters in the units of the vehicle file, followed by the fixed ones.
    fn parameter_rows(&self) -> String {
        let mut out = String::new();
        let width = self.parameters.iter().map(|p| p.name.len()).chain([9]).max().unwrap_or(9);
        let units = self.parameters.iter().map(|p| &p.unit).chain(self.fixed.iter().map(|f| &f.unit));
        let unit_width = units.map(|u| u.chars().count()).chain([4]).max().unwrap_or(4);
        out.push_str(&format!("{:width$}  {:>12}  {:>11}  unit\n", "parameter", "value", "std error"));
        for p in &self.parameters {
            let error = p.standard_error.map_or("-".into(), number);
            let note = if p.at_bound { "  at bound" } else { "" };
            let line = format!(
                "{:width$}  {:>12}  {error:>11}  {:unit_width$}{note}",
                p.name,
                format!("{:.4}", p.value),
                p.unit
            );
            out.push_str(&format!("{}\n", line.trim_end()));
        }
        for f in &self.fixed {
            out.push_str(&format!(
                "{:width$}  {:>12}  {:>11}  {:unit_width$}  fixed: {}\n",
                f.name,
                format!("{:.4}", f.value),
                "",
                f.unit,
                f.why
            ));
        }
        out
    }
}

/// A fit in percent. Below -100 % the model left the record, and how far says nothing.
fn percent(fit: Option<f64>) -> String {
    match fit {
        None => "-".into(),
        Some(..-100.0) => "< -100".into(),
        Some(fit) => format!("{fit:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::percent;

    #[test]
    fn a_fit_of_a_run_that_left_the_record_is_no_number() {
        let shown = [Some(97.123), Some(-99.5), Some(-3.7e8), None].map(percent);
        assert_eq!(shown, ["97.12", "-99.50", "< -100", "-"]);
    }
}
