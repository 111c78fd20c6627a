//! A test flight as text, as CSV and as a launch file.

use std::fmt::Write as _;
use whirlstand_logs::shown::ShownUnit;

use whirlstand_logs::shown::{clean, number};

use super::Flight;

impl Flight {
    /// The flight as text for a terminal, without colour.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let peaks: Vec<String> = self.peaks.iter().map(|(n, u, v)| format!("{n} {}", u.text(*v))).collect();
        let with_unit = |(name, value): &(String, f64)| format!("{name} {}", self.shown(name).text(*value));
        let inputs: Vec<String> = self.amplitudes.iter().map(with_unit).collect();
        let what = match (&self.controller, self.through.as_str()) {
            (None, _) => "inputs".to_string(),
            (Some(law), "setpoint") => format!("the setpoint under {law}"),
            (Some(law), _) => format!("added to the command of {law}"),
        };
        // Writing to a String is infallible.
        let _ = writeln!(
            out,
            "{:.1} s for '{}', {} to {}",
            self.duration_s,
            self.vehicle,
            what,
            inputs.join(", ")
        );
        if self.controller.is_some() {
            let commands: Vec<String> = self.commands.iter().map(with_unit).collect();
            let _ = writeln!(out, "predicted commands: {}", commands.join(", "));
        }
        let _ = writeln!(out, "predicted peaks: {}", peaks.join(", "));
        if !self.parameters.is_empty() {
            let _ = writeln!(out, "\n{:28} {:>12} {:>14}  unit", "parameter", "value", "std error >=");
            for p in &self.parameters {
                let error = p.standard_error.map_or("undetermined".into(), number);
                let line = format!("{:28} {:>12.4} {error:>14}  {}", p.name, p.value, p.unit);
                let _ = writeln!(out, "{}", line.trim_end());
            }
        }
        if !self.effects.is_empty() {
            let _ = writeln!(
                out,
                "\n{:18} {:24} {:>28} {:>12} {:>18}",
                "effect", "where", "size", "lambda", "least size"
            );
            for e in &self.effects {
                let size = |v: f64| e.unit.text(v);
                let _ = writeln!(
                    out,
                    "{:18} {:24} {:>28} {:>12} {:>18}",
                    e.effect,
                    e.place,
                    format!("{} {}", e.parameter, size(e.size)),
                    number(e.detectability),
                    size(e.least_size)
                );
            }
        }
        for remark in &self.remarks {
            let _ = writeln!(out, "note    {remark}");
        }
        out
    }

    /// SI unit of a test signal or an input.
    fn unit(&self, name: &str) -> &str {
        self.units.get(name).map_or("", ShownUnit::si_symbol)
    }

    /// Unit in which a test signal or an input is shown.
    fn shown(&self, name: &str) -> ShownUnit {
        self.units.get(name).cloned().unwrap_or_default()
    }

    /// The test signals as CSV, SI: time, then one column per signal.
    pub fn csv(&self) -> String {
        let mut out = String::from("t[s]");
        for (name, _) in &self.amplitudes {
            let unit = self.unit(name);
            let head = if unit.is_empty() { name.clone() } else { format!("{name}[{unit}]") };
            let _ = write!(out, ",{head}");
        }
        out.push('\n');
        let steps = self.signals.first().map_or(0, Vec::len);
        for k in 0..steps {
            let _ = write!(out, "{:.6}", k as f64 * self.period_s);
            for signal in &self.signals {
                let _ = write!(out, ",{:.9}", signal[k]);
            }
            out.push('\n');
        }
        out
    }

    /// A launch file for the test flight; `reference` is the vehicle's built-in name or path, `controller`
    /// the lines of `[controller]` besides the law. Values are those of [`Flight::csv`], with their units.
    pub fn launch(&self, reference: &str, controller: &str) -> String {
        let law = self.controller.as_deref().unwrap_or("manual");
        let role = match (&self.controller, self.through.as_str()) {
            (None, _) => "the stick is the test input",
            (Some(_), "setpoint") => "the setpoint is the test signal",
            (Some(_), _) => "the stick is a test input, added to the law's command",
        };
        let mut out = format!(
            "# A test flight designed by `whirlstand excite`: {role}.\n\
             description = \"test flight of {} for identification\"\nvehicle = {}\nmode = \"realtime\"\n\
             rate_hz = {}\nduration_s = {}\nseed = 1\n\n",
            self.vehicle,
            toml_text(reference),
            clean(1.0 / self.period_s),
            clean(self.duration_s)
        );
        let _ = writeln!(
            out,
            "# Only changes are listed; each value is held until the next one.\n{} = [",
            self.through
        );
        let mut last = vec![0.0; self.signals.len()];
        let steps = self.signals.first().map_or(0, Vec::len);
        for k in 0..steps {
            let changed: Vec<usize> = (0..last.len()).filter(|j| self.signals[*j][k] != last[*j]).collect();
            if changed.is_empty() {
                continue;
            }
            let _ = write!(out, "    {{ at_s = {:.6}", k as f64 * self.period_s);
            for j in changed {
                last[j] = self.signals[j][k];
                let value = match self.unit(&self.amplitudes[j].0) {
                    "" => format!("{:.9}", last[j]),
                    unit => toml_text(&format!("{:.9} {unit}", last[j])),
                };
                let _ = write!(out, ", {} = {value}", toml_text(&self.amplitudes[j].0));
            }
            out.push_str(" },\n");
        }
        let _ = writeln!(out, "]\n\n[plant]\nengine = \"flying\"\n\n[controller]\nlaw = {}", toml_text(law));
        if self.controller.is_some() && self.through == "stick" {
            out.push_str("add_stick = true\n");
        }
        out.push_str(controller);
        out
    }
}

fn toml_text(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}
