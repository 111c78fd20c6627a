//! The launch file of a vehicle behind a bridge.

use std::path::{Path, PathBuf};

/// What differs from one to the next.
pub struct Bridged<'a> {
    /// `bridge` of the plant's node, and the table of its link.
    pub bridge: &'a str,
    pub vehicle: &'a str,
    pub rate_hz: u32,
    pub duration_s: u32,
    /// Keys of `[bridge.safety]`.
    pub safety: &'a str,
    pub link: String,
    /// Further keys of the bridge's table, and tables behind it.
    pub more: &'a str,
}

impl Bridged<'_> {
    /// Writes it as `bridge.toml`. Keys of `more` begin in line 17.
    pub fn write(&self, dir: &Path) -> PathBuf {
        let Self { bridge, vehicle, rate_hz, duration_s, safety, link, more } = self;
        let text = format!(
            r#"vehicle = {vehicle:?}
rate_hz = {rate_hz}.0
duration_s = {duration_s}.0

[controller]
law = "lqr"

[nodes.plant]
bridge = "{bridge}"

[bridge.safety]
command_timeout_s = 5.0       # a busy test machine is not what is tested
max_innovation = 1e9          # most vehicles here fly a wave that obeys nobody, or are pushed
{safety}
[bridge.{bridge}]
link = "{link}"
{more}
"#
        );
        let path = dir.join("bridge.toml");
        std::fs::write(&path, text).unwrap();
        path
    }
}
