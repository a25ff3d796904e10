//! What makes a bake the same bake, and what it needs to go on.

use super::measure::Measures;
use super::session::Job;
use crate::scene::{Scene, is_bvh};
use std::fmt::{self, Write};
use std::hash::Hasher;
use std::path::Path;
use twox_hash::XxHash64;

/// What a checkpoint of the journal holds.
pub struct Snapshot {
    /// The simulation.
    pub state: Vec<u8>,
    /// What was measured so far.
    pub measures: Measures,
}

/// Bytes of a checkpoint: the length of the state, the state, the measures.
pub fn encode(bytes: &[u8], measures: &Measures) -> Vec<u8> {
    let mut out = (bytes.len() as u64).to_le_bytes().to_vec();
    out.extend_from_slice(bytes);
    out.extend_from_slice(&serde_json::to_vec(measures).expect("measures are plain data"));
    out
}

/// The opposite of [`encode`]; `None` for other bytes.
pub fn decode(bytes: &[u8]) -> Option<Snapshot> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    let (state, measures) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    Some(Snapshot { state: state.to_vec(), measures: serde_json::from_slice(measures).ok()? })
}

/// Hashes whatever is written into it.
struct HashWriter(XxHash64);

impl Write for HashWriter {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

/// Hash of all that decides the result: the program, the settings, the character as read, the clip. Not of where it lies,
/// nor of looks and textures.
pub fn input_hash(job: &Job<'_>) -> u64 {
    let mut hash = HashWriter(XxHash64::with_seed(0));
    let character = &job.prepared.character;
    let mut settings = Scene { character: "".into(), ..job.scene.clone() };
    settings.motion.clip = None;
    // the shortest decimal form of a number tells all numbers apart
    write!(hash, "{} {settings:?} {:?} {:?}", env!("CARGO_PKG_VERSION"), job.clip, character.skeleton)
        .and_then(|()| character.meshes.iter().try_for_each(|m| write!(hash, "{m:?}")))
        .expect("hashing cannot fail");
    hash.0.finish()
}

/// How to bake it again, and where `convert` and `render` find the character: a scene file's text. It begins with the program's
/// version, and names the clip, whatever the command line left open.
pub fn origin(job: &Job<'_>) -> String {
    let mut scene = job.scene.clone();
    let absolute = |p: &Path| p.canonicalize().unwrap_or_else(|_| p.to_owned());
    scene.character = absolute(&scene.character);
    scene.motion.clip = match scene.motion.clip {
        Some(file) if is_bvh(Path::new(&file)) => Some(absolute(Path::new(&file)).to_string_lossy().into_owned()),
        _ => {
            let clips = &job.prepared.character.clips;
            let index = clips.iter().position(|c| c == job.clip);
            // a number where the name stands for another clip
            index.map(|i| match job.prepared.character.find_clip(&clips[i].name) {
                Some(found) if found == i => clips[i].name.clone(),
                _ => i.to_string(),
            })
        }
    };
    let program = concat!("# softrig ", env!("CARGO_PKG_VERSION"), "\n");
    toml::to_string(&scene).map_or_else(|_| program.to_owned(), |text| format!("{program}{text}"))
}
