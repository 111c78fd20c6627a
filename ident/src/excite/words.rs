//! A flight in words and as files.

use std::fmt::Write as _;

use whirlstand_vehicle::Vehicle;

use super::Flight;
use crate::units::{number, shown};

impl Flight {
    /// The flight as text for a terminal, without colour.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let peaks: Vec<String> = self.peaks.iter().map(|(n, u, v)| format!("{n} {}", shown(*v, u))).collect();
        let inputs: Vec<String> =
            self.amplitudes.iter().map(|(n, v)| format!("{n} {}", number(*v))).collect();
        // Writing to a String cannot fail.
        let _ =
            writeln!(out, "{:.1} s for '{}', inputs to {}", self.duration_s, self.vehicle, inputs.join(", "));
        let _ = writeln!(out, "predicted peaks: {}", peaks.join(", "));
        if !self.parameters.is_empty() {
            let _ = writeln!(out, "\n{:28} {:>12} {:>14}", "parameter", "value", "std error >=");
            for p in &self.parameters {
                let error = p.standard_error.map_or("undetermined".into(), number);
                let _ = writeln!(out, "{:28} {:>12.4} {error:>14}", p.name, p.value);
            }
        }
        if !self.effects.is_empty() {
            let _ = writeln!(
                out,
                "\n{:18} {:24} {:>16} {:>12} {:>16}",
                "effect", "where", "size", "lambda", "least size"
            );
            for e in &self.effects {
                let size = format!("{} {}", e.parameter, number(e.size));
                let _ = writeln!(
                    out,
                    "{:18} {:24} {size:>16} {:>12} {:>16}",
                    e.effect,
                    e.place,
                    number(e.detectability),
                    number(e.least_size)
                );
            }
        }
        for remark in &self.remarks {
            let _ = writeln!(out, "note    {remark}");
        }
        out
    }

    /// The inputs as CSV, SI: time, then one column an input.
    pub fn csv(&self, vehicle: &Vehicle) -> String {
        let mut out = String::from("t[s]");
        for input in &vehicle.inputs {
            let unit = input.unit.si_symbol();
            let head = if unit.is_empty() { input.name.clone() } else { format!("{}[{unit}]", input.name) };
            let _ = write!(out, ",{head}");
        }
        out.push('\n');
        let steps = self.inputs.first().map_or(0, Vec::len);
        for k in 0..steps {
            let _ = write!(out, "{:.6}", k as f64 * self.period_s);
            for input in &self.inputs {
                let _ = write!(out, ",{:.9}", input[k]);
            }
            out.push('\n');
        }
        out
    }

    /// A launch file that flies the inputs open loop; `vehicle` is a built-in name or a path.
    pub fn launch(&self, vehicle: &Vehicle, reference: &str) -> String {
        let mut out = format!(
            "# A test flight that `whirlstand excite` designed: the stick is the test input.\n\
             description = \"test flight of {} for identification\"\nvehicle = {}\nmode = \"realtime\"\n\
             rate_hz = {}\nduration_s = {}\nseed = 1\n\n",
            self.vehicle,
            toml_text(reference),
            1.0 / self.period_s,
            self.duration_s
        );
        out.push_str("# Only changes are written; a value holds until the next.\nstick = [\n");
        let mut last = vec![0.0; self.inputs.len()];
        let steps = self.inputs.first().map_or(0, Vec::len);
        for k in 0..steps {
            let changed: Vec<usize> = (0..last.len()).filter(|j| self.inputs[*j][k] != last[*j]).collect();
            if changed.is_empty() {
                continue;
            }
            let _ = write!(out, "    {{ at_s = {:.6}", k as f64 * self.period_s);
            for j in changed {
                last[j] = self.inputs[j][k];
                let _ = write!(out, ", {} = {:.9}", toml_text(&vehicle.inputs[j].name), last[j]);
            }
            out.push_str(" },\n");
        }
        out.push_str("]\n\n[plant]\nengine = \"flying\"\n\n[controller]\nlaw = \"manual\"\n");
        out
    }
}

fn toml_text(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}
