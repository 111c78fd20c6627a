//! A transmitter module and a receiver for CRSF and SBUS on pseudo-terminals, with a vehicle behind them.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json as value};

use super::bridged::Bridged;
use super::run;

/// Paths of the module's line, of the receiver's line, and of the report of both.
pub struct Place {
    pub dir: tempfile::TempDir,
    pub module: PathBuf,
    pub receiver: PathBuf,
    pub report: PathBuf,
}

impl Place {
    pub fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let [module, receiver, report] = ["module", "receiver", "report.json"].map(|n| dir.path().join(n));
        Self { dir, module, receiver, report }
    }

    /// As [`Place::radio`], with a vehicle that flies by the channels and reports its attitude every `every` periods,
    /// `late` periods late.
    pub fn vehicle(&self, script: &Value, every: u32, late: u32) -> Command {
        self.flying(script, &value!({"every": every, "late": late}))
    }

    pub fn flying(&self, script: &Value, vehicle: &Value) -> Command {
        let mut radio = self.radio(&script.to_string());
        radio.arg(vehicle.to_string());
        radio
    }

    /// Writes a built-in vehicle of which only roll and pitch are measured, as reported by CRSF, followed by `more`.
    pub fn vehicle_file(&self, builtin: &str, more: &str) -> String {
        let shown = run(["vehicle", "show", builtin]).success().stdout;
        let mut file: toml::Table = shown.parse().unwrap();
        let told = |output: &toml::Value| ["roll", "pitch"].contains(&output["name"].as_str().unwrap());
        file["outputs"].as_array_mut().unwrap().retain(told);
        let path = self.dir.path().join(format!("{builtin}.toml"));
        std::fs::write(&path, format!("{file}\n{more}")).unwrap();
        path.display().to_string()
    }

    pub fn radio(&self, script: &str) -> Command {
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bridge/radio.py");
        // The Python of the tests, where there is one, has a second parser for the same frames.
        let mut radio =
            Command::new(std::env::var_os("WHIRLSTAND_PYTHON").unwrap_or_else(|| "python3".into()));
        radio.arg(program).args([&self.module, &self.receiver, &self.report]).arg(script);
        radio
    }

    pub fn launch(&self) -> String {
        self.launch_of("quadrotor", "stale_s = 1.0", "")
    }

    pub fn launch_of(&self, vehicle: &str, safety: &str, more: &str) -> String {
        let pilot = format!(
            "[bridge.pilot]\nsource = \"sbus\"\nlink = \"serial://{}:100000:8E2\"\n{more}",
            self.receiver.display()
        );
        let bridged = Bridged {
            bridge: "crsf",
            vehicle,
            rate_hz: 100,
            duration_s: 1000,
            safety,
            link: format!("serial://{}:420000", self.module.display()),
            more: &pilot,
        };
        bridged.write(self.dir.path()).display().to_string()
    }
}
