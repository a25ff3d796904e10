//! Outputs that appear whole or not at all.

use super::ExportError;
use crate::journal::Existing;
use softrig::character::Texture;
use std::collections::HashSet;
use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempDir};

/// The folder a file lies in.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file in the folder of `path`, gone again unless renamed. Its permissions are those of any new file.
pub(crate) fn temporary_beside(path: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".softrig-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder_of(path))
}

/// Writes one file through a temporary one.
pub(super) fn write_file(
    path: &Path,
    existing: Existing,
    content: impl FnOnce(&mut BufWriter<&mut NamedTempFile>) -> Result<(), ExportError>,
) -> Result<(), ExportError> {
    let io = |source| ExportError::Io { file: path.to_owned(), source };
    let mut temporary = temporary_beside(path).map_err(io)?;
    let mut writer = BufWriter::with_capacity(1 << 18, &mut temporary);
    content(&mut writer)?;
    writer.flush().map_err(io)?;
    drop(writer);
    // the data before the name: a power cut leaves the old file or the new one
    temporary.as_file().sync_data().map_err(io)?;
    let placed = match existing {
        Existing::Replace => temporary.persist(path),
        Existing::Refuse => temporary.persist_noclobber(path),
    };
    match placed {
        Ok(_) => Ok(()),
        Err(e) if e.error.kind() == io::ErrorKind::AlreadyExists => Err(ExportError::Exists { file: path.to_owned() }),
        Err(e) => Err(io(e.error)),
    }
}

/// A folder being filled under a temporary name.
pub(super) struct Folder {
    temporary: TempDir,
    target: PathBuf,
    endings: &'static [&'static str],
}

impl Folder {
    /// A folder that will hold only files with the given endings.
    pub fn new(target: &Path, existing: Existing, endings: &'static [&'static str]) -> Result<Self, ExportError> {
        let io = |source| ExportError::Io { file: target.to_owned(), source };
        check_replaceable(target, existing, endings)?;
        let temporary = tempfile::Builder::new().prefix(".softrig-").tempdir_in(folder_of(target)).map_err(io)?;
        Ok(Self { temporary, target: target.to_owned(), endings })
    }

    /// Where to write a file now.
    pub fn path(&self, name: &str) -> PathBuf {
        self.temporary.path().join(name)
    }

    /// Where it will be.
    pub fn final_path(&self, name: &str) -> PathBuf {
        self.target.join(name)
    }

    /// Gives the folder its name.
    pub fn finish(self, existing: Existing) -> Result<(), ExportError> {
        let io = |source| ExportError::Io { file: self.target.clone(), source };
        check_replaceable(&self.target, existing, self.endings)?;
        let Ok(old) = self.target.symlink_metadata() else {
            return fs::rename(self.temporary.keep(), &self.target).map_err(io);
        };
        // put the old one aside, and back when the new one cannot take its place
        let aside = tempfile::Builder::new().prefix(".softrig-").tempdir_in(folder_of(&self.target)).map_err(io)?;
        let kept = aside.path().join("old");
        fs::rename(&self.target, &kept).map_err(io)?;
        if let Err(source) = fs::rename(self.temporary.path(), &self.target) {
            fs::rename(&kept, &self.target).map_err(io)?;
            return Err(ExportError::Io { file: self.target.clone(), source });
        }
        let _ = self.temporary.keep();
        if old.is_dir() { fs::remove_dir_all(&kept) } else { fs::remove_file(&kept) }.map_err(io)
    }
}

/// Whether `target` may be replaced: a file, or a folder that holds nothing but what softrig writes there.
fn check_replaceable(target: &Path, existing: Existing, endings: &[&str]) -> Result<(), ExportError> {
    let io = |source| ExportError::Io { file: target.to_owned(), source };
    let Ok(metadata) = target.symlink_metadata() else { return Ok(()) };
    if existing == Existing::Refuse {
        return Err(ExportError::Exists { file: target.to_owned() });
    }
    if !metadata.is_dir() {
        return Ok(());
    }
    for entry in fs::read_dir(target).map_err(io)? {
        let entry = entry.map_err(io)?;
        let path = entry.path();
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let ours = entry.file_type().map_err(io)?.is_file() && endings.contains(&ending.as_str());
        if !ours {
            let file = entry.file_name().to_string_lossy().into_owned();
            return Err(ExportError::ForeignFolder { folder: target.to_owned(), file });
        }
    }
    Ok(())
}

/// Name of the file of one frame; as many digits for all, so that they sort.
pub(super) fn frame_name(index: usize, count: usize, ending: &str) -> String {
    let width = count.saturating_sub(1).to_string().len().max(4);
    format!("frame_{index:0width$}.{ending}")
}

/// A picture as a PNG file; `None` when its numbers do not fit each other.
pub(super) fn png(texture: &Texture) -> Option<Vec<u8>> {
    let image = image::RgbaImage::from_raw(texture.width, texture.height, texture.rgba.as_flattened().to_vec())?;
    let mut bytes = io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).ok()?;
    Some(bytes.into_inner())
}

/// File names for things with names: nothing a file system could object to, no two alike even where case does not count.
pub(super) fn file_stems<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let mut taken = HashSet::new();
    let mut stems = Vec::new();
    for name in names {
        let harmless = |c: char| if c.is_control() || "/\\:*?\"<>|".contains(c) { '_' } else { c };
        let mut stem: String = name.chars().map(harmless).take(80).collect();
        stem.truncate(stem.trim_end_matches([' ', '.']).len());
        if stem.is_empty() || stem.starts_with('.') {
            stem.insert(0, '_');
        }
        let mut unique = stem.clone();
        let mut number = 2;
        while !taken.insert(unique.to_lowercase()) {
            unique = format!("{stem}_{number}");
            number += 1;
        }
        stems.push(unique);
    }
    stems
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_harmless_and_unique() {
        let names = ["Body", "body", "a/b", "..", "", "Body"];
        assert_eq!(file_stems(names), ["Body", "body_2", "a_b", "_", "__2", "Body_3"]);
    }
}
