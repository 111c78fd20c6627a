//! Compressed text in a page: gzip (RFC 1952), encoded as base64 (RFC 4648). The browser inflates it itself.

use std::io::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;

/// The compressed text; the same text gives the same characters: letters, digits, `+`, `/` and `=`.
pub fn packed(text: &str) -> String {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    // Neither writing to memory nor finishing such a stream can fail.
    let bytes = encoder.write_all(text.as_bytes()).and_then(|()| encoder.finish()).unwrap_or_default();
    STANDARD.encode(bytes)
}
