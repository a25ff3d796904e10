//! The text of a BVH file as a tree of channels and a table of numbers.

use crate::error::ImportError;
use crate::text::{Words, parse_number, shown};
use std::path::Path;

/// Frame time of files that give none that can be used [s].
const USUAL_FRAME_TIME: f64 = 1.0 / 30.0;

/// One column of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    /// Position along an axis.
    Position(usize),
    /// Rotation about an axis [degrees].
    Rotation(usize),
}

/// A `ROOT` or `JOINT`.
pub(super) struct Node {
    pub name: String,
    pub parent: Option<u32>,
    pub offset: [f64; 3],
    pub channels: Vec<Channel>,
}

pub(super) struct Motion {
    pub nodes: Vec<Node>,
    /// End sites: node and offset.
    pub tips: Vec<(u32, [f64; 3])>,
    /// Seconds between frames.
    pub frame_time: f64,
    /// Columns of `values`.
    pub width: usize,
    /// Frame by frame; whole frames only.
    pub values: Vec<f64>,
    pub notes: Vec<String>,
}

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<Motion, ImportError> {
    let mut words = Words::new(file, bytes);
    words.expect("HIERARCHY")?;
    let mut motion = Motion {
        nodes: Vec::new(),
        tips: Vec::new(),
        frame_time: 0.0,
        width: 0,
        values: Vec::new(),
        notes: Vec::new(),
    };
    hierarchy(&mut words, &mut motion)?;
    motion.width = motion.nodes.iter().map(|n| n.channels.len()).sum();
    if motion.nodes.is_empty() || motion.width == 0 {
        return Err(words.malformed("the hierarchy has no joint with channels"));
    }
    frames(&mut words, &mut motion)?;
    Ok(motion)
}

/// What a brace was opened for.
enum Open {
    Node(u32),
    Tip,
}

/// Reads up to and including `MOTION`.
fn hierarchy(words: &mut Words<'_>, motion: &mut Motion) -> Result<(), ImportError> {
    let mut open: Vec<Open> = Vec::new();
    loop {
        let key = words.word("`JOINT`, `End Site`, `MOTION` or `}`")?;
        match (key.to_ascii_uppercase().as_str(), open.last()) {
            ("MOTION", None) => return Ok(()),
            ("MOTION", Some(_)) => {
                return Err(words.malformed("`MOTION` stands inside the hierarchy; a `}` is missing"));
            }
            ("ROOT", None) => {
                let name = name_and_brace(words)?;
                open.push(Open::Node(motion.nodes.len() as u32));
                motion.nodes.push(Node { name, parent: None, offset: [0.0; 3], channels: Vec::new() });
            }
            ("JOINT", Some(Open::Node(parent))) => {
                let parent = Some(*parent);
                let name = name_and_brace(words)?;
                open.push(Open::Node(motion.nodes.len() as u32));
                motion.nodes.push(Node { name, parent, offset: [0.0; 3], channels: Vec::new() });
            }
            ("END", Some(Open::Node(parent))) => {
                motion.tips.push((*parent, [0.0; 3]));
                name_and_brace(words)?;
                open.push(Open::Tip);
            }
            ("OFFSET", Some(at)) => {
                let offset = words.point("an offset")?;
                match at {
                    Open::Node(node) => motion.nodes[*node as usize].offset = offset,
                    Open::Tip => motion.tips.last_mut().expect("pushed when it was opened").1 = offset,
                }
            }
            ("CHANNELS", Some(at)) => {
                let count = words.count("the number of channels", 2)?;
                let channels: Vec<Channel> = (0..count).map(|_| channel(words)).collect::<Result<_, _>>()?;
                match at {
                    Open::Node(node) => motion.nodes[*node as usize].channels = channels,
                    Open::Tip if count == 0 => {}
                    Open::Tip => return Err(words.malformed("an end site has channels")),
                }
            }
            ("}", Some(_)) => {
                open.pop();
            }
            _ => return Err(words.malformed(format!("`{}` does not belong here", shown(key.as_bytes())))),
        }
    }
}

