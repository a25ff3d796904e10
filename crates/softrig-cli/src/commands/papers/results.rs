//! Tables and plots of one paper, each written whole or not at all.

use super::Plot;
use crate::failure::{Failure, Outcome};
use crate::ui;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The folder of a paper.
pub struct Results {
    folder: PathBuf,
    force: bool,
}

impl Results {
    /// Makes the folder.
    ///
    /// # Errors
    /// [`Failure::Machine`] when it cannot be made.
    pub fn new(folder: PathBuf, force: bool) -> Result<Self, Failure> {
        std::fs::create_dir_all(&folder).map_err(|e| Failure::writing(&folder, &e))?;
        Ok(Self { folder, force })
    }

    /// Where the results are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Where a result of another format goes.
    ///
    /// # Errors
    /// [`Failure::Usage`] when it is there already and may not be replaced.
    pub fn path(&self, name: &str) -> Result<PathBuf, Failure> {
        let path = self.folder.join(name);
        if path.exists() && !self.force {
            return Err(Failure::Usage(format!(
                "{} exists; use --force to replace it, or another folder",
                path.display()
            )));
        }
        Ok(path)
    }

    /// Writes a table as CSV: a line of column names, then the rows.
    ///
    /// # Errors
    /// As [`Self::path`], and [`Failure::Machine`] when it cannot be written.
    pub fn table(&self, name: &str, columns: &[&str], rows: &[Vec<String>]) -> Outcome {
        let mut text = columns.join(",") + "\n";
        for row in rows {
            let _ = writeln!(text, "{}", row.join(","));
        }
        self.write(&format!("{name}.csv"), text.as_bytes())
    }

    /// Draws a plot as SVG.
    ///
    /// # Errors
    /// As [`Self::table`].
    pub fn plot(&self, name: &str, plot: &Plot<'_>) -> Outcome {
        self.write(&format!("{name}.svg"), plot.svg().as_bytes())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Outcome {
        let path = self.path(name)?;
        let failed = |e: &std::io::Error| Failure::writing(&path, e);
        let mut builder = tempfile::Builder::new();
        builder.prefix(".softrig-");
        #[cfg(unix)]
        {
            // those of any new file
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let mut file = builder.tempfile_in(&self.folder).map_err(|e| failed(&e))?;
        std::io::Write::write_all(&mut file, bytes).map_err(|e| failed(&e))?;
        file.persist(&path).map_err(|e| failed(&e.error))?;
        ui::note(format_args!("wrote {}", path.display()));
        Ok(())
    }
}
