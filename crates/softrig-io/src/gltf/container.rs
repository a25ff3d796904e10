//! From bytes to JSON and buffers: GLB chunks, data URIs, files beside the .gltf.

use super::document::Document;
use super::fault::{Checked, Fault};
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use std::borrow::Cow;

/// Gives the bytes of a file beside the .gltf by its relative path (already decoded and checked to stay below the folder), or
/// says why it cannot.
pub type Loader<'l> = dyn FnMut(&str) -> Result<Vec<u8>, String> + 'l;

const JSON: u32 = 0x4e4f_534a;
const BIN: u32 = 0x004e_4942;

/// Parsed JSON, and the binary chunk of a GLB.
pub(super) fn parse<'b>(bytes: &'b [u8], notes: &mut Vec<String>) -> Checked<(Document, Option<&'b [u8]>)> {
    let (json, binary) = if bytes.starts_with(b"glTF") { chunks(bytes, notes)? } else { (bytes, None) };
    // a byte order mark is no JSON, but editors write it
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    let document: Document = serde_json::from_slice(json).map_err(|e| {
        let reason =
            if e.is_eof() { format!("the JSON is cut short ({e})") } else { format!("the JSON is wrong: {e}") };
        Fault::malformed("", reason)
    })?;
    match document.asset.as_ref().and_then(|a| a.version.as_deref()) {
        Some(version) if version.starts_with("2.") => {}
        Some(version) => {
            return Err(Fault::unsupported(
                "/asset/version",
                format!("this is glTF {version}; softrig reads glTF 2"),
                "export it again as glTF 2.0",
            ));
        }
        None => return Err(Fault::malformed("/asset/version", "there is no glTF version, so this is no glTF file")),
    }
    Ok((document, binary))
}

/// JSON and binary chunk of a GLB.
fn chunks<'b>(bytes: &'b [u8], notes: &mut Vec<String>) -> Checked<(&'b [u8], Option<&'b [u8]>)> {
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().expect("four bytes")))
    };
    let short = || Fault::malformed("", format!("the file is cut short: it ends after {} bytes", bytes.len()));
    let (version, length) = (word(4).ok_or_else(short)?, word(8).ok_or_else(short)? as usize);
    if version != 2 {
        return Err(Fault::unsupported("", format!("this is GLB version {version}"), "export it again as glTF 2.0"));
    }
    if length > bytes.len() {
        return Err(Fault::malformed(
            "",
            format!("the file is cut short: {} of its {length} bytes are there", bytes.len()),
        ));
    }
    if length < bytes.len() {
        notes.push(format!("ignored {} bytes after the end of the GLB", bytes.len() - length));
    }
    let (mut json, mut binary, mut at) = (None, None, 12);
    while at + 8 <= length {
        let (size, kind) = (word(at).ok_or_else(short)? as usize, word(at + 4).ok_or_else(short)?);
        let body = (at + 8).checked_add(size).filter(|end| *end <= length).map(|end| &bytes[at + 8..end]);
        let body = body.ok_or_else(|| {
            Fault::malformed("", format!("the chunk at byte {at} claims {size} bytes, more than the file has"))
        })?;
        match kind {
            JSON if json.is_none() => json = Some(body),
            BIN if binary.is_none() => binary = Some(body),
            _ => {}
        }
        // chunks are aligned to four bytes; a wrong length may leave the next one in between
        at += 8 + size;
    }
    Ok((json.ok_or_else(|| Fault::malformed("", "the GLB has no JSON chunk"))?, binary))
}

/// All buffers, each at least as long as it claims.
pub(super) fn buffers<'b>(
    document: &Document,
    binary: Option<&'b [u8]>,
    loader: &mut Loader<'_>,
) -> Checked<Vec<Cow<'b, [u8]>>> {
    let mut out = Vec::with_capacity(document.buffers.len());
    for (i, buffer) in document.buffers.iter().enumerate() {
        let place = format!("/buffers/{i}");
        let data = match (&buffer.uri, binary) {
            (None, Some(binary)) if i == 0 => Cow::Borrowed(binary),
            // without data: an error only for whoever reads it
            (None, _) => Cow::Borrowed(&[] as &[u8]),
            (Some(uri), _) => Cow::Owned(resource(uri, &place, loader)?),
        };
        let missing = data.len() < buffer.byte_length;
        if missing && !(buffer.uri.is_none() && data.is_empty()) {
            return Err(Fault::malformed(
                place,
                format!("the buffer is cut short: {} of its {} bytes are there", data.len(), buffer.byte_length),
            )
            .with_remedy("copy or export the file and its .bin again"));
        }
        out.push(data);
    }
    Ok(out)
}

/// Bytes of a data URI or of a file beside the .gltf.
pub(super) fn resource(uri: &str, place: &str, loader: &mut Loader<'_>) -> Checked<Vec<u8>> {
    if let Some(data) = uri.strip_prefix("data:") {
        let Some((head, body)) = data.split_once(',') else {
            return Err(Fault::malformed(place, "the data URI has no comma"));
        };
        if !head.ends_with(";base64") {
            return Err(Fault::malformed(place, "the data URI is not base64"));
        }
        let decoder = GeneralPurpose::new(
            &STANDARD,
            GeneralPurposeConfig::new()
                .with_decode_padding_mode(DecodePaddingMode::Indifferent)
                .with_decode_allow_trailing_bits(true),
        );
        return decoder.decode(body).map_err(|e| Fault::malformed(place, format!("the base64 data is wrong: {e}")));
    }
    let path = relative_path(uri).map_err(|reason| {
        Fault::malformed(place, reason).with_remedy("export it again as .glb, which needs no other files")
    })?;
    loader(&path).map_err(|reason| {
        Fault::malformed(place, format!("cannot read `{path}`: {reason}"))
            .with_remedy("put the file beside the .gltf, or export it again as .glb")
    })
}

/// The path a URI means, when it stays below the folder of the .gltf.
fn relative_path(uri: &str) -> Result<String, String> {
    let path = percent_decoded(uri).ok_or_else(|| format!("`{}` is no readable path", shown(uri)))?;
    let outside = path.contains(['\\', '\0', ':'])
        || path.starts_with('/')
        || path.is_empty()
        || path.split('/').any(|part| part == "..");
    if outside { Err(format!("`{}` does not lie below the folder of the file", shown(uri))) } else { Ok(path) }
}

/// With `%20` and the like replaced; `None` when that gives no UTF-8.
fn percent_decoded(uri: &str) -> Option<String> {
    let (bytes, mut out, mut at) = (uri.as_bytes(), Vec::with_capacity(uri.len()), 0);
    while let Some(&b) = bytes.get(at) {
        let hex = |k: usize| bytes.get(at + k).and_then(|h| char::from(*h).to_digit(16));
        match (b, hex(1), hex(2)) {
            (b'%', Some(high), Some(low)) => {
                out.push((16 * high + low) as u8);
                at += 3;
            }
            _ => {
                out.push(b);
                at += 1;
            }
        }
    }
    String::from_utf8(out).ok()
}

/// The beginning of a text from the file, for a message.
pub(super) fn shown(text: &str) -> String {
    let mut out: String = text.chars().take(60).map(|c| if c.is_control() { '?' } else { c }).collect();
    if out.len() < text.len() {
        out.push_str("...");
    }
    out
}
