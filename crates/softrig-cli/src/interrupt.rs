//! Ctrl-C: work that can end cleanly is asked to, everything else ends at once.

use crate::ui;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

static REQUESTED: AtomicBool = AtomicBool::new(false);
static GRACEFUL: AtomicBool = AtomicBool::new(false);
static INSTALL: Once = Once::new();

/// Exit code of a process ended by Ctrl-C.
pub const EXIT_CODE: u8 = 130;

/// Installs the handler, once per process.
pub fn install() {
    INSTALL.call_once(|| {
        // a second Ctrl-C does not wait for the frame
        let handler = || {
            if !GRACEFUL.load(Ordering::SeqCst) || REQUESTED.swap(true, Ordering::SeqCst) {
                std::process::exit(i32::from(EXIT_CODE));
            }
            ui::note("stopping after this frame (Ctrl-C again to stop at once)");
        };
        if let Err(e) = ctrlc::set_handler(handler) {
            ui::warn(format_args!("Ctrl-C will stop at once, not after a frame: {e}"));
        }
    });
}

/// While it lives, Ctrl-C only sets [`requested`].
pub struct Graceful(());

impl Graceful {
    /// From now on the caller looks at [`requested`] between pieces of work.
    #[must_use]
    pub fn begin() -> Self {
        GRACEFUL.store(true, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for Graceful {
    fn drop(&mut self) {
        GRACEFUL.store(false, Ordering::SeqCst);
    }
}

/// Whether Ctrl-C was pressed.
#[must_use]
pub fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}
