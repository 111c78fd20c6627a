//! The answer for a terminal: at most fifteen lines of text.

use whirlstand_logs::shown::instant;

use crate::answer::schema::{Diagnosis, Refitted, Verdict, short};

/// Most parameters that are shown as fitted anew; JSON and report have all.
const REFITTED_SHOWN: usize = 4;

impl Diagnosis {
    /// The diagnosis as at most 15 lines of text, without colour.
    pub fn text(&self) -> String {
        let mut lines = vec![wrapped(&self.summary)];
        let named = matches!(self.verdict, Verdict::Explained | Verdict::PartlyExplained);
        for cause in self.causes.iter().filter(|_| named).take(4) {
            let e = &cause.evidence;
            let mut line = format!(
                "  {} on {}: BIC {:+.0}, held out {:+.1} sigma, {:.0} % of the residual",
                cause.effect,
                cause.place,
                e.delta_bic,
                e.heldout_gain_sigma,
                100.0 * e.share_of_residual
            );
            if let Some(note) = cause.notes.last() {
                line.push_str(&format!("; {note}"));
            }
            lines.push(line);
        }
        if !self.refitted.is_empty() {
            lines.push(format!("fitted anew: {}", self.refitted_text()));
        }
        if let Some(near) = self.rejected.first() {
            lines.push(format!("  nearest rejected: {} on {}: {}", near.effect, near.place, near.why));
        }
        for finding in self.data.iter().filter(|f| !f.blocking).take(2) {
            lines.push(format!("  data: {}", finding.text));
        }
        // Where a free run is not meaningful, only predictions over the horizon are shown.
        let free = self.outputs.values().any(|o| o.fit_before.is_some());
        let horizon = format!("predictions over {} s", short(self.heldout.horizon_s));
        let known = self.outputs.values().any(|o| o.noise_floor > 0.0);
        lines.push(format!(
            "held out {} to {} s, {}: fit before -> after{}",
            instant(self.heldout.from_s),
            instant(self.heldout.to_s),
            if free { format!("free run ({horizon})") } else { horizon },
            if known { ", error after / noise" } else { "" }
        ));
        let percent = |v: Option<f64>| v.map_or("-".to_string(), |v| format!("{v:.1} %"));
        let mut outputs: Vec<String> = Vec::new();
        for (name, o) in &self.outputs {
            let fits = |(before, after)| format!("{} -> {}", percent(before), percent(after));
            let ahead = fits((o.horizon_fit_before, o.horizon_fit_after));
            let (figures, rmse) = if free {
                (format!("{} ({ahead})", fits((o.fit_before, o.fit_after))), o.rmse_after)
            } else {
                (ahead, o.horizon_rmse_after)
            };
            let ratio = rmse.filter(|_| o.noise_floor > 0.0).map(|e| e / o.noise_floor);
            let ratio = ratio.map_or(String::new(), |r| format!(", {r:.2}"));
            let share = o
                .noise_model_share
                .map_or(String::new(), |s| format!(", {:.0} % attributed to noise", 100.0 * s));
            outputs.push(format!("{name} {figures}{ratio}{share}"));
        }
        for pair in outputs.chunks(if free { 1 } else { 2 }).take(4) {
            lines.push(format!("  {}", pair.join("   ")));
        }
        if named && !self.unexplained.description.is_empty() {
            lines.push(format!("remaining: {}", self.unexplained.description));
        }
        for advice in self.advice.iter().take(2) {
            lines.push(format!("next: {advice}"));
        }
        lines.truncate(15);
        lines.join("\n") + "\n"
    }

    /// The parameters that were fitted anew, as far as their shown values changed, the largest relative change first.
    fn refitted_text(&self) -> String {
        let mut moved: Vec<&Refitted> =
            self.refitted.iter().filter(|r| short(r.given) != short(r.value)).collect();
        let change = |r: &Refitted| (r.value - r.given).abs() / r.given.abs().max(f64::MIN_POSITIVE);
        moved.sort_by(|a, b| change(b).total_cmp(&change(a)));
        moved.truncate(REFITTED_SHOWN);
        let one =
            |r: &&Refitted| format!("{} {} -> {} {}", r.parameter, short(r.given), short(r.value), r.unit);
        let mut all: Vec<String> = moved.iter().map(|r| one(r).trim_end().to_string()).collect();
        match (all.is_empty(), self.refitted.len() - all.len()) {
            (true, same) => all.push(format!("{same} free parameters, with the values of the file")),
            (false, 0) => {}
            (false, more) => all.push(format!("and {more} that changed less")),
        }
        all.join(", ")
    }
}

fn wrapped(text: &str) -> String {
    text.trim().to_string()
}
