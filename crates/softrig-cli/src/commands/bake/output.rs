//! Where results go: nothing that is there is damaged, and what appears is whole.

use crate::failure::Failure;
use softrig_io::export::{ExportOptions, FleshField, Format};
use softrig_io::journal::{Existing, journal_path};
use std::fmt::Write as _;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// What to do about results that are there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// Leave them alone and fail.
    Refuse,
    /// Replace them.
    Replace,
    /// Go on with them.
    Resume,
}

/// What one clip is written to.
#[derive(Clone, Debug)]
pub struct Target {
    /// The result.
    pub out: PathBuf,
    /// Its format; `None`: only the journal is wanted.
    pub format: Option<Format>,
    /// Frames are collected here.
    pub journal: PathBuf,
    /// What to do about what is there.
    pub policy: Policy,
    /// Most morph targets of a .glb; `None`: the format's own default.
    pub morphs: Option<usize>,
    /// What colours the vertices of a series; nothing at first.
    pub colors: Option<FleshField>,
}

impl Target {
    /// Looks at what is there, before any long work.
    ///
    /// # Errors
    /// [`Failure::Usage`] for an ending that is no format, [`Failure::Input`] when something must not be replaced or there is
    /// a file where a folder is needed.
    pub fn new(out: &Path, policy: Policy, morphs: Option<usize>) -> Result<Self, Failure> {
        let only_journal = out.extension().is_some_and(|e| e == "softrig-journal");
        let (format, journal) = if only_journal {
            (None, out.to_owned())
        } else {
            let format = Format::from_path(out).map_err(|e| Failure::Usage(e.to_string()))?;
            (Some(format), journal_path(out))
        };
        refuse_existing(out, policy)?;
        if policy == Policy::Refuse && journal.symlink_metadata().is_ok() {
            return Err(Failure::Input(format!(
                "{} is there from a bake that was stopped; go on with it (--resume) or start over (--force)",
                journal.display()
            )));
        }
        check_folder_of(out)?;
        Ok(Self { out: out.to_owned(), format, journal, policy, morphs, colors: None })
    }

    /// What the export may do.
    #[must_use]
    pub fn export_options(&self) -> ExportOptions {
        self.export_options_as(self.policy)
    }

    /// Colours the vertices of the result.
    ///
    /// # Errors
    /// [`Failure::Usage`] when its format cannot hold colours that change.
    pub fn color(&mut self, by: Option<FleshField>) -> Result<(), Failure> {
        if by.is_some() && !self.format.is_some_and(Format::holds_colors) {
            let why = match self.format {
                Some(Format::Vtu) => "it has stress and strain of every cell in any case; leave --colors out",
                None => "a journal has no colours; choose them when it is converted",
                _ => {
                    "this format has positions only; name a folder for an OBJ series, .ply for a PLY series, or a .glb, \
                     which shows the largest value of every vertex"
                }
            };
            let text = format!("unsupported: --colors in {}: {why}", self.out.display());
            return Err(Failure::Usage(text));
        }
        self.colors = by;
        Ok(())
    }

    /// What the export may do under another policy.
    #[must_use]
    pub fn export_options_as(&self, policy: Policy) -> ExportOptions {
        let existing = if policy == Policy::Refuse { Existing::Refuse } else { Existing::Replace };
        let mut options = ExportOptions { existing, ..ExportOptions::default() };
        options.morphs = self.morphs.unwrap_or(options.morphs);
        options.colors = self.colors;
        options
    }
}

/// Refuses a result that is there already.
///
/// # Errors
/// [`Failure::Input`] names the ways out.
pub fn refuse_existing(path: &Path, policy: Policy) -> Result<(), Failure> {
    if policy == Policy::Refuse && path.symlink_metadata().is_ok() {
        return Err(Failure::Input(format!(
            "{} exists; replace it with --force or choose another name",
            path.display()
        )));
    }
    Ok(())
}

/// Refuses a result in the place of something it is made from: not even `--force` replaces that.
///
/// # Errors
/// [`Failure::Usage`] names the file.
pub fn refuse_input<'a>(path: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> Result<(), Failure> {
    let Ok(there) = path.canonicalize() else { return Ok(()) };
    match inputs.into_iter().find(|input| input.canonicalize().is_ok_and(|i| i == there)) {
        Some(input) => Err(Failure::Usage(format!(
            "{} would replace {}, which it is made from; choose another output",
            path.display(),
            input.display()
        ))),
        None => Ok(()),
    }
}

