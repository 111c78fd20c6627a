//! Processor load of a node's process (proc_pid_stat(5)).

use std::time::Instant;

/// Time between two measurements, s: the kernel counts in hundredths of a second.
const PERIOD_S: f64 = 1.0;

/// Ticks per second of the kernel's counters, as Linux presents them to programs (USER_HZ).
const TICKS_PER_S: f64 = 100.0;

/// Processor time of one process between two measurements.
#[derive(Debug, Default)]
pub(crate) struct CpuMeter {
    last: Option<(u32, Instant, u64)>,
    percent: Option<f64>,
}

impl CpuMeter {
    /// Measures the process when a measurement is due. A process of that number that is not the node belongs to a
    /// bench on another machine.
    pub fn look(&mut self, node: &str, pid: u32, now: Instant) {
        let since = |at: Instant| now.saturating_duration_since(at).as_secs_f64();
        let last = self.last.filter(|(before, _, _)| *before == pid);
        if last.is_some_and(|(_, at, _)| since(at) < PERIOD_S) {
            return;
        }
        let ticks = is_node(node, pid).then(|| ticks(pid)).flatten();
        self.percent = match (last, ticks) {
            (Some((_, at, before)), Some(ticks)) => {
                Some(100.0 * ticks.saturating_sub(before) as f64 / TICKS_PER_S / since(at))
            }
            _ => None,
        };
        self.last = Some((pid, now, ticks.unwrap_or(0)));
    }

    /// Share of one processor, %.
    pub fn percent(&self) -> Option<f64> {
        self.percent
    }
}

fn is_node(node: &str, pid: u32) -> bool {
    let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    let mut words = line.split(|b| *b == 0).skip(1);
    words.next() == Some(b"node".as_slice()) && words.next() == Some(node.as_bytes())
}

fn ticks(pid: u32) -> Option<u64> {
    parse(&std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
}

/// User and system time, the 14th and 15th field. The name before them is in brackets and may hold any
/// character.
fn parse(stat: &str) -> Option<u64> {
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace().skip(11).map_while(|f| f.parse::<u64>().ok());
    Some(fields.next()? + fields.next()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_is_user_and_system_time() {
        assert_eq!(parse("7 (a) b) S 1 7 7 0 -1 64 5 0 0 0 30 12 0 0 20"), Some(42));
        assert_eq!(parse("7 (a"), None);
        let mut meter = CpuMeter::default();
        meter.look("plant", std::process::id(), Instant::now());
        assert_eq!(meter.percent(), None, "a test is no node");
    }
}
