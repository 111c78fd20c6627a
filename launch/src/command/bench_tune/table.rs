//! Statistics over all cells.

use serde::Serialize;
use whirlstand_logs::stats;

use super::answer::{Answer, Cell, OnTruth, Outcome};
use super::cells::{Scene, scenes};

/// Least relative gain of a cell that counts: the upper interval end of the cost ratio designed / before is
/// below this.
const TO_GAIN: f64 = 0.95;

/// Goal of the median share and of each share.
const LEAST_SHARE: f64 = 0.9;

/// All cells and their statistics.
#[derive(Debug, Serialize)]
pub(super) struct Tally {
    /// Schema name, `whirlstand.bench-tune.v1`.
    pub schema: &'static str,
    /// Number of cells that can gain.
    pub to_gain: u64,
    /// Median of the shares of the cells that can gain.
    pub median_share: Option<f64>,
    /// Cells that can gain with a share below the goal.
    pub missed: Vec<String>,
    /// Cells in which the law of `tuned.toml` costs more than the old law, significantly, or loses the
    /// vehicle more often.
    pub worse: Vec<String>,
    /// Cells in which the old law loses the vehicle and the law designed on the true vehicle does not.
    pub savable: Vec<String>,
    /// Savable cells in which the law of `tuned.toml` loses the vehicle too.
    pub unsaved: Vec<String>,
    /// Cells in which the old law was kept.
    pub kept_old: u64,
    /// Cells that could not be flown.
    pub failed: Vec<String>,
    /// Results of all cells.
    pub cells: Vec<Cell>,
}

/// Class of a cell.
enum Worth {
    Saved,
    Unsaved,
    Share(f64),
    Nothing,
}

fn worth(o: &Outcome) -> Worth {
    if o.before.lost > 0.0 && o.designed.lost == 0.0 {
        return if o.after.lost == 0.0 { Worth::Saved } else { Worth::Unsaved };
    }
    let to_gain = o.before.lost == 0.0 && o.designed_over_before_high.is_some_and(|high| high < TO_GAIN);
    match o.share.filter(|_| to_gain) {
        Some(share) => Worth::Share(share),
        None => Worth::Nothing,
    }
}

fn is_worse(o: &Outcome) -> bool {
    o.after.lost > o.before.lost || o.after_over_before_low.is_some_and(|low| low > 1.0)
}

impl Tally {
    /// Computes the statistics of all cells, which are kept in the order of the table.
    pub fn new(mut cells: Vec<Cell>) -> Self {
        let order: Vec<String> = scenes().iter().map(Scene::name).collect();
        cells.sort_by_key(|cell| order.iter().position(|name| *name == cell.cell));
        let flown = || {
            cells.iter().filter_map(|c| match &c.result {
                Answer::Flown(outcome) => Some((c.cell.clone(), &**outcome)),
                Answer::Failed(_) => None,
            })
        };
        let named = |which: &dyn Fn(&Outcome) -> bool| -> Vec<String> {
            flown().filter(|(_, o)| which(o)).map(|(name, _)| name).collect()
        };
        let shares: Vec<f64> = flown()
            .filter_map(|(_, o)| match worth(o) {
                Worth::Share(share) => Some(share),
                _ => None,
            })
            .collect();
        Self {
            schema: "whirlstand.bench-tune.v1",
            to_gain: shares.len() as u64,
            median_share: (!shares.is_empty()).then(|| stats::median(&shares)),
            missed: named(&|o| matches!(worth(o), Worth::Share(share) if share < LEAST_SHARE)),
            worse: named(&is_worse),
            savable: named(&|o| matches!(worth(o), Worth::Saved | Worth::Unsaved)),
            unsaved: named(&|o| matches!(worth(o), Worth::Unsaved)),
            kept_old: named(&|o| !o.kept).len() as u64,
            failed: cells
                .iter()
                .filter(|c| matches!(c.result, Answer::Failed(_)))
                .map(|c| c.cell.clone())
                .collect(),
            cells,
        }
    }

    /// Whether every goal is met.
    pub fn is_met(&self) -> bool {
        self.median_share.is_none_or(|share| share >= LEAST_SHARE)
            && [&self.worse, &self.unsaved, &self.failed].into_iter().all(Vec::is_empty)
    }

    /// A Markdown table for each law, followed by the summary.
    pub fn text(&self) -> String {
        let parts: Vec<Vec<&str>> = self.cells.iter().map(|c| c.cell.split('/').collect()).collect();
        let part = |k: usize| {
            let mut words: Vec<&str> = Vec::new();
            for word in parts.iter().filter_map(|p| p.get(k).copied()) {
                if !words.contains(&word) {
                    words.push(word);
                }
            }
            words
        };
        let (vehicles, laws, effects) = (part(0), part(1), part(2));
        let mut text = String::new();
        for law in laws {
            let of_law = |vehicle: &str, effect: &str| {
                self.cells.iter().find(|c| c.cell == format!("{vehicle}/{law}/{effect}"))
            };
            let columns: Vec<&str> =
                vehicles.iter().copied().filter(|v| effects.iter().any(|e| of_law(v, e).is_some())).collect();
            text += &format!("| {law} | {} |\n|---|{}\n", columns.join(" | "), "---|".repeat(columns.len()));
            for effect in effects.iter().filter(|e| columns.iter().any(|v| of_law(v, e).is_some())) {
                let entries: Vec<String> =
                    columns.iter().map(|v| of_law(v, effect).map_or(String::new(), entry)).collect();
                text += &format!("| `{effect}` | {} |\n", entries.join(" | "));
            }
            text += "\n";
        }
        text + &self.summary()
    }

