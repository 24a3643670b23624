//! Keeps measured utilities in a file, and measures anew when they belong to anything else.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use codec_core::internals::{digest::Digest, wire::crc::crc32};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use trainer_host::{
    Stream,
    encode::clip::Clip,
    stream::PacketMap,
    train::Views,
    utility::{self, ReferencePhotographs, References, SourceRenders, UtilityError, UtilityOptions},
};

use super::Quiet;
use crate::{files, progress::Progress};

/// Grows when what is stored means something else.
const VERSION: u32 = 5;
/// What is stored as a digest.
const DIGESTED: [&str; 5] = ["stream", "scene", "cameras", "photographs", "settings"];
/// How two pictures are compared.
const METRIC: &str = "MSE + 0.20 (1 - SSIM)";

/// Utilities and what they were measured on, and how.
#[derive(Serialize, Deserialize)]
struct StoredUtilities {
    /// Everything that decides the values.
    measured: BTreeMap<String, Value>,
    table: utility::Table,
}

/// Utilities of `stream` against `references`, from `cache` if it holds those that would be measured; if it
/// holds others, `warn` is told what differs and they are replaced.
///
/// # Errors
/// If measuring fails, or the cache cannot be written.
pub fn utilities(
    references: &References<'_>,
    stream: &Stream,
    options: &UtilityOptions,
    cache: Option<&Path>,
    quiet: Quiet,
    warn: &mut dyn FnMut(String),
) -> Result<utility::Table> {
    let measured = measured(references, stream, options)?;
    let map = PacketMap::of(stream)?;
    if let Some((path, bytes)) = cache.and_then(|path| Some((path, std::fs::read(path).ok()?))) {
        match accepted(&bytes, &measured, &map) {
            Ok(table) => return Ok(table),
            Err(why) => warn(format!("{}: {why}; utilities are measured anew", path.display())),
        }
    }
    let progress = Progress::new("measure utilities", quiet.0);
    let received = stream.receive()?;
    let table =
        utility::measure(references, &received.content(), &map, options, &|share| progress.at(share))?;
    if let Some(path) = cache {
        let stored = StoredUtilities { measured, table: table.clone() };
        files::write(path, serde_json::to_string(&stored)?.as_bytes())?;
    }
    Ok(table)
}

/// Photographs of a span that states are compared with, at most.
const PER_SPAN: usize = 4;
/// Longest side of photographs that states are compared with, pixels.
const LONGEST_SIDE: u32 = 160;

/// The photographs of a split over `background`, small, to measure utilities against.
///
/// # Errors
/// An empty split.
pub(crate) fn reference_photographs<S: Sync>(
    views: &Views<S>,
    background: [f32; 3],
) -> Result<ReferencePhotographs, UtilityError> {
    ReferencePhotographs::new(views, background, LONGEST_SIDE, PER_SPAN)
}

/// Where the utilities of the stream in file `stream` are kept.
pub fn utility_path(stream: &Path) -> PathBuf {
    stream.with_extension("utility.json")
}

/// The utilities in file `path`, however they were measured, if they are of a stream with the manifest of
/// `stream`.
///
/// # Errors
/// No file, or one that holds something else.
pub(crate) fn stored_utilities(path: &Path, stream: &Stream) -> Result<utility::Table> {
    let bytes = std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))?;
    let stored = parsed(&bytes).map_err(|why| anyhow::anyhow!("{}: {why}", path.display()))?;
    anyhow::ensure!(
        stored.table.manifest_crc == crc32(stream.manifest()?.raw()),
        "{}: utilities of another stream",
        path.display()
    );
    check_groups(&stored.table, &PacketMap::of(stream)?)
        .map_err(|why| anyhow::anyhow!("{}: {why}", path.display()))?;
    Ok(stored.table)
}

/// As [`stored_utilities`], with the file's bytes for `clip`, a part of the stream `whole`.
///
/// # Errors
/// As [`stored_utilities`].
pub(crate) fn utilities_of_clip(
    path: &Path,
    whole: &Stream,
    clip: &Clip,
) -> Result<(utility::Table, Vec<u8>)> {
    let table = clip.utilities(whole, &stored_utilities(path, whole)?)?;
    let bytes = std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))?;
    let stored = parsed(&bytes).map_err(|why| anyhow::anyhow!("{}: {why}", path.display()))?;
    let stored = StoredUtilities { table: table.clone(), ..stored };
    Ok((table, serde_json::to_vec(&stored)?))
}

