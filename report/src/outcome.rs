//! How a bench ended, for its report.

use super::page::Level;
use whirlstand_evaluate::summary::RunSummary;
use whirlstand_msgs::units::ShownUnit;

/// How a bench ended.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    /// The verdict in a sentence: the first line of the report.
    pub verdict: String,
    /// Whether everything was as expected; `None` when nobody judged it, as for logs that were recorded
    /// earlier.
    pub ok: Option<bool>,
    /// Problems, one sentence each.
    pub problems: Vec<String>,
    /// Expectations and their results.
    pub expected: Vec<Expected>,
    /// Files beside the page: text, and path relative to the page's folder.
    pub files: Vec<(String, String)>,
}

/// One expectation and its result in a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Expected {
    /// Name of the variant, or of the bench.
    pub run: String,
    /// Key as in the launch file.
    pub key: String,
    /// The limit, SI.
    pub limit: f64,
    /// The result, SI; `None` when it never occurred or was not measured.
    pub found: Option<f64>,
    /// Unit of both values.
    pub unit: ShownUnit,
    /// Whether it holds.
    pub holds: bool,
}

impl Outcome {
    /// Rating of the verdict: bad when something failed, a warning when the run ended well but had an event worth
    /// attention.
    pub(crate) fn level(&self, summaries: &[RunSummary]) -> Level {
        let troubled = summaries.iter().any(|s| {
            s.timing.failsafe_steps + s.timing.lost + s.timing.restarts > 0
                || s.outputs.values().any(|o| o.tracked && o.recovered == Some(false))
        });
        match self.ok {
            Some(false) => Level::Bad,
            _ if !self.problems.is_empty() => Level::Bad,
            _ if troubled => Level::Warn,
            Some(true) => Level::Good,
            None => Level::Neutral,
        }
    }

    /// Remarks that are shown under the verdict.
    pub(crate) fn remarks(&self, summaries: &[RunSummary]) -> Vec<(Level, String)> {
        // Problems that the verdict already contains are not repeated.
        let further = self.problems.iter().filter(|p| !self.verdict.contains(p.as_str()));
        let mut remarks: Vec<_> = further.map(|p| (Level::Bad, p.clone())).collect();
        for s in summaries {
            let t = &s.timing;
            let mut warn = |text: String| remarks.push((Level::Warn, format!("{}: {text}", s.name)));
            if t.failsafe_steps > 0 {
                warn(format!("the plant was in failsafe for {}", count(t.failsafe_steps, "step")));
            }
            if t.restarts > 0 {
                warn(format!("{} after a node had exited", count(t.restarts, "restart")));
            }
            if t.lost > 0 {
                warn(format!("{} lost", count(t.lost, "message")));
            }
            for (name, output) in s.outputs.iter().filter(|(_, o)| o.tracked) {
                for d in output.disturbances.iter().filter(|d| d.recovery_s.is_none()) {
                    warn(format!(
                        "{name} was moved by {} by the disturbance at {:.2} s and had not recovered to within {} of {} at {:.2} s",
                        output.unit.text(d.peak),
                        d.at_s,
                        output.unit.text(d.band),
                        output.unit.text(d.baseline),
                        d.until_s
                    ));
                }
            }
        }
        remarks
    }
}

fn count(n: u64, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_outweighs_everything() {
        let outcome = |ok, problems: &[&str]| Outcome {
            ok,
            problems: problems.iter().map(|p| p.to_string()).collect(),
            ..Outcome::default()
        };
        assert_eq!(outcome(Some(true), &[]).level(&[]), Level::Good);
        assert_eq!(outcome(Some(false), &[]).level(&[]), Level::Bad);
        assert_eq!(outcome(None, &["a node died"]).level(&[]), Level::Bad);
        assert_eq!(outcome(None, &[]).level(&[]), Level::Neutral);
        assert_eq!(outcome(None, &["a node died"]).remarks(&[]), [(Level::Bad, "a node died".to_string())]);
    }
}
