//! Turns a manifest and its packets into JSON for people and programs; `tests/schemas` has the schemas.
//!
//! Never on the wire: a receiver reads DGSM. Numbers are as in `codec-core/SPEC.md`, counts and
//! offsets in the order of the stream.

use codec_core::{
    Error,
    internals::{
        ids::{ClusterId, EpochId, Group, Level, Span, WindowId},
        quant::{Class, Quantiser},
        rans::table::Table,
        wire::manifest::{Manifest, Track, VERSION, stream},
    },
};
use serde_json::{Value, json};
use trainer_host::stream::{PacketMap, Stream};

/// The whole document: lattice, quantisation, entropy tables, repair, groups, packets.
///
/// # Errors
/// If the stream's manifest does not hold.
pub fn document(content: &Stream, map: &PacketMap) -> codec_core::internals::error::Result<Value> {
    let manifest = content.manifest()?;
    let head = manifest.head();
    let quants = (0..head.quants).filter_map(|q| manifest.quant(q as u8));
    let sets = (0..stream::COUNT).filter_map(|s| Some((s, manifest.table_set(s)?)));
    let sets = sets.filter(|(_, set)| !set.is_empty());
    let tables: Vec<Table> = manifest.tables().collect::<Result<_, Error>>()?;
    Ok(json!({
        "format": "dgs-manifest",
        "version": VERSION,
        "profile": manifest.profile_name(),
        "frames": head.frames,
        "rate": { "frames": head.rate_frames, "seconds": head.rate_seconds },
        "sh_degree": head.sh_degree,
        "block_len": head.block_len,
        "proxies": head.proxies == 1,
        "footprint": manifest.footprint().name(),
        "up": manifest.up().name(),
        "sealed_bytes": content.message().len(),
        "unpacked_bytes": manifest.raw().len(),
        "epochs": epochs(&manifest),
        "windows": windows(&manifest),
        "quantisation_profiles": quants.map(|quant| json!({
            "canonical": quantisers(&quant.canonical),
            "moving": quantisers(&quant.motion),
        })).collect::<Vec<Value>>(),
        "tables": tables.iter().map(table).collect::<Vec<Value>>(),
        "table_sets": sets.map(|(stream, set)| json!({
            "stream": stream,
            "choices": set.choices().map(|(table, code_length)| json!({
                "table": table, "code_length": code_length,
            })).collect::<Vec<Value>>(),
        })).collect::<Vec<Value>>(),
        "repair_ranges": manifest.repairs().map(|r| json!({
            "first_packet": r.first_packet, "packets": r.packets, "first_parity": r.first_parity,
            "set_len": r.set_len, "sets": r.sets(), "parity": r.parity, "longest_bytes": r.longest,
        })).collect::<Vec<Value>>(),
        "groups": groups(content, map),
        "packets": packets(content, map),
    }))
}

fn epochs(manifest: &Manifest<'_>) -> Vec<Value> {
    let cluster = |epoch: EpochId, c: u32| {
        let record = manifest.cluster(epoch, ClusterId(c as u16)).unwrap_or_default();
        json!({
            "gaussians": record.gaussians,
            "quantisation_profile": record.quant,
            "sh_degree": record.sh_degree(),
            "top_level": record.top().get(),
            "centre_steps": [record.centre_x, record.centre_y, record.centre_z],
            "radius_steps": record.radius,
        })
    };
    let epochs = manifest.epochs().enumerate().map(|(e, epoch)| {
        let id = EpochId(e as u16);
        json!({
            "first_frame": epoch.first_frame,
            "frames": epoch.frames,
            "gaussians": epoch.gaussians,
            "origin": [epoch.origin_x, epoch.origin_y, epoch.origin_z],
            "first_window": epoch.first_window,
            "windows": epoch.windows,
            "basis_vectors": epoch.rank,
            "clusters": (0..epoch.clusters).map(|c| cluster(id, c)).collect::<Vec<Value>>(),
        })
    });
    epochs.collect()
}

