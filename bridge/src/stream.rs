//! Buffer of a stream's unparsed bytes.

/// Received bytes, from the first unread one.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stream {
    buffer: Vec<u8>,
    /// Number of read bytes in `buffer`.
    read: usize,
}

impl Stream {
    /// Appends bytes. Read bytes are removed only here, so that reading moves nothing.
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..std::mem::take(&mut self.read));
        self.buffer.extend_from_slice(bytes);
    }

    /// The unread bytes.
    pub(crate) fn waiting(&self) -> &[u8] {
        &self.buffer[self.read..]
    }

    /// Skips `bytes`, or all if there are fewer.
    pub(crate) fn skip(&mut self, bytes: usize) {
        self.read = (self.read + bytes).min(self.buffer.len());
    }

    /// The last `bytes` read, until more are appended.
    pub(crate) fn behind(&self, bytes: usize) -> &[u8] {
        &self.buffer[self.read.saturating_sub(bytes)..self.read]
    }

    /// Clears the buffer; returns the number of unread bytes.
    pub(crate) fn clear(&mut self) -> usize {
        let left = self.buffer.len() - std::mem::take(&mut self.read);
        self.buffer.clear();
        left
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_read_once_and_in_order() {
        let mut stream = Stream::default();
        stream.push(&[1, 2, 3]);
        stream.skip(2);
        assert_eq!((stream.waiting(), stream.behind(2)), (&[3][..], &[1, 2][..]));
        stream.push(&[4]);
        assert_eq!((stream.waiting(), stream.behind(9)), (&[3, 4][..], &[][..]));
        stream.skip(9);
        assert_eq!((stream.waiting().len(), stream.clear()), (0, 0));
        stream.push(&[5, 6]);
        assert_eq!(stream.clear(), 2);
    }
}
