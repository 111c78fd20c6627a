//! Journal of the finished flights of a campaign, from which a killed campaign resumes.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use whirlstand_campaign::{Flight, TableInfo};

use crate::error::Failure;

/// A file with one line about the campaign and then one line for each finished flight.
pub(super) struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Opens the journal of a part of a campaign. With `resume` and an existing journal, the flights in it are
    /// read back; otherwise the journal is begun anew.
    ///
    /// # Errors
    /// When it cannot be written, or belongs to another campaign.
    pub fn open(
        path: &Path,
        info: &TableInfo,
        resume: bool,
    ) -> Result<(Self, BTreeMap<u64, Flight>), Failure> {
        let done = if resume && path.exists() { earlier(path, info)? } else { BTreeMap::new() };
        // The file is rewritten and not appended to: the last line of a killed process can be incomplete.
        let unfinished = path.with_extension("jsonl.part");
        let cannot = |e: std::io::Error| Failure::file("write", path, &e);
        let file =
            OpenOptions::new().create(true).write(true).truncate(true).open(&unfinished).map_err(cannot)?;
        let mut journal = Self { path: path.into(), file };
        journal.line(&serde_json::to_string(info).map_err(Failure::run)?)?;
        for flight in done.values() {
            journal.add(flight)?;
        }
        std::fs::rename(&unfinished, path).map_err(cannot)?;
        Ok((journal, done))
    }

    /// Adds a flight to the journal.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(&mut self, flight: &Flight) -> Result<(), Failure> {
        let text = serde_json::to_string(flight).map_err(Failure::run)?;
        self.line(&text)
    }

    fn line(&mut self, text: &str) -> Result<(), Failure> {
        let line = format!("{text}\n");
        self.file.write_all(line.as_bytes()).map_err(|e| Failure::file("write", &self.path, &e))
    }

    /// Removes the journal, once every flight is in the table.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn remove(self) -> Result<(), Failure> {
        std::fs::remove_file(&self.path).map_err(|e| Failure::file("remove", &self.path, &e))
    }
}

fn earlier(path: &Path, info: &TableInfo) -> Result<BTreeMap<u64, Flight>, Failure> {
    let cannot = |e: std::io::Error| Failure::file("read", path, &e);
    let mut lines = BufReader::new(File::open(path).map_err(cannot)?).lines();
    let head = lines.next().transpose().map_err(cannot)?.unwrap_or_default();
    let same = serde_json::from_str::<TableInfo>(&head).is_ok_and(|head| head == *info);
    if !same {
        return Err(Failure::Mend(format!(
            "--resume: {} is from another campaign, part or version; remove it, or choose another folder with --out",
            path.display()
        )));
    }
    // Nothing follows an incomplete line.
    let flights = lines.map_while(Result::ok).map_while(|line| serde_json::from_str::<Flight>(&line).ok());
    Ok(flights.map(|flight| (flight.number, flight)).collect())
}

#[cfg(test)]
mod tests {
    use whirlstand_campaign::{Columns, Ended};

    use super::*;

    fn flight(number: u64) -> Flight {
        Flight {
            number,
            values: vec![],
            ended: Ended::Complete,
            holds: vec![true],
            figures: vec![Some(0.1 + 0.2)],
        }
    }

    #[test]
    fn what_was_kept_comes_back_but_half_a_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("flights.jsonl");
        let info = TableInfo {
            digest: "d".into(),
            version: "v".into(),
            flights: 9,
            shard: None,
            text: String::new(),
            columns: Columns::default(),
        };
        let (mut journal, done) = Journal::open(&path, &info, true).unwrap();
        assert!(done.is_empty());
        journal.add(&flight(4)).unwrap();
        journal.add(&flight(2)).unwrap();
        let whole = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, format!("{whole}{{\"number\": 7, \"val")).unwrap();
        let (_, done) = Journal::open(&path, &info, true).unwrap();
        assert_eq!(done.into_values().collect::<Vec<_>>(), [flight(2), flight(4)]);
        let other = TableInfo { digest: "e".into(), ..info.clone() };
        assert!(Journal::open(&path, &other, true).err().unwrap().to_string().contains("another campaign"));
        let (_, done) = Journal::open(&path, &info, false).unwrap();
        assert!(done.is_empty(), "without --resume it begins anew");
    }
}
