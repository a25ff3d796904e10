//! The only place that writes to the terminal: results to stdout, everything else to stderr.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// A result, to stdout. A reader that has gone away (`| head`) is no error.
pub fn result(text: impl Display) {
    let mut out = std::io::stdout().lock();
    // nothing sensible can be done about a closed pipe, and the work itself is done
    let _ = writeln!(out, "{text}").and_then(|()| out.flush());
}

/// Bytes as a result, to stdout.
pub fn result_bytes(bytes: &[u8]) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(bytes).and_then(|()| out.flush());
}

/// A diagnostic, to stderr.
pub fn note(text: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Something that works but that a user should know, to stderr.
pub fn warn(text: impl Display) {
    note(format_args!("note: {text}"));
}

/// The one message of a command that failed, to stderr.
pub fn error(text: impl Display) {
    note(format_args!("error: {text}"));
}

/// Progress through a known number of pieces: a bar on a terminal, a plain line now and then otherwise.
pub struct Progress {
    bar: Option<ProgressBar>,
    what: String,
    total: usize,
    done: usize,
    said: Instant,
}

/// Between two plain lines, so that a log of a long bake stays readable.
const QUIET_BETWEEN_LINES: Duration = Duration::from_secs(5);

impl Progress {
    /// Starts at `done` of `total` pieces; `what` is the plural of a piece, e.g. `frames`.
    #[must_use]
    pub fn new(what: &str, done: usize, total: usize) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(Some(total as u64), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}  {elapsed} elapsed, {eta} left");
            bar.set_style(style.expect("the template is valid"));
            bar.set_message(what.to_owned());
            bar.reset_eta();
            bar.set_position(done as u64);
            bar
        });
        Self { bar, what: what.to_owned(), total, done, said: Instant::now() }
    }

    /// One piece more is done.
    pub fn step(&mut self) {
        self.done += 1;
        match &self.bar {
            Some(bar) => bar.set_position(self.done as u64),
            None if self.done == self.total || self.said.elapsed() >= QUIET_BETWEEN_LINES => {
                self.said = Instant::now();
                note(format_args!("{}/{} {}", self.done, self.total, self.what));
            }
            None => {}
        }
    }

    /// Takes the bar off the screen.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}