/// A name (which may hold spaces) up to the brace that opens its block.
fn name_and_brace(words: &mut Words<'_>) -> Result<String, ImportError> {
    let mut name = String::new();
    loop {
        let word = words.word("`{`")?;
        if word == "{" {
            return Ok(name);
        }
        let (word, opens) = word.strip_suffix('{').map_or((word, false), |w| (w, true));
        if !name.is_empty() {
            name.push(' ');
        }
        name.push_str(word);
        if opens {
            return Ok(name);
        }
        if name.len() > 1000 {
            return Err(words.malformed("a `{` is missing behind a name"));
        }
    }
}

fn channel(words: &mut Words<'_>) -> Result<Channel, ImportError> {
    let word = words.word("a channel")?.to_ascii_lowercase();
    let axis = match word.as_bytes().first() {
        Some(b'x') => 0,
        Some(b'y') => 1,
        Some(b'z') => 2,
        _ => 3,
    };
    match word.get(1..) {
        Some("position") if axis < 3 => Ok(Channel::Position(axis)),
        Some("rotation") if axis < 3 => Ok(Channel::Rotation(axis)),
        _ => Err(words.malformed(format!("`{}` is no channel", shown(word.as_bytes())))),
    }
}

/// The table behind `MOTION`.
fn frames(words: &mut Words<'_>, motion: &mut Motion) -> Result<(), ImportError> {
    let declared = header_number(words, "Frames")?;
    let frame_time = header_number(words, "Frame Time")?;
    motion.frame_time = frame_time;
    if !(frame_time > 1e-6 && frame_time < 1e3) {
        motion.frame_time = USUAL_FRAME_TIME;
        motion.notes.push(format!("a frame time of {frame_time} s cannot be; took 30 frames a second"));
    }
    while !words.is_at_end() {
        let value = words.number("a channel's value")?;
        if value.abs() > 1e12 {
            return Err(words.malformed(format!("{value:e} is no usable channel value")));
        }
        motion.values.push(value);
    }
    let whole = motion.values.len() / motion.width;
    let rest = motion.values.len() % motion.width;
    motion.values.truncate(whole * motion.width);
    if whole == 0 {
        return Err(
            words.malformed(format!("the motion has no whole frame: {rest} values where a frame has {}", motion.width))
        );
    }
    if rest > 0 {
        motion.notes.push(format!("the last frame is cut off ({rest} of {} values); left it out", motion.width));
    }
    if declared != whole as f64 {
        motion.notes.push(format!("the file says {declared} frames and has {whole}; took {whole}"));
    }
    Ok(())
}

/// The number of a line such as `Frames: 12`.
fn header_number(words: &mut Words<'_>, key: &str) -> Result<f64, ImportError> {
    // to the start of the next line that has anything
    words.peek();
    let line = words.rest_of_line();
    let split = line.iter().position(|b| *b == b':').unwrap_or(line.len());
    let (found, value) = line.split_at(split);
    let same = found.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).map(|w| w.to_ascii_lowercase());
    if !same.eq(key.split(' ').map(|w| w.to_ascii_lowercase().into_bytes())) {
        return Err(words.malformed(format!("expected `{key}:`, found `{}`", shown(line))));
    }
    let value = value.get(1..).unwrap_or_default().trim_ascii();
    parse_number(value).ok_or_else(|| words.malformed(format!("`{}` is no number behind `{key}:`", shown(value))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_spaces_glued_braces_and_short_tables_are_understood() {
        let text = "HIERARCHY\r\nROOT My Hips{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition zposition Zrotation Xrotation Yrotation\n\
            JOINT a\n{\nOFFSET 0 1 0 CHANNELS 1 Yrotation End Site { OFFSET 0 2 0 } } }\nMOTION\nFrames:3\nFrame Time:\t.0\n\
            1 2 3 4 5 6 7\r\n1 2 3 4 5 6 7 8";
        let m = parse(text.as_bytes(), Path::new("t.bvh")).unwrap();
        assert_eq!((m.nodes[0].name.as_str(), m.nodes[1].parent, m.width, m.values.len()), ("My Hips", Some(0), 7, 14));
        assert_eq!(m.tips, [(1, [0.0, 2.0, 0.0])]);
        assert_eq!(m.notes.len(), 3, "{:?}", m.notes);
    }
}