/// What is stored in `bytes`, or why it is of no use.
fn parsed(bytes: &[u8]) -> Result<StoredUtilities, String> {
    /// What every version has.
    #[derive(Deserialize)]
    struct Head {
        measured: BTreeMap<String, Value>,
    }
    let strange = |error: serde_json::Error| format!("not the utilities of a stream ({error})");
    let head: Head = serde_json::from_slice(bytes).map_err(strange)?;
    match head.measured.get("version") {
        Some(version) if *version != VERSION => {
            Err(format!("utilities of version {version}, where version {VERSION} is needed"))
        }
        _ => serde_json::from_slice(bytes).map_err(strange),
    }
}

/// The utilities beside the file of `stream`, if they are of it; `warn` hears why there are none.
///
/// # Errors
/// None in practice: the stream was read.
pub(crate) fn utilities_beside(
    path: &Path,
    stream: &Stream,
    warn: &mut dyn FnMut(String),
) -> Result<Option<utility::Table>> {
    let beside = utility_path(path);
    if !beside.exists() {
        let name = path.display();
        warn(format!("{name}: no utilities beside it (encode with --utility); all groups count the same"));
        return Ok(None);
    }
    match stored_utilities(&beside, stream) {
        Ok(table) => Ok(Some(table)),
        Err(error) => {
            warn(format!("{error:#}; all groups count the same (encode with --utility measures them anew)"));
            Ok(None)
        }
    }
}

/// Everything that decides what is measured, by name.
fn measured(
    references: &References<'_>,
    stream: &Stream,
    options: &UtilityOptions,
) -> Result<BTreeMap<String, Value>> {
    // Exhaustive, so that an option cannot be forgotten here.
    let UtilityOptions { contexts, alpha, beta, complete, seed, settings } = options;
    let mut values = vec![
        ("version", json!(VERSION)),
        ("program", json!(env!("CARGO_PKG_VERSION"))),
        ("metric", json!(METRIC)),
        ("contexts", json!(contexts)),
        ("alpha", json!(alpha.to_string())),
        ("beta", json!(beta.to_string())),
        ("complete", json!(complete)),
        ("seed", json!(seed)),
    ];
    // Too long to be compared by reading.
    let mut digested = vec![
        ("stream", digest_of_stream(stream)?),
        ("settings", Digest::new().bytes(&serde_json::to_vec(settings)?)),
    ];
    match references {
        References::Renders(SourceRenders { scene, cameras, gain_cameras, frames_per_span }) => {
            values.push(("references", json!("renders of the source")));
            values.push(("frames per span", json!(frames_per_span)));
            digested.push(("scene", scene.digest()));
            digested.push(("cameras", Digest::new().bytes(&serde_json::to_vec(&[cameras, gain_cameras])?)));
        }
        References::Photographs(photographs) => {
            values.push(("references", json!("photographs")));
            values.push(("photographs per span", json!(photographs.per_span())));
            digested.push(("photographs", digest_of_photographs(photographs)?));
        }
    }
    let digested = digested.into_iter().map(|(name, digest)| (name, json!(format!("{:016x}", digest.get()))));
    Ok(values.into_iter().chain(digested).map(|(name, value)| (name.to_owned(), value)).collect())
}

/// A digest of the manifest and of every packet: what is shown depends on both.
fn digest_of_stream(stream: &Stream) -> Result<Digest> {
    let manifest = Digest::new().bytes(stream.manifest()?.raw());
    Ok(stream.packets().iter().fold(manifest, |all, packet| all.bytes(packet)))
}

/// A digest of every photograph, its camera, its time and its mask.
fn digest_of_photographs(photographs: &ReferencePhotographs) -> Result<Digest> {
    let mut all = Digest::new();
    for photograph in photographs.photographs() {
        let camera = serde_json::to_vec(&photograph.camera)?;
        all = all.bytes(&camera).values(&[photograph.time]).values(photograph.image.rgb());
        all = photograph.counted.iter().fold(all, |all, mask| all.bytes(mask.values()));
    }
    Ok(all)
}

/// The table in `bytes` if it was measured as `wanted`, or why it is of no use.
fn accepted(
    bytes: &[u8],
    wanted: &BTreeMap<String, Value>,
    map: &PacketMap,
) -> Result<utility::Table, String> {
    let stored = parsed(bytes)?;
    for (name, value) in wanted {
        match stored.measured.get(name) {
            Some(found) if found == value => {}
            Some(_) if DIGESTED.contains(&name.as_str()) => {
                return Err(format!("measured with other {name}"));
            }
            Some(found) => return Err(format!("measured with {name} {found}, not {value}")),
            None => return Err(format!("does not say {name}")),
        }
    }
    check_groups(&stored.table, map)?;
    Ok(stored.table)
}

/// Refuses a table of another number of groups than the stream has.
fn check_groups(table: &utility::Table, map: &PacketMap) -> Result<(), String> {
    let (found, needed) = (table.groups.len(), map.groups().len());
    if found == needed { Ok(()) } else { Err(format!("holds {found} groups, not {needed}")) }
}