/// The folder a file is in.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// Looks whether the folder of a file is there or can be made; nothing is made.
///
/// # Errors
/// [`Failure::Input`] names the file that is in the way.
pub fn check_folder_of(path: &Path) -> Result<(), Failure> {
    match folder_of(path).ancestors().find(|p| p.symlink_metadata().is_ok()) {
        Some(there) if !there.is_dir() => Err(Failure::Input(format!(
            "{} cannot be written: {} is a file, not a folder; choose another output",
            path.display(),
            there.display()
        ))),
        _ => Ok(()),
    }
}

/// Makes the folder of a file, and those above it, where they are not there.
///
/// # Errors
/// [`Failure::Machine`] when the system refuses.
pub fn make_folder_of(path: &Path) -> Result<(), Failure> {
    let folder = folder_of(path);
    std::fs::create_dir_all(folder).map_err(|e| Failure::writing(path, &e))
}

/// Where one clip of several goes: its name comes before the ending.
pub fn for_clip(out: &Path, name: &str, all: &[String]) -> PathBuf {
    let safe = |name: &str| -> String {
        name.chars().map(|c| if c.is_alphanumeric() || "-_ .".contains(c) { c } else { '_' }).collect()
    };
    let mut part = safe(name);
    let same: Vec<_> = all.iter().enumerate().filter(|(_, n)| safe(n) == part).collect();
    if same.len() > 1 {
        // names that only differ in characters a file name cannot have, or not at all
        let index = same.iter().find(|(_, n)| *n == name).map_or(0, |(i, _)| *i);
        let _ = write!(part, "-{index}");
    }
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let ending = out.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    out.with_file_name(format!("{stem}-{part}{ending}"))
}

/// Writes a file, in a folder that is made if need be, so that it is there whole or not at all.
///
/// # Errors
/// [`Failure::Machine`] when the system refuses.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_whole_with(path, |file| file.write_all(bytes))
}

/// As [`write_whole`], for what is written piece by piece.
///
/// # Errors
/// [`Failure::Machine`] when the system refuses.
pub fn write_whole_with(
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), Failure> {
    make_folder_of(path)?;
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let write = || -> std::io::Result<()> {
        let mut file = BufWriter::new(std::fs::File::create(&part)?);
        content(&mut file)?;
        file.into_inner()?.sync_data()?;
        std::fs::rename(&part, path)
    };
    write().map_err(|e| {
        // the reason matters, not whether the fragment could be removed
        let _ = std::fs::remove_file(&part);
        Failure::writing(path, &e)
    })
}

/// A path as seen from a folder, when the one lies in the other; otherwise as an absolute path.
pub fn relative_to(path: &Path, folder: &Path) -> PathBuf {
    let folder = if folder == Path::new("") { Path::new(".") } else { folder };
    let absolute = |p: &Path| p.canonicalize().unwrap_or_else(|_| p.to_owned());
    let (file, folder) = (absolute(path), absolute(folder));
    file.strip_prefix(&folder).map_or(file.clone(), Path::to_owned)
}

/// Forces on joints, as the text of a CSV file.
#[derive(Debug)]
pub struct Forces {
    text: String,
    clips: bool,
}

impl Forces {
    /// With a first column for the clip when there are several.
    #[must_use]
    pub fn new(clips: bool) -> Self {
        let clip = if clips { "clip," } else { "" };
        Self { text: format!("{clip}frame,time_s,joint,force_x_n,force_y_n,force_z_n\n"), clips }
    }

    /// One row for each joint that feels a force.
    pub fn add(&mut self, clip: &str, frame: usize, time: f64, joints: &[String], force: &[[f32; 3]]) {
        for (joint, f) in joints.iter().zip(force).filter(|(_, f)| **f != [0.0; 3]) {
            if self.clips {
                let _ = write!(self.text, "{},", quoted(clip));
            }
            let _ = writeln!(self.text, "{frame},{time},{},{},{},{}", quoted(joint), f[0], f[1], f[2]);
        }
    }

    /// The file.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }
}

/// A CSV field.
pub fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_clip_gets_a_file_of_its_own() {
        let names = ["Walk", "a/b", "a:b"].map(String::from);
        let files: Vec<_> = names.iter().map(|n| for_clip(Path::new("d/out.pc2"), n, &names)).collect();
        let expected = ["d/out-Walk.pc2", "d/out-a_b-1.pc2", "d/out-a_b-2.pc2"];
        assert_eq!(files, expected.map(PathBuf::from));
    }

    #[test]
    fn names_with_commas_stay_one_field() {
        let mut f = Forces::new(false);
        f.add("", 3, 0.5, &["a,\"b".into(), "still".into()], &[[1.0, 2.0, 3.0], [0.0; 3]]);
        assert_eq!(f.text().lines().nth(1), Some("3,0.5,\"a,\"\"b\",1,2,3"));
        assert_eq!(f.text().lines().count(), 2);
    }
}