    /// The summary of the table, with the named causes of each cell that misses a goal.
    pub fn summary(&self) -> String {
        let share = self.median_share.map_or("none".into(), |share| format!("{share:.2}"));
        let mut text = format!(
            "{} cells, the old law kept in {}. Room for improvement in {}: median share {share}, {} of them at least \
             {LEAST_SHARE}. Lost before, but not by the law designed for the truth: {}, of which not lost after: {}.\n",
            self.cells.len(),
            self.kept_old,
            self.to_gain,
            self.to_gain - self.missed.len() as u64,
            self.savable.len(),
            self.savable.len() - self.unsaved.len()
        );
        let lists = [
            ("Share below the goal", &self.missed),
            ("Worse than before, beyond its interval", &self.worse),
            ("Lost after, but not by the law designed for the truth", &self.unsaved),
            ("Not flown", &self.failed),
        ];
        for (what, names) in lists {
            text += &format!("\n{what}:{}\n", if names.is_empty() { " none" } else { "\n" });
            for cell in self.cells.iter().filter(|c| names.contains(&c.cell)) {
                text += &format!("- {}: {}\n", cell.cell, behind(cell));
            }
        }
        text
    }
}

/// A table entry: cost before, cost after, cost of the law designed on the true vehicle, and the share.
fn entry(cell: &Cell) -> String {
    let Answer::Flown(o) = &cell.result else { return "not flown".into() };
    let after = if o.kept { cost(&o.after) } else { "kept".into() };
    let said = match worth(o) {
        Worth::Saved => ", **held**".into(),
        Worth::Unsaved => ", **not held**".into(),
        Worth::Share(share) => format!(", **{share:.2}**"),
        Worth::Nothing => String::new(),
    };
    let worse = if is_worse(o) { ", **worse**" } else { "" };
    format!("{} -> {after} ({}){said}{worse}", cost(&o.before), cost(&o.designed))
}

fn cost(law: &OnTruth) -> String {
    match law.cost {
        Some(cost) if law.lost == 0.0 => format!("{cost:.3}"),
        _ => format!("lost on {:.0} %", 100.0 * law.lost),
    }
}

/// Causes that the diagnosis named in a cell, or the reason why the cell was not flown.
fn behind(cell: &Cell) -> String {
    match &cell.result {
        Answer::Failed(why) => why.split_whitespace().collect::<Vec<_>>().join(" "),
        Answer::Flown(o) if o.named.is_empty() => format!("{}; nothing was named", entry(cell)),
        Answer::Flown(o) => format!("{}; named: {}", entry(cell), o.named.join("; ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(name: &str, costs: [Option<f64>; 3], kept: bool) -> Cell {
        let law = |cost: Option<f64>| OnTruth { cost, lost: if cost.is_some() { 0.0 } else { 1.0 } };
        let ratio = |at: usize| Some(costs[at]? / costs[0]?);
        let share = || Some((costs[0]? - costs[1]?) / (costs[0]? - costs[2]?));
        let outcome = Outcome {
            named: vec!["`input_delay` u_roll: delay_s 0.3".into()],
            kept,
            before: law(costs[0]),
            after: law(costs[1]),
            new: law(costs[1]),
            designed: law(costs[2]),
            share: share().filter(|s: &f64| s.is_finite()),
            after_over_before_low: ratio(1),
            designed_over_before_high: ratio(2),
        };
        Cell { cell: name.into(), processes: None, result: Answer::Flown(Box::new(outcome)), wall_s: 1.0 }
    }

    #[test]
    fn a_share_counts_where_there_was_something_to_gain() {
        let tally = Tally::new(vec![
            cell("quadrotor/smc/input_delay", [Some(2.0), Some(1.5), Some(1.0)], true),
            cell("quadrotor/lqr/input_delay", [Some(2.0), Some(1.0), Some(1.0)], true),
            cell("quadrotor/lqr/noise", [Some(1.0), Some(1.0), Some(0.98)], false),
        ]);
        assert_eq!((tally.to_gain, tally.median_share, tally.kept_old), (2, Some(0.75), 1));
        assert_eq!(tally.missed, ["quadrotor/smc/input_delay"]);
        assert!(!tally.is_met() && tally.worse.is_empty());
        let text = tally.text();
        assert!(text.contains("| `input_delay` | 2.000 -> 1.000 (1.000), **1.00** |"), "{text}");
        assert!(text.contains("| `noise` | 1.000 -> kept (0.980) |"), "{text}");
        assert!(text.contains("Worse than before, beyond its interval: none"), "{text}");
    }

    #[test]
    fn what_is_worse_or_lost_misses_a_goal() {
        let worse = Tally::new(vec![cell("quadrotor/ppc/noise", [Some(1.0), Some(1.1), Some(1.0)], true)]);
        assert!(!worse.is_met() && worse.worse.len() == 1, "{}", worse.text());
        let saved = Tally::new(vec![cell("quadrotor/lqr/noise", [None, Some(1.1), Some(1.0)], true)]);
        assert!(saved.is_met() && saved.savable.len() == 1 && saved.text().contains("**held**"));
        let lost = Tally::new(vec![cell("quadrotor/lqr/noise", [None, None, Some(1.0)], true)]);
        assert!(!lost.is_met() && lost.unsaved.len() == 1, "{}", lost.text());
        let failed = Cell { result: Answer::Failed("no\nlog".into()), ..lost.cells[0].clone() };
        let failed = Tally::new(vec![failed]);
        assert!(!failed.is_met() && failed.text().contains("quadrotor/lqr/noise: no log"));
    }
}
