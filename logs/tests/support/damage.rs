//! What damage may do to a log of any format: its readable part is left, or an error that names the file.

use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use whirlstand_logs::{Mapping, info, read};

pub fn mappings(texts: &[&str]) -> Vec<Mapping> {
    texts.iter().map(|t| t.parse().unwrap()).collect()
}

/// A file of the given name.
pub fn written(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

/// Cuts a log every so many bytes: the record never gets shorter as the log gets longer. The longest record, in points.
pub fn cut_anywhere(name: &str, whole: &[u8], every: usize, maps: &[Mapping]) -> usize {
    let folder = tempfile::tempdir().unwrap();
    let mut longest = 0;
    for end in (0..whole.len()).step_by(every) {
        match read(written(folder.path(), name, &whole[..end]), maps) {
            Ok(record) => {
                assert!(record.len() >= longest, "{end}");
                longest = record.len();
            }
            Err(error) => assert!(longest == 0 && error.to_string().contains(name), "{end}: {error}"),
        }
    }
    longest
}

/// Bytes to be changed, as shares of what they may be in, with what; and which share of the log is left.
#[derive(Debug, Clone)]
pub struct Damage {
    flips: Vec<(f64, u8)>,
    cut: f64,
    early: bool,
}

/// Half of the cases are aimed at the beginning of a log, half at all of it; some are cut.
pub fn damage() -> impl Strategy<Value = Damage> {
    let flips = prop::collection::vec((0.0f64..1.0, 1u8..), 0..8);
    (flips, 0.0f64..1.5, any::<bool>()).prop_map(|(flips, cut, early)| Damage { flips, cut, early })
}

impl Damage {
    /// Damages a log and reads it; a record has at most so many points.
    pub fn is_survived(
        &self,
        name: &str,
        mut bytes: Vec<u8>,
        beginning: usize,
        (maps, most): (&[Mapping], usize),
    ) -> Result<(), TestCaseError> {
        let folder = tempfile::tempdir().unwrap();
        for (at, xor) in &self.flips {
            let reach = if self.early { beginning } else { bytes.len() };
            bytes[(at * reach as f64) as usize] ^= xor;
        }
        bytes.truncate((bytes.len() as f64 * self.cut) as usize);
        let path = written(folder.path(), name, &bytes);
        match read(&path, maps) {
            Ok(record) => prop_assert!(record.len() <= most, "{} points", record.len()),
            Err(error) => prop_assert!(error.to_string().contains(name), "{error}"),
        }
        let _ = info(&path);
        Ok(())
    }
}
