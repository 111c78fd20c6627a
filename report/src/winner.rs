//! A sentence on which variant of a comparison did best.

use whirlstand_evaluate::summary::{Figure, RunSummary};

use super::outcome::Expected;

/// Figures of the tracked outputs that are compared; a smaller value is better for each.
const COUNTED: [&str; 5] = ["peak", "recovery_s", "settling_s", "overshoot_percent", "iae"];
/// Relative difference below which two figures count as equal.
const DRAW: f64 = 1e-3;

/// The variant that is best in most figures of the tracked outputs, and the one that moves its inputs least. Only
/// variants that satisfy every expectation are ranked. `None` for a single run, or when no figure distinguishes
/// the variants.
pub fn winner(summaries: &[RunSummary], expected: &[Expected]) -> Option<String> {
    if summaries.len() < 2 {
        return None;
    }
    let holds = |s: &&RunSummary| !expected.iter().any(|e| e.run == s.name && !e.holds);
    let ranked: Vec<&RunSummary> = summaries.iter().filter(holds).collect();
    let mut wins = vec![0usize; ranked.len()];
    let mut figures = 0;
    let tracked = ranked.first()?.outputs.iter().filter(|(_, o)| o.tracked).map(|(name, _)| name);
    for name in tracked {
        for key in COUNTED {
            if let Some(best) = best(&ranked, &format!("{name}.{key}")) {
                figures += 1;
                wins[best] += 1;
            }
        }
    }
    let most = *wins.iter().max().filter(|n| **n > 0)?;
    let first: Vec<&str> = named(&ranked, |i| wins[i] == most);
    let quiet = quietest(&ranked).map_or(String::new(), |name| match first.as_slice() {
        [only] if *only == name => format!(" {name} also moves its inputs least."),
        _ => format!(" {name} moves its inputs least."),
    });
    let verb = if first.len() == 1 { "is" } else { "are each" };
    let others: Vec<String> = ranked
        .iter()
        .zip(&wins)
        .filter(|(_, n)| **n < most)
        .map(|(s, n)| format!("{} in {n}", s.name))
        .collect();
    let others = if others.is_empty() { String::new() } else { format!(" ({})", others.join(", ")) };
    let left_out = summaries.len() - ranked.len();
    let left_out = match left_out {
        0 => String::new(),
        1 => " One variant that does not meet its expectations is not ranked.".into(),
        n => format!(" {n} variants that do not meet their expectations are not ranked."),
    };
    Some(format!(
        "{} {verb} best in {most} of {figures} figures of the tracked outputs{others}.{quiet}{left_out}",
        first.join(" and ")
    ))
}

fn named<'a>(ranked: &[&'a RunSummary], which: impl Fn(usize) -> bool) -> Vec<&'a str> {
    ranked.iter().enumerate().filter(|(i, _)| which(*i)).map(|(_, s)| s.name.as_str()).collect()
}

/// The variant whose figure is smallest by more than [`DRAW`]; a variant without a value is worst.
fn best(ranked: &[&RunSummary], key: &str) -> Option<usize> {
    let value = |s: &&RunSummary| match s.figure(key) {
        Some(Figure::Value(v)) => Some(v),
        Some(Figure::Never) => Some(f64::INFINITY),
        _ => None,
    };
    let values: Vec<f64> = ranked.iter().map(value).collect::<Option<_>>()?;
    least(&values)
}

/// Index of the smallest value; `None` when another value is equally good.
fn least(values: &[f64]) -> Option<usize> {
    let (at, least) = values.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let beyond = least + DRAW * least.abs();
    let alone = values.iter().enumerate().all(|(i, v)| i == at || *v > beyond);
    alone.then_some(at)
}

/// The variant with the least total variation of every input.
fn quietest<'a>(ranked: &[&'a RunSummary]) -> Option<&'a str> {
    let mut quietest =
        ranked.first()?.inputs.keys().map(|name| best(ranked, &format!("{name}.travel_per_s")));
    let first = quietest.next()??;
    quietest.all(|other| other == Some(first)).then(|| ranked[first].name.as_str())
}

#[cfg(test)]
mod tests {
    use super::least;

    #[test]
    fn a_draw_has_no_winner() {
        assert_eq!(least(&[3.0, 2.0, 2.5]), Some(1));
        assert_eq!(least(&[2.001, 2.0, 2.5]), None);
        assert_eq!(least(&[0.0, 0.0]), None);
        assert_eq!(least(&[f64::INFINITY, 1.0]), Some(1));
        assert_eq!(least(&[f64::INFINITY, f64::INFINITY]), None);
    }
}
