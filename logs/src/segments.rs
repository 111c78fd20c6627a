//! The files of one log: `log.mcap`, `log.2.mcap`, `log.3.mcap` and so on.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::read_error::ReadError;

/// The files of a log by number, and the name of its first file, which has number 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segments {
    first: PathBuf,
    files: BTreeMap<u32, PathBuf>,
}

impl Segments {
    /// Finds the files of the log whose first file is, or was, `first`.
    pub fn of(first: &Path) -> Self {
        let parent = first.parent().filter(|parent| !parent.as_os_str().is_empty());
        let entries = std::fs::read_dir(parent.unwrap_or(Path::new("."))).into_iter().flatten().flatten();
        let files = entries.filter_map(|entry| {
            let name = entry.file_name();
            let number = number_of(&name.to_string_lossy(), first)?;
            entry.path().is_file().then(|| (number, first.with_file_name(name)))
        });
        Self { first: first.into(), files: files.collect() }
    }

    /// The files, in order.
    pub fn files(&self) -> impl Iterator<Item = &PathBuf> {
        self.files.values()
    }

    /// The name for the next file.
    pub fn next(&self) -> PathBuf {
        match self.files.last_key_value() {
            None => self.first.clone(),
            Some((last, _)) => name(&self.first, last.saturating_add(1)),
        }
    }

    /// Adds a file with the number in its name.
    pub fn add(&mut self, path: &Path) {
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(number) = number_of(&file, &self.first) {
            self.files.insert(number, path.into());
        }
    }

    /// Takes a file out.
    pub fn remove(&mut self, path: &Path) {
        self.files.retain(|_, file| file != path);
    }

    /// Takes the oldest file out when there are more than `most`.
    pub fn pop_oldest_beyond(&mut self, most: usize) -> Option<PathBuf> {
        (self.files.len() > most).then(|| self.files.pop_first())?.map(|(_, path)| path)
    }

    /// The missing files between the first and the last one.
    pub fn missing(&self) -> Vec<PathBuf> {
        let (Some((from, _)), Some((to, _))) = (self.files.first_key_value(), self.files.last_key_value())
        else {
            return Vec::new();
        };
        let absent = |n: &u32| !self.files.contains_key(n);
        // A name given by hand may have any number.
        (*from..*to).filter(absent).take(10).map(|n| name(&self.first, n)).collect()
    }
}

fn name(first: &Path, number: u32) -> PathBuf {
    if number <= 1 {
        return first.into();
    }
    let stem = first.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let extension = first.extension().map_or(String::new(), |e| format!(".{}", e.to_string_lossy()));
    first.with_file_name(format!("{stem}.{number}{extension}"))
}

/// The number of the file called `file` in the log that begins with `first`.
fn number_of(file: &str, first: &Path) -> Option<u32> {
    if file == first.file_name()?.to_string_lossy() {
        return Some(1);
    }
    let stem = first.file_stem()?.to_string_lossy().into_owned();
    let extension = first.extension()?.to_string_lossy().into_owned();
    let digits = file.strip_prefix(&format!("{stem}."))?.strip_suffix(&format!(".{extension}"))?;
    let number: u32 = digits.parse().ok().filter(|n| *n >= 2)?;
    (number.to_string() == digits).then_some(number)
}

/// The name of the first file of the log that has `path` as one of its later files.
fn first_of(path: &Path) -> Option<PathBuf> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let (stem, _) = stem.rsplit_once('.')?;
    let first = path.with_file_name(format!("{stem}.{}", path.extension()?.to_string_lossy()));
    number_of(&path.file_name()?.to_string_lossy(), &first)?;
    Some(first)
}

/// The files of the log that `path` stands for; `None` when `path` is a single file, or does not exist.
fn whole(path: &Path) -> Option<Segments> {
    let first = if path.is_dir() { path.join("log.mcap") } else { path.to_path_buf() };
    let begins = |first: &Path| {
        let segments = Segments::of(first);
        let oldest = segments.files().next()?;
        (path.is_dir() || !path.exists() || oldest == path).then_some(segments)
    };
    // The oldest existing file may be a later one of the log.
    first_of(&first).and_then(|first| begins(&first)).or_else(|| begins(&first))
}

/// The files of the log at `path`, in order. A folder stands for its `log.mcap`. With the first file, all later
/// ones are included; the first one is the oldest that exists, because a recorder may have been told to remove
/// older ones. A later file stands for itself only.
///
/// # Errors
/// [`ReadError::NoLog`] for a folder without a log.
pub fn log_files(path: impl AsRef<Path>) -> Result<Vec<PathBuf>, ReadError> {
    let path = path.as_ref();
    match whole(path) {
        Some(segments) => Ok(segments.files().cloned().collect()),
        None if path.is_dir() => Err(ReadError::NoLog { path: path.into() }),
        None => Ok(vec![path.into()]),
    }
}

/// Files that are missing within the log at `path`.
pub(crate) fn missing_files(path: &Path) -> Vec<PathBuf> {
    whole(path).map_or(Vec::new(), |segments| segments.missing())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(files: &[PathBuf]) -> Vec<String> {
        files.iter().map(|f| f.file_name().unwrap().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn the_oldest_file_or_the_folder_stands_for_all_and_a_later_one_for_itself() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in
            ["log.mcap", "log.2.mcap", "log.10.mcap", "log.9.mcap", "log.02.mcap", "log.x.mcap", "a.2.mcap"]
        {
            std::fs::write(at(name), "").unwrap();
        }
        let all = ["log.mcap", "log.2.mcap", "log.9.mcap", "log.10.mcap"];
        assert_eq!(names(&log_files(folder.path()).unwrap()), all);
        assert_eq!(names(&log_files(at("log.mcap")).unwrap()), all);
        assert_eq!(names(&log_files(at("log.9.mcap")).unwrap()), ["log.9.mcap"]);
        assert_eq!(names(&log_files(at("log.02.mcap")).unwrap()), ["log.02.mcap"]);
        let missing = Segments::of(&at("log.mcap")).missing();
        assert_eq!(names(&missing)[..2], ["log.3.mcap", "log.4.mcap"]);
        // The recorder kept only the last files.
        std::fs::remove_file(at("log.mcap")).unwrap();
        std::fs::remove_file(at("log.2.mcap")).unwrap();
        for path in [folder.path().to_path_buf(), at("log.mcap"), at("log.9.mcap")] {
            assert_eq!(names(&log_files(path).unwrap()), ["log.9.mcap", "log.10.mcap"]);
        }
        assert_eq!(names(&log_files(at("log.10.mcap")).unwrap()), ["log.10.mcap"]);
    }

    #[test]
    fn no_file_is_written_over_and_the_oldest_go_first() {
        let folder = tempfile::tempdir().unwrap();
        let first = folder.path().join("log.mcap");
        let mut segments = Segments::of(&first);
        for expected in ["log.mcap", "log.2.mcap", "log.3.mcap"] {
            let next = segments.next();
            assert_eq!(names(std::slice::from_ref(&next)), [expected]);
            segments.add(&next);
        }
        assert_eq!(segments.pop_oldest_beyond(2), Some(first));
        assert_eq!(segments.pop_oldest_beyond(2), None);
        assert_eq!(names(&[segments.next()]), ["log.4.mcap"]);
        assert_eq!(Segments::of(Path::new("/nowhere/log.mcap")).next(), Path::new("/nowhere/log.mcap"));
    }
}
