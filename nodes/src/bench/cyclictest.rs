//! Wake-up latency of the kernel, measured by Debian's rt-tests.

use std::process::{Child, Command, Stdio};
use std::time::Duration;

use super::BenchError;

/// Largest latency resolved in the histogram, us.
const BINS: u32 = 20_000;

/// A running `cyclictest`: one thread, 1 kHz, `clock_nanosleep` to absolute deadlines, as the plant.
pub(super) struct Cyclictest(Child);

/// Distribution of the wake-up latency.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WakeUpLatency {
    /// Number of wake-ups per whole microsecond of latency.
    bins: Vec<(f64, u64)>,
    /// Number of wake-ups beyond the last bin.
    overflow: u64,
    /// Largest latency, us.
    pub max_us: f64,
}

impl Cyclictest {
    /// Starts `cyclictest`; `None` when it is not installed.
    pub(super) fn start(seconds: f64, priority: Option<u8>) -> Result<Option<Self>, BenchError> {
        let mut command = Command::new("cyclictest");
        command.args(["-m", "-q", "-t", "1", "-i", "1000", "-h", &BINS.to_string()]);
        command.args(["-D", &format!("{}", seconds.ceil().max(1.0) as u64)]);
        match priority {
            Some(p) => command.args(["-p", &p.to_string()]),
            None => command.args(["--policy", "other"]),
        };
        let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        match child {
            Ok(child) => Ok(Some(Self(child))),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(BenchError::Process { what: "cannot start cyclictest".into(), source }),
        }
    }

    /// Waits for its end, which its own `-D` sets, and reads its histogram.
    pub(super) fn finish(self) -> Result<WakeUpLatency, BenchError> {
        let failed = |why: String| BenchError::Member { who: "cyclictest".into(), why };
        let output = self.0.wait_with_output().map_err(|e| failed(e.to_string()))?;
        let text = String::from_utf8_lossy(&output.stdout);
        if !output.status.success() {
            return Err(failed(String::from_utf8_lossy(&output.stderr).trim().into()));
        }
        WakeUpLatency::parse(&text).ok_or_else(|| failed(format!("no histogram in \"{text}\"")))
    }
}

impl WakeUpLatency {
    /// Reads lines `000012 000345`, `# Histogram Overflows: 00000` and `# Max Latencies: 00023`.
    fn parse(text: &str) -> Option<Self> {
        let mut wakes = Self { bins: Vec::new(), overflow: 0, max_us: f64::NAN };
        let last = |line: &str| line.split_whitespace().last().and_then(|w| w.parse::<u64>().ok());
        for line in text.lines() {
            if line.starts_with("# Histogram Overflows:") {
                wakes.overflow = last(line)?;
            } else if line.starts_with("# Max Latencies:") {
                wakes.max_us = last(line)? as f64;
            } else if !line.starts_with('#') {
                let mut words = line.split_whitespace();
                let bin = words.next().and_then(|w| w.parse::<f64>().ok());
                let count = words.next().and_then(|w| w.parse::<u64>().ok());
                if let (Some(bin), Some(count)) = (bin, count) {
                    wakes.bins.push((bin, count));
                }
            }
        }
        let total = wakes.total();
        (total > 0 && wakes.max_us.is_finite()).then_some(wakes)
    }

    fn total(&self) -> u64 {
        self.bins.iter().map(|b| b.1).sum::<u64>() + self.overflow
    }

    /// Latency that the given share of wake-ups does not exceed, us.
    pub(super) fn quantile(&self, share: f64) -> f64 {
        let wanted = (share * self.total() as f64).ceil() as u64;
        let mut seen = 0;
        for &(bin, count) in &self.bins {
            seen += count;
            if seen >= wanted {
                return bin;
            }
        }
        self.max_us
    }

    /// Number of wake-ups later than `limit`.
    pub(super) fn beyond(&self, limit: Duration) -> u64 {
        let limit = limit.as_secs_f64() * 1e6;
        self.bins.iter().filter(|b| b.0 >= limit).map(|b| b.1).sum::<u64>() + self.overflow
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_histogram_is_read() {
        let text = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000000 000000\n000003 000090\n000007 000009\n\
                    001200 000001\n# Min Latencies: 00003\n# Avg Latencies: 00015\n# Max Latencies: 01200\n\
                    # Histogram Overflows: 00000\n# Histogram Overflow at cycle number:\n# Thread 0:\n";
        let wakes = WakeUpLatency::parse(text).unwrap();
        assert_eq!((wakes.quantile(0.5), wakes.quantile(0.99), wakes.quantile(0.999)), (3.0, 7.0, 1200.0));
        assert_eq!((wakes.max_us, wakes.beyond(Duration::from_millis(1))), (1200.0, 1));
        assert_eq!(WakeUpLatency::parse("cyclictest: not found"), None);
    }
}
