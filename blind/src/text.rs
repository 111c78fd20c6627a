//! The text form of a tally.

use std::fmt::Write;

use super::score::{Outcome, Scored, truth_name};
use super::tally::{Goal, Tally};

impl Tally {
    /// Goals, classes, confusions and failures as text; writing to a string cannot fail.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let _ = writeln!(out, "{:<44} {:>8}  {:>9}  {:<15} goal", "", "", "trials", "95 % interval");
        for goal in &self.goals {
            let _ = writeln!(out, "{}", line(goal));
        }
        let _ = writeln!(out, "\nsingle effects by detectability");
        for class in &self.classes {
            if class.outcomes.is_empty() {
                continue;
            }
            let range = match class.to {
                to if to > 1e6 => format!("{} and more", class.from),
                to => format!("{} to {to}", class.from),
            };
            let _ = writeln!(out, "  {range:<18} {}", outcomes(&class.outcomes));
        }
        let _ = writeln!(out, "\nconfusion of effects with detectability above 30");
        for row in &self.confusion {
            let mut named: Vec<(&String, &usize)> = row.named.iter().collect();
            named.sort_by(|a, b| (b.1, a.0).cmp(&(a.1, b.0)));
            let named: Vec<String> = named.iter().map(|(name, count)| format!("{name} {count}")).collect();
            let _ = writeln!(out, "  {:<21} {}", row.truth, named.join(", "));
        }
        let failures: Vec<&Scored> = self.failures().collect();
        if !failures.is_empty() {
            let _ = writeln!(out, "\n{} of these trials were not diagnosed correctly", failures.len());
        }
        for trial in failures {
            let _ = writeln!(out, "  {}", failure(trial));
        }
        if self.skipped > 0 {
            let _ = writeln!(
                out,
                "\n{} trials were skipped because their effects are not applicable here or cannot be detected",
                self.skipped
            );
        }
        out
    }
}

/// Text of a trial, with the truth revealed.
pub fn opened(trial: &Scored) -> String {
    let a = &trial.answer;
    let mut out = format!(
        "{}: {}, {}{} for {:.0} s at {:.0} Hz, {}{} noise\n",
        a.number,
        a.vehicle,
        a.excitation.name(),
        if a.closed_loop { " in closed loop" } else { "" },
        a.duration_s,
        a.rate_hz,
        if a.noise_declared { "" } else { "undeclared " },
        a.noise.name()
    );
    for truth in &a.effects {
        let parameters: Vec<String> =
            truth.parameters.iter().map(|(name, value)| format!("{name} = {value:.6}")).collect();
        let to = truth.to.as_ref().map_or(String::new(), |to| format!(", to {to}"));
        let _ = writeln!(
            out,
            "hidden   {} with {}{to}; detectability {:.0}",
            truth_name(truth),
            parameters.join(", "),
            truth.lambda
        );
    }
    for (name, alike) in a.effects.iter().filter_map(|t| t.nearest.as_ref()) {
        let _ =
            writeln!(out, "         outside the table; |cos| {alike:.2} to {name}, the most similar effect");
    }
    if a.effects.is_empty() {
        out.push_str("hidden   nothing\n");
    }
    let named = match &trial.failure {
        Some(reason) => reason.clone(),
        None if trial.named.is_empty() => "nothing".into(),
        None => trial.named.join(", "),
    };
    let _ = writeln!(out, "named    {named} ({})", trial.verdict);
    for p in &trial.parameters {
        let inside = match p.inside {
            Some(true) => ", inside its interval",
            Some(false) => ", OUTSIDE its interval",
            None => "",
        };
        let _ = writeln!(out, "         {} = {:.6}, true {:.6}{inside}", p.name, p.value, p.truth);
    }
    if let Some(heldout) = trial.heldout {
        let _ = writeln!(out, "held-out error over the noise floor {heldout:.3}");
    }
    if let Some(kappa) = trial.kappa {
        let _ = writeln!(out, "confusability of the first named effect with the truth {kappa:.3}");
    }
    let _ = writeln!(out, "outcome  {}", word(trial.outcome));
    out
}

fn line(goal: &Goal) -> String {
    let rate = goal.hits.is_some();
    let figure = |v: f64| if rate { format!("{:.1} %", 100.0 * v) } else { format!("{v:.3}") };
    let value = goal.value.map_or("-".into(), figure);
    let counts = goal.hits.map_or(format!("{}", goal.of), |hits| format!("{hits}/{}", goal.of));
    let interval = goal
        .interval
        .map_or(String::new(), |(low, high)| format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high));
    let limit = match (goal.at_least, goal.at_most) {
        (Some(least), Some(most)) => format!("{} to {}", figure(least), figure(most)),
        (Some(least), None) => format!(">= {}", figure(least)),
        (None, Some(most)) => format!("<= {}", figure(most)),
        (None, None) => String::new(),
    };
    let met = match goal.met {
        Some(true) => "met".into(),
        Some(false) => "MISSED".into(),
        None => format!("undecided: {} cases are needed", goal.least_cases),
    };
    format!("{:<44} {value:>8}  {counts:>9}  {interval:<15} {limit} {met}", goal.name).trim_end().to_string()
}

fn outcomes(counts: &std::collections::BTreeMap<Outcome, usize>) -> String {
    let parts = counts.iter().map(|(outcome, count)| format!("{} {count}", word(*outcome)));
    parts.collect::<Vec<_>>().join(", ")
}

fn word(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Right => "right",
        Outcome::Alike => "named as an equivalent effect",
        Outcome::Listed => "listed as indistinguishable",
        Outcome::Wrong => "wrong",
        Outcome::Half => "one of two",
        Outcome::Missed => "missed",
        Outcome::Failed => "failed",
    }
}

fn failure(trial: &Scored) -> String {
    let truths: Vec<String> = trial
        .answer
        .effects
        .iter()
        .map(|t| match trial.answer.case {
            super::Case::Outside => format!("{} [{:.0}]", t.effect, t.lambda),
            _ => format!("{} [{:.0}]", truth_name(t), t.lambda),
        })
        .collect();
    let truth = if truths.is_empty() { "clean".into() } else { truths.join(" + ") };
    let named = match (&trial.failure, trial.named.is_empty()) {
        (Some(reason), _) => reason.lines().next().unwrap_or_default().to_string(),
        (None, true) => trial.verdict.clone(),
        (None, false) => trial.named.join(" + "),
    };
    let kappa = trial.kappa.map_or(String::new(), |k| format!(" kappa {k:.2}"));
    format!("{:<9} {:<7} {truth} -> {named}{kappa}", trial.answer.number, word(trial.outcome))
}
