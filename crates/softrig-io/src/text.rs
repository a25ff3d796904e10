//! Words and numbers of text files, with the line they stand on.

use crate::error::{ImportError, Place};
use std::path::Path;

/// Largest magnitude of a coordinate in file units: squares and cubes of it stay finite.
pub(crate) const MAX_COORDINATE: f64 = 1e60;

/// Reads a file word by word; also hands out raw bytes, for formats that mix text and binary.
#[derive(Clone)]
pub(crate) struct Words<'a> {
    pub file: &'a Path,
    bytes: &'a [u8],
    at: usize,
    line: usize,
    /// Starts a comment that goes to the end of the line.
    comment: Option<u8>,
    /// Counts as space too.
    separator: u8,
}

impl<'a> Words<'a> {
    pub fn new(file: &'a Path, bytes: &'a [u8]) -> Self {
        Self { file, bytes, at: 0, line: 1, comment: None, separator: b' ' }
    }

    /// Takes everything behind `start` on a line as a comment.
    pub fn with_comments(mut self, start: u8) -> Self {
        self.comment = Some(start);
        self
    }

    /// Takes one more byte as space.
    pub fn with_separator(mut self, separator: u8) -> Self {
        self.separator = separator;
        self
    }

    /// Line of the next byte, from 1.
    pub fn line(&self) -> usize {
        self.line
    }

    pub fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    fn skip_space(&mut self) {
        while let Some(&b) = self.bytes.get(self.at) {
            if b == b'\n' {
                self.line += 1;
            } else if Some(b) == self.comment {
                while self.bytes.get(self.at).is_some_and(|b| *b != b'\n') {
                    self.at += 1;
                }
                continue;
            } else if !(b.is_ascii_whitespace() || b == self.separator || b == 0x0b) {
                return;
            }
            self.at += 1;
        }
    }

    /// The next word; `None` at the end.
    pub fn next(&mut self) -> Option<&'a [u8]> {
        self.skip_space();
        let rest = &self.bytes[self.at..];
        let is_end = |b: &u8| b.is_ascii_whitespace() || *b == self.separator || Some(*b) == self.comment;
        let len = rest.iter().position(is_end).unwrap_or(rest.len());
        self.at += len;
        (len > 0).then(|| &rest[..len])
    }

    /// The next word without taking it.
    pub fn peek(&mut self) -> Option<&'a [u8]> {
        self.skip_space();
        self.clone().next()
    }

    /// Whether nothing but space is left.
    pub fn is_at_end(&mut self) -> bool {
        self.skip_space();
        self.at == self.bytes.len()
    }

    /// The next word as text, or an error naming what was expected.
    pub fn word(&mut self, what: &str) -> Result<&'a str, ImportError> {
        let Some(word) = self.next() else { return Err(self.ends_early(what)) };
        std::str::from_utf8(word).map_err(|_| self.unreadable(what, word))
    }

    /// Takes `wanted` (any case), or says what stands there instead.
    pub fn expect(&mut self, wanted: &str) -> Result<(), ImportError> {
        let Some(word) = self.next() else { return Err(self.ends_early(&format!("`{wanted}`"))) };
        if word.eq_ignore_ascii_case(wanted.as_bytes()) {
            Ok(())
        } else {
            Err(self.unreadable(&format!("`{wanted}`"), word))
        }
    }

    /// A finite number.
    pub fn number(&mut self, what: &str) -> Result<f64, ImportError> {
        let Some(word) = self.next() else { return Err(self.ends_early(what)) };
        parse_number(word).ok_or_else(|| self.unreadable(what, word))
    }

    /// Three coordinates.
    pub fn point(&mut self, what: &str) -> Result<[f64; 3], ImportError> {
        let mut p = [0.0; 3];
        for v in &mut p {
            *v = self.number(what)?;
        }
        self.check_point(p, what)
    }

    /// Refuses points that are so far away that arithmetic on them overflows.
    pub fn check_point(&self, p: [f64; 3], what: &str) -> Result<[f64; 3], ImportError> {
        match p.iter().find(|v| v.is_nan() || v.abs() > MAX_COORDINATE) {
            None => Ok(p),
            Some(v) => Err(self.malformed(format!("{v:e} is no usable {what}"))),
        }
    }

    /// A whole number.
    pub fn integer(&mut self, what: &str) -> Result<i64, ImportError> {
        let Some(word) = self.next() else { return Err(self.ends_early(what)) };
        parse_integer(word).ok_or_else(|| self.unreadable(what, word))
    }

    /// A number of things that need at least `bytes_each` bytes each: refused when the rest of the file cannot hold them, so it
    /// is safe to allocate for.
    pub fn count(&mut self, what: &str, bytes_each: usize) -> Result<usize, ImportError> {
        let n = self.integer(what)?;
        self.check_count(n, what, bytes_each)
    }

    /// As [`Self::count`], for a number read before.
    pub fn check_count(&self, n: i64, what: &str, bytes_each: usize) -> Result<usize, ImportError> {
        // the last thing needs no separator behind it
        let room = (self.remaining() + 1) / bytes_each.max(1);
        match usize::try_from(n) {
            Ok(n) if n <= room => Ok(n),
            Ok(n) => {
                Err(self.malformed(format!("{what} is {n}, but the rest of the file has room for {room} at most")))
            }
            Err(_) => Err(self.malformed(format!("{what} is {n}"))),
        }
    }

    /// The rest of this line, without its end and without spaces around it.
    pub fn rest_of_line(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.at..];
        let len = rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
        self.at += len;
        if self.at < self.bytes.len() {
            self.at += 1;
            self.line += 1;
        }
        rest[..len].trim_ascii()
    }

    /// Steps to behind the next `needle`.
    pub fn skip_past(&mut self, needle: &[u8]) -> Result<(), ImportError> {
        let rest = &self.bytes[self.at..];
        match rest.windows(needle.len()).position(|w| w == needle) {
            Some(i) => self.raw(i + needle.len(), "a section").map(|_| ()),
            None => Err(self.ends_early(&format!("`{}`", shown(needle)))),
        }
    }

    /// The next `n` raw bytes.
    pub fn raw(&mut self, n: usize, what: &str) -> Result<&'a [u8], ImportError> {
        let Some(raw) = self.at.checked_add(n).and_then(|end| self.bytes.get(self.at..end)) else {
            let reason = format!("the file ends {} bytes into {what}, which has {n}", self.remaining());
            return Err(ImportError::malformed(self.file, Place::Byte(self.at), reason, REMEDY));
        };
        self.at += n;
        // line numbers past binary data count its line ends too, as editors do
        self.line += raw.iter().filter(|b| **b == b'\n').count();
        Ok(raw)
    }

    /// An error at the current line.
    pub fn malformed(&self, reason: impl Into<String>) -> ImportError {
        ImportError::malformed(self.file, Place::Line(self.line), reason, REMEDY)
    }

    /// Something softrig does not have, at the current line.
    pub fn unsupported(&self, reason: impl Into<String>, remedy: impl Into<String>) -> ImportError {
        ImportError::unsupported(self.file, Place::Line(self.line), reason, remedy)
    }

    fn ends_early(&self, what: &str) -> ImportError {
        self.malformed(format!("the file ends where {what} should be"))
    }

    fn unreadable(&self, what: &str, word: &[u8]) -> ImportError {
        self.malformed(format!("expected {what}, found `{}`", shown(word)))
    }
}

