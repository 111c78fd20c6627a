//! What the fuzz targets in `tests/` share: an input is a script of edits of a small file that is right, so that inputs get
//! behind magic numbers, lengths and the names of fields; or, now and then, the whole file. `docs/architecture.md` says how to
//! run the targets.

// What the fuzzing engine's coverage calls must be there in each test program, this library's own too.
#[cfg(test)]
use bolero as _;

pub mod seeds;

use std::path::PathBuf;

use tempfile::TempDir;
use whirlstand_logs::{Mapping, info, read};

/// Most edits of a script.
const EDITS: usize = 8;

/// Numbers at which decoders go wrong: little-endian, of one to eight bytes.
const EXTREMES: [&[u8]; 12] = [
    &[0],
    &[0xff],
    &[0x7f],
    &[0, 0],
    &[0xff, 0xff],
    &[0xff, 0xff, 0xff, 0x7f],
    &[0xff; 4],
    &[0, 0, 0xc0, 0x7f],
    &[0, 0, 0x80, 0xff],
    &[0xff; 8],
    &[0, 0, 0, 0, 0, 0, 0xf0, 0x7f],
    &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f],
];

/// A file after the script of an input; `words` are what the format knows, of any of which more may come anywhere.
pub fn edited(file: &[u8], input: &[u8], words: &[&[u8]]) -> Vec<u8> {
    let Some((&first, script)) = input.split_first() else { return file.to_vec() };
    if first == 0xff {
        return script.to_vec();
    }
    let mut bytes = file.to_vec();
    for edit in script.chunks_exact(4).take(1 + usize::from(first) % EDITS) {
        let [op, high, low, argument] = *edit else { continue };
        let share = usize::from(u16::from_be_bytes([high, low]));
        // Half of the edits are aimed at the beginning, where everything else is defined.
        let reach = if op & 0x80 == 0 { bytes.len() } else { bytes.len().min(256) };
        let at = share * reach >> 16;
        let many = (at + 1 + usize::from(argument) % 48).min(bytes.len());
        let word = words.get(usize::from(argument) % words.len().max(1)).copied().unwrap_or_default();
        let extreme = EXTREMES[usize::from(argument) % EXTREMES.len()];
        match op & 7 {
            0 => overwrite(&mut bytes, at, &[argument]),
            1 => overwrite(&mut bytes, at, extreme),
            2 => _ = bytes.splice(at..at, word.iter().copied()),
            3 => overwrite(&mut bytes, at, word),
            4 => _ = bytes.drain(at..many),
            5 => {
                let copy = bytes[at..many].to_vec();
                let to = usize::from(argument) * bytes.len() >> 8;
                bytes.splice(to..to, copy);
            }
            6 => bytes.iter_mut().skip(at).take(1).for_each(|b| *b ^= 1 << (argument % 8)),
            _ if argument > 0xe0 => bytes.truncate(at),
            _ => _ = bytes.splice(at..at, extreme.iter().copied()),
        }
    }
    bytes
}

fn overwrite(bytes: &mut [u8], at: usize, with: &[u8]) {
    bytes.iter_mut().skip(at).zip(with).for_each(|(old, new)| *old = *new);
}

/// A file that is written anew for every input.
pub struct Sheet {
    path: PathBuf,
    name: &'static str,
    _folder: TempDir,
}

impl Sheet {
    /// A file of this name in memory, or where temporary files are.
    pub fn new(name: &'static str) -> Self {
        let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a folder");
        Self { path: folder.path().join(name), name, _folder: folder }
    }

    /// Reads the bytes as a log, with all that is made of one: a record of no more than `most` points, or an error that
    /// names the file.
    pub fn is_survived(&self, bytes: &[u8], mappings: &[Mapping], most: usize) {
        std::fs::write(&self.path, bytes).expect("room for the file");
        match read(&self.path, mappings) {
            Ok(record) => assert!(record.len() <= most, "{} points of {} bytes", record.len(), bytes.len()),
            Err(error) => assert!(error.to_string().contains(self.name), "{error}"),
        }
        if let Err(error) = info(&self.path) {
            assert!(error.to_string().contains(self.name), "{error}");
        }
    }

    /// Where it is.
    pub fn path(&self) -> &std::path::Path {
        &self.path
    }
}