#[cfg(test)]
mod tests {
    use render_host::Camera;
    use trainer_host::{
        Scene, encode,
        import::{Limits, synth},
    };

    use super::*;

    fn camera(x: f64) -> Camera {
        Camera::look_at([x, 0.5, -4.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 24, 24).unwrap()
    }

    #[test]
    fn what_was_measured_otherwise_is_named_and_measured_anew() {
        let make = synth::SynthOptions { gaussians: 1000, frames: 2, ..synth::SynthOptions::default() };
        let scene = synth::make(&make, &Limits::default()).unwrap();
        let other = synth::make(&synth::SynthOptions { seed: 9, ..make }, &Limits::default()).unwrap();
        let stream =
            encode::encode(&scene, &encode::EncodeOptions::default(), &trainer_host::encode::no_progress)
                .unwrap()
                .stream;
        let folder = tempfile::tempdir().unwrap();
        let cache = folder.path().join("a.utility.json");
        let measure = |scene: &Scene, x: f64, options: &UtilityOptions| {
            let (mut warnings, cameras) = (Vec::new(), [camera(x)]);
            let references = References::renders(scene, &cameras, &cameras);
            let table = utilities(&references, &stream, options, Some(&cache), Quiet(true), &mut |w| {
                warnings.push(w)
            });
            (table.unwrap(), warnings.join("\n"))
        };
        let plain = || UtilityOptions { contexts: 1, ..UtilityOptions::paper() };

        let (first, warnings) = measure(&scene, 0.0, &plain());
        assert_eq!(warnings, "", "there was nothing to differ from");
        // JSON gives floats back to the last bit or two.
        let same = |a: &utility::Table, b: &utility::Table| {
            let close = |(a, b): (&utility::GroupUtility, &utility::GroupUtility)| {
                (a.cell, a.level) == (b.cell, b.level) && (a.mean - b.mean).abs() <= 1e-12 * a.mean.abs()
            };
            a.groups.len() == b.groups.len() && a.groups.iter().zip(&b.groups).all(close)
        };
        let (again, warnings) = measure(&scene, 0.0, &plain());
        assert!(same(&again, &first) && warnings.is_empty(), "{warnings}");
        let (more, warnings) = measure(&scene, 0.0, &UtilityOptions { contexts: 2, ..plain() });
        assert!(warnings.contains("measured with contexts 1, not 2"), "{warnings}");
        assert!(!same(&more, &first));
        let more = UtilityOptions { contexts: 2, ..plain() };
        assert!(measure(&scene, 1.0, &more).1.contains("measured with other cameras"));
        assert!(measure(&other, 1.0, &more).1.contains("measured with other scene"));
        std::fs::write(&cache, b"{}").unwrap();
        assert!(measure(&scene, 0.0, &plain()).1.contains("not the utilities of a stream"));
        let (again, warnings) = measure(&scene, 0.0, &plain());
        assert!(same(&again, &first) && warnings.is_empty(), "it was replaced: {warnings}");

        assert!(same(&stored_utilities(&cache, &stream).unwrap(), &first));
        let none = encode::EncodeOptions::default();
        let another = encode::encode(&other, &none, &encode::no_progress).unwrap().stream;
        let error = stored_utilities(&cache, &another).unwrap_err().to_string();
        assert!(error.contains("of another stream"), "{error}");
        // One packet that is missing shows something else, though the manifest is the same.
        let cut = stream.with_packets(|id| id > 0);
        let measured_on_cut =
            measured(&References::renders(&scene, &[camera(0.0)], &[camera(0.0)]), &cut, &plain());
        let bytes = std::fs::read(&cache).unwrap();
        let error = accepted(&bytes, &measured_on_cut.unwrap(), &PacketMap::of(&cut).unwrap()).unwrap_err();
        assert_eq!(error, "measured with other stream");
        let mut fewer: Value = serde_json::from_slice(&bytes).unwrap();
        fewer["table"]["groups"].as_array_mut().unwrap().pop();
        std::fs::write(&cache, fewer.to_string()).unwrap();
        let error = stored_utilities(&cache, &stream).unwrap_err().to_string();
        assert!(error.contains(" groups, not "), "{error}");
        std::fs::write(&cache, &bytes).unwrap();

        // A file of an earlier version lacks what has come since; its version is what is said.
        let mut earlier: Value = serde_json::from_slice(&std::fs::read(&cache).unwrap()).unwrap();
        earlier["measured"]["version"] = json!(4);
        let group = earlier["table"]["groups"][0].as_object_mut().unwrap();
        assert!(group.remove("together").is_some());
        std::fs::write(&cache, earlier.to_string()).unwrap();
        let error = stored_utilities(&cache, &stream).unwrap_err().to_string();
        assert!(error.contains("version 4, where version 5"), "{error}");
    }
}