/// What helps with files that were cut short or edited by hand.
pub(crate) const REMEDY: &str = "export or download it again";

/// A word for a message: at most 40 characters, printable.
pub(crate) fn shown(word: &[u8]) -> String {
    let text = String::from_utf8_lossy(&word[..word.len().min(160)]);
    let mut short: String = text.chars().take(40).flat_map(char::escape_debug).collect();
    if text.chars().count() > 40 || word.len() > 160 {
        short.push('…');
    }
    short
}

/// A finite number; Fortran's `1.0D+3` is one too.
pub(crate) fn parse_number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    let value: f64 = match text.parse() {
        Ok(v) => v,
        Err(_) => text.replace(['d', 'D'], "e").parse().ok()?,
    };
    value.is_finite().then_some(value)
}

/// A whole number; `3.0` is one too.
pub(crate) fn parse_integer(word: &[u8]) -> Option<i64> {
    let text = std::str::from_utf8(word).ok()?;
    text.parse().ok().or_else(|| {
        let v = parse_number(word)?;
        (v.fract() == 0.0 && v.abs() < 9e15).then_some(v as i64)
    })
}

/// Names as files have them: any bytes.
pub(crate) fn name(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes.trim_ascii()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_know_their_line() {
        let mut w = Words::new(Path::new("x"), b"a b\r\n# c\n\n d,1e3").with_comments(b'#').with_separator(b',');
        assert_eq!(w.next().unwrap(), b"a");
        assert_eq!(w.next().unwrap(), b"b");
        assert_eq!(w.peek().unwrap(), b"d");
        assert_eq!((w.line(), w.next().unwrap()), (4, &b"d"[..]));
        assert_eq!(w.number("a number").unwrap(), 1000.0);
        assert!(w.is_at_end());
    }

    #[test]
    fn a_count_beyond_the_file_is_refused_before_it_is_allocated() {
        let e = Words::new(Path::new("x"), b"4000000000 1 2 3").count("the number of nodes", 2).unwrap_err();
        assert_eq!(
            e.to_string(),
            "x, line 1: the number of nodes is 4000000000, but the rest of the file has room for 3 at most; export or download it again"
        );
        assert!(Words::new(Path::new("x"), b"-1").count("n", 2).is_err());
        assert_eq!(Words::new(Path::new("x"), b"3 1 2 3").count("n", 2).unwrap(), 3);
    }
}
