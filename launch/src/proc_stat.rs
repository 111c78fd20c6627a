//! Which processes there are, as the kernel tells it (proc_pid_stat(5)).

/// A process that has not ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ProcStat {
    /// Its process group.
    pub group: i32,
}

impl ProcStat {
    /// A process by its number; `None` when there is none, or only a zombie that nobody has waited for.
    pub fn of(pid: i32) -> Option<Self> {
        Self::parse(&std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
    }

    /// All processes that this one may see.
    pub fn all() -> impl Iterator<Item = Self> {
        let numbers = std::fs::read_dir("/proc").into_iter().flatten().flatten();
        numbers.filter_map(|e| e.file_name().to_str()?.parse().ok()).filter_map(Self::of)
    }

    /// The fields behind the name, which stands in brackets and may hold anything: state, parent, group.
    fn parse(stat: &str) -> Option<Self> {
        let (_, fields) = stat.rsplit_once(')')?;
        let mut fields = fields.split_whitespace();
        let state = fields.next()?;
        let group = fields.nth(1)?.parse().ok()?;
        (!matches!(state, "Z" | "X" | "x")).then_some(Self { group })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_brackets_does_not_mislead_and_a_zombie_is_no_process() {
        assert_eq!(ProcStat::parse("7 (a) Z (b) S 1 42 42 0"), Some(ProcStat { group: 42 }));
        assert_eq!(ProcStat::parse("7 (sh) Z 1 42 42 0"), None);
        assert_eq!(ProcStat::parse("7 (sh"), None);
        let own = std::process::id() as i32;
        assert!(ProcStat::of(own).is_some_and(|p| ProcStat::all().any(|other| other.group == p.group)));
    }
}
