//! Rows of a table that are not part of its record.

/// How many rows of a file are left out, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LeftOutRows {
    /// Rows whose successor has other values at the same time.
    pub repeated: usize,
    /// Rows without a time, as before a clock was set.
    pub untimed: usize,
}

impl LeftOutRows {
    /// These rows in words; empty without any.
    pub fn remarks(&self) -> Vec<String> {
        let why = [
            (self.repeated, "because the row after has other values at the same time"),
            (self.untimed, "because they have no time"),
        ];
        let told = why.into_iter().filter(|(rows, _)| *rows > 0);
        told.map(|(rows, why)| format!("rows left out {why}: {rows}")).collect()
    }
}

impl std::ops::AddAssign for LeftOutRows {
    fn add_assign(&mut self, other: Self) {
        self.repeated += other.repeated;
        self.untimed += other.untimed;
    }
}
