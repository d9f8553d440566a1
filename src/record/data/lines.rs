//! A reader of text files that never holds more than a line of bounded length, whatever a damaged file or
//! a hole of gigabytes in it would make of "the rest of the line".

use std::io::{Error, ErrorKind, Read};

/// Longest line of a data file, bytes.
pub(super) const LONGEST: usize = 1 << 20;

/// Passes bytes on until a line is too long.
pub(super) struct BoundedLines<R> {
    inner: R,
    line: u64,
    length: usize,
}

impl<R: Read> BoundedLines<R> {
    /// Around any reader of text.
    pub(super) fn new(inner: R) -> Self {
        Self { inner, line: 1, length: 0 }
    }
}

impl<R: Read> Read for BoundedLines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(buffer)?;
        // Lines end with a line feed, or with a carriage return alone in files of old.
        for part in buffer[..count].split_inclusive(|byte| matches!(byte, b'\n' | b'\r')) {
            self.length += part.len();
            if self.length > LONGEST {
                let reason = format!("line {} is longer than {LONGEST} bytes: no text file", self.line);
                return Err(Error::new(ErrorKind::InvalidData, reason));
            }
            if part.ends_with(b"\n") || part.ends_with(b"\r") {
                self.line += u64::from(part.ends_with(b"\n"));
                self.length = 0;
            }
        }
        Ok(count)
    }
}
