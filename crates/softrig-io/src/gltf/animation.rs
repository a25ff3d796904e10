//! Clips from animations.

use super::accessor::{Accessors, Integers};
use super::container::shown;
use super::document::{Animation, Document, Sampler};
use super::fault::{Checked, Fault};
use super::mesh::target_names;
use super::skin::quoted;
use crate::names::Names;
use softrig::rig::{Clip, Interpolation, JointId, Property, Track};

/// All clips, in the file's order.
pub(super) fn clips(document: &Document, accessors: &Accessors<'_>, notes: &mut Vec<String>) -> Checked<Vec<Clip>> {
    let mut names = Names::default();
    let (mut morphed, mut foreign) = (Vec::new(), Vec::new());
    let mut out = Vec::with_capacity(document.animations.len());
    for (i, animation) in document.animations.iter().enumerate() {
        let wish = animation.name.as_deref().map(str::trim).filter(|n| !n.is_empty());
        let name = names.unique(&wish.map_or_else(|| format!("clip {i}"), str::to_owned));
        let mut clip = Clip { name, ..Clip::default() };
        for (c, channel) in animation.channels.iter().enumerate() {
            let place = format!("/animations/{i}/channels/{c}");
            let property = match channel.target.path.as_str() {
                "translation" => Property::Translation,
                "rotation" => Property::Rotation,
                "scale" => Property::Scale,
                "weights" => {
                    morphed.push((clip.name.clone(), channel.target.node));
                    continue;
                }
                other => {
                    foreign.push(format!("{other} of clip {}", clip.name));
                    continue;
                }
            };
            // a channel without a node belongs to an extension
            let Some(node) = channel.target.node else { continue };
            if node >= document.nodes.len() {
                return Err(Fault::malformed(
                    place,
                    format!("it moves node {node}, but there are {}", document.nodes.len()),
                ));
            }
            clip.tracks.extend(track(accessors, animation, channel.sampler, node, property, &place, notes)?);
        }
        let ends = || clip.tracks.iter().filter_map(|t| Some((*t.times.first()?, *t.times.last()?)));
        if ends().next().is_some() {
            clip.start = ends().map(|(first, _)| first).fold(f64::INFINITY, f64::min);
            clip.end = ends().map(|(_, last)| last).fold(f64::NEG_INFINITY, f64::max);
        } else {
            notes.push(format!("clip `{}` moves no node", clip.name));
        }
        out.push(clip);
    }
    note_dropped(document, &morphed, &foreign, notes);
    Ok(out)
}

/// Says which animations are not played: those of morph targets and of extensions.
fn note_dropped(document: &Document, morphed: &[(String, Option<usize>)], foreign: &[String], notes: &mut Vec<String>) {
    let mut by_mesh: Vec<(usize, Vec<&str>)> = Vec::new();
    for (clip, node) in morphed {
        let mesh = node.and_then(|n| document.nodes.get(n)?.mesh).filter(|m| *m < document.meshes.len());
        let Some(mesh) = mesh else { continue };
        match by_mesh.iter().position(|(m, _)| *m == mesh) {
            Some(at) => by_mesh[at].1.push(clip),
            // each mesh costs a search; more than a few are not worth naming
            None if by_mesh.len() < 32 => by_mesh.push((mesh, vec![clip])),
            None => {}
        }
    }
    for (mesh, clips) in by_mesh {
        let targets = target_names(&document.meshes[mesh]);
        let targets: Vec<&str> = targets.iter().map(String::as_str).collect();
        let name = document.meshes[mesh].name.as_deref().map_or_else(|| format!("{mesh}"), shown);
        notes.push(format!(
            "dropped the animated morph targets {} of mesh `{name}` in the clips {}",
            quoted(&targets),
            quoted(&clips)
        ));
    }
    if !foreign.is_empty() {
        let names: Vec<&str> = foreign.iter().map(String::as_str).collect();
        notes.push(format!("dropped animations of what is no joint: {}", quoted(&names)));
    }
}

/// One channel's keys; `None` without keys.
fn track(
    accessors: &Accessors<'_>,
    animation: &Animation,
    sampler: usize,
    node: usize,
    property: Property,
    place: &str,
    notes: &mut Vec<String>,
) -> Checked<Option<Track>> {
    let Some(Sampler { input, output, interpolation }) = animation.samplers.get(sampler) else {
        let have = animation.samplers.len();
        return Err(Fault::malformed(place, format!("it names sampler {sampler}, but there are {have}")));
    };
    let interpolation = match interpolation.as_deref() {
        None | Some("LINEAR") => Interpolation::Linear,
        Some("STEP") => Interpolation::Step,
        Some("CUBICSPLINE") => Interpolation::CubicSpline,
        Some(other) => {
            return Err(Fault::malformed(place, format!("interpolation `{}` does not exist", shown(other))));
        }
    };
    let times: Vec<f64> = accessors.reals::<1>(*input, place, Integers::AsMarked)?.into_iter().map(|[t]| t).collect();
    let values: Vec<[f64; 4]> = if property == Property::Rotation {
        accessors.reals::<4>(*output, place, Integers::Normalized)?
    } else {
        let vectors = accessors.reals::<3>(*output, place, Integers::AsMarked)?;
        vectors.into_iter().map(|v| [v[0], v[1], v[2], 0.0]).collect()
    };
    let per_key = if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
    if values.len() != per_key * times.len() {
        let (have, need) = (values.len(), per_key * times.len());
        return Err(Fault::malformed(place, format!("{have} values where its {} keys need {need}", times.len())));
    }
    if !times.iter().chain(values.iter().flatten()).all(|v| v.is_finite()) {
        return Err(Fault::malformed(place, "a key is not a finite number"));
    }
    if times.is_empty() {
        return Ok(None);
    }
    let mut track = Track { joint: JointId(node as u32), property, interpolation, times, values };
    if !track.times.is_sorted() {
        sort(&mut track, per_key);
        notes.push(format!("sorted the keys of {} in time", place.trim_start_matches('/')));
    }
    if property == Property::Rotation {
        let zero = |v: &[f64; 4]| v.iter().all(|x| *x == 0.0);
        let keys = track.values.chunks_exact(per_key).map(|k| &k[per_key / 2]);
        if keys.clone().any(zero) {
            return Err(Fault::malformed(place, "a key is no rotation: its quaternion is zero"));
        }
    }
    Ok(Some(track))
}

fn sort(track: &mut Track, per_key: usize) {
    let mut order: Vec<usize> = (0..track.times.len()).collect();
    order.sort_by(|a, b| track.times[*a].total_cmp(&track.times[*b]));
    track.values = order.iter().flat_map(|k| track.values[per_key * k..per_key * (k + 1)].to_vec()).collect();
    track.times = order.iter().map(|k| track.times[*k]).collect();
}
