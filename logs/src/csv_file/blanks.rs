//! Tables whose columns are separated by blanks, as numerical programs write them.

use std::io::{Read, Result};

/// A reader that passes on one blank for each run of blanks within a line, and none at its beginning or end, so that each
/// blank separates two cells.
pub(super) struct SingleBlanks<R> {
    inner: R,
    /// True at the beginning of a line.
    begins: bool,
    /// True after blanks that may separate two cells.
    pending: bool,
}

impl<R: Read> SingleBlanks<R> {
    pub fn new(inner: R) -> Self {
        Self { inner, begins: true, pending: false }
    }
}

impl<R: Read> Read for SingleBlanks<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        // Blanks at the end of one read may be due before the first byte of the next.
        let Some(room) = buffer.len().checked_sub(1).filter(|room| *room > 0) else { return Ok(0) };
        let mut bytes = vec![0; room];
        loop {
            let count = self.inner.read(&mut bytes)?;
            if count == 0 {
                return Ok(0);
            }
            let mut kept = 0;
            let mut keep = |byte: u8| {
                buffer[kept] = byte;
                kept += 1;
            };
            for byte in &bytes[..count] {
                match byte {
                    b' ' => self.pending = !self.begins,
                    b'\n' | b'\r' => {
                        (self.begins, self.pending) = (true, false);
                        keep(*byte);
                    }
                    _ => {
                        if self.pending {
                            keep(b' ');
                        }
                        (self.begins, self.pending) = (false, false);
                        keep(*byte);
                    }
                }
            }
            if kept > 0 {
                return Ok(kept);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str, at_once: usize) -> String {
        let (mut reader, mut all, mut part) =
            (SingleBlanks::new(text.as_bytes()), Vec::new(), vec![0; at_once]);
        loop {
            match reader.read(&mut part).unwrap() {
                0 => return String::from_utf8(all).unwrap(),
                count => all.extend(&part[..count]),
            }
        }
    }

    proptest! {
        #[test]
        fn each_blank_separates_two_cells(text in "[a1 \n]{0,40}", at_once in 2usize..9) {
            let lines = text.split('\n').map(|line| line.split(' ').filter(|cell| !cell.is_empty()).collect::<Vec<_>>().join(" "));
            prop_assert_eq!(read(&text, at_once), lines.collect::<Vec<_>>().join("\n"));
        }
    }
}