fn windows(manifest: &Manifest<'_>) -> Vec<Value> {
    let motion = |window: WindowId, c: u32| {
        let record = manifest.motion(window, ClusterId(c as u16)).unwrap_or_default();
        let track = match record.class() {
            Track::Static => "static",
            Track::Rigid => "rigid",
            Track::Affine => "affine",
        };
        json!({
            "track": track,
            "track_coefficients": record.track,
            "track_shift": record.track_shift,
            "top_level": record.top().get(),
            "coefficients": {
                "position": record.position, "scale": record.scale, "rotation": record.rotation,
                "opacity": record.opacity, "sh0": record.sh0,
            },
        })
    };
    let windows = manifest.windows().enumerate().map(|(w, window)| {
        let id = WindowId(w as u16);
        let clusters = manifest.clusters_of(Span::Motion(id)).unwrap_or_default();
        json!({
            "epoch": window.epoch,
            "first_frame": window.first_frame,
            "frames": window.frames,
            "basis_vectors": window.rank,
            "motions": (0..clusters).map(|c| motion(id, c)).collect::<Vec<Value>>(),
        })
    });
    windows.collect()
}

fn quantisers(of: &[Quantiser]) -> Vec<Value> {
    let one = |(class, quantiser): (Class, &Quantiser)| {
        let ratios = [1, 2, 3].map(|level: usize| quantiser.ratio(Level::ALL[level]));
        json!({
            "class": format!("{class:?}"),
            "step": quantiser.step(Level::ALL[3]),
            "ratios": ratios,
            "predicted": quantiser.predicted(),
            "decorrelated": quantiser.decorrelated(),
        })
    };
    Class::ALL.into_iter().zip(of).map(one).collect()
}

/// A table of the family by its index, any other by its frequencies.
fn table(table: &Table) -> Value {
    let mut wire = Vec::new();
    table.write(|bytes| wire.extend_from_slice(bytes));
    if let [codec_core::internals::rans::table::NAMED, index] = wire[..] {
        return json!({ "family": index, "raw_bits": table.raw_bits() });
    }
    let tokens = (0..=255u8).filter(|&token| table.frequency(token) > 0);
    json!({
        "raw_bits": table.raw_bits(),
        "frequencies": tokens.map(|token| json!([token, table.frequency(token)])).collect::<Vec<Value>>(),
    })
}

/// Span, cluster and level of a group, ready for more fields.
fn group(group: &Group) -> Value {
    let (kind, span) = match group.span {
        Span::Canonical(epoch) => ("canonical", epoch.0),
        Span::Motion(window) => ("motion", window.0),
    };
    json!({ "kind": kind, "span": span, "cluster": group.cluster.0, "level": group.level.get() })
}

/// Every group that has symbols, with the packets that bring some of it.
fn groups(content: &Stream, map: &PacketMap) -> Vec<Value> {
    let mut bringing = std::collections::BTreeMap::<Group, Vec<usize>>::new();
    for id in 0..content.packets().len() {
        for placement in map.placements(id) {
            bringing.entry(placement.group).or_default().push(id);
        }
    }
    let one = |(key, symbols): &(Group, usize)| {
        let mut value = group(key);
        value["symbols"] = json!(symbols);
        value["packets"] = json!(bringing.get(key).map_or(&[][..], Vec::as_slice));
        value
    };
    map.groups().iter().map(one).collect()
}

/// Every packet of the stream: what it is, its bytes (0 if it is missing), what it brings.
fn packets(content: &Stream, map: &PacketMap) -> Vec<Value> {
    let one = |(id, bytes): (usize, &Vec<u8>)| {
        let slices = map.placements(id).iter().map(|placement| {
            let mut value = group(&placement.group);
            value["blocks"] = json!(placement.blocks);
            value["symbols"] = json!(placement.symbols);
            value
        });
        let kind = match bytes.first().map(|first| first >> 5) {
            None => "missing",
            Some(codec_core::internals::wire::packet::KIND_CHUNK) => "chunk",
            Some(codec_core::internals::wire::packet::KIND_PARITY) => "parity",
            Some(_) => "slices",
        };
        json!({ "id": id, "kind": kind, "bytes": bytes.len(), "slices": slices.collect::<Vec<Value>>() })
    };
    content.packets().iter().enumerate().map(one).collect()
}
