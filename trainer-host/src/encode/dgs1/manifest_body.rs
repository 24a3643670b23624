//! Writes the manifest body of a `dgs1` stream.

use codec_core::internals::{
    gaussian::ShDegree,
    wire::manifest::{self, Cluster, Head, Profile, Proxy, Quant, Repair},
};

use super::{
    super::{decisions::Dgs1Decisions, ledger::Section, statistics::Model},
    symbols::EpochSymbols,
};
use crate::scene::Scene;

/// The unpacked manifest body, and where its sections begin.
pub(super) fn body(
    scene: &Scene,
    epochs: &[EpochSymbols],
    model: &Model,
    repairs: &[Repair],
    packets: usize,
    decisions: &Dgs1Decisions,
) -> (Vec<u8>, Vec<Section>) {
    let windows = || epochs.iter().flat_map(|epoch| &epoch.windows);
    let decided_windows = || decisions.epochs.iter().flat_map(|epoch| &epoch.windows);
    let clusters: usize = epochs.iter().map(|epoch| epoch.cells.len()).sum();
    let degree = scene.epochs().iter().map(|e| e.attributes().sh_degree).max().unwrap_or(ShDegree::ZERO);
    let (rate_frames, rate_seconds) = scene.frame_rate();
    let distinct = distinct(epochs.iter().flat_map(|epoch| &epoch.cells).map(|cell| &cell.shape.quant));
    let basis_values: usize = decided_windows().flat_map(|w| &w.basis).map(Vec::len).sum();
    let head = Head {
        profile: Profile::Dgs1 as u8,
        sh_degree: degree.get(),
        block_len: decisions.block_len as u16,
        frames: scene.frames() as u32,
        rate_frames,
        rate_seconds,
        packets: packets as u32,
        epochs: epochs.len() as u16,
        windows: windows().count() as u16,
        clusters: clusters as u32,
        quants: distinct.len() as u16,
        tables: model.tables.len() as u16,
        repairs: repairs.len() as u16,
        proxies: decisions.proxies.into(),
        drawing: scene.footprint as u8 | (scene.up as u8) << 4,
        basis_values: basis_values as u32,
        transform_values: 0,
    };
    let (mut out, mut sections) = (Vec::new(), Vec::new());
    sections.push(("head, epochs, windows", out.len()));
    out.extend(head.to_bytes());
    write_epochs(&mut out, epochs, decisions);
    write_windows(&mut out, epochs, decisions);
    sections.push(("clusters", out.len()));
    for cell in epochs.iter().flat_map(|epoch| &epoch.cells) {
        let quant = distinct.iter().position(|q| *q == cell.shape.quant).unwrap_or(0) as u8;
        out.extend(Cluster { quant, ..cell.shape.cluster }.to_bytes());
    }
    sections.push(("motions", out.len()));
    for cell in windows().flat_map(|window| &window.cells) {
        out.extend(cell.shape.motion.to_bytes());
    }
    sections.push(("quantisers", out.len()));
    distinct.iter().for_each(|q| q.write(|bytes| out.extend_from_slice(bytes)));
    sections.push(("table sets", out.len()));
    model.table_sets.iter().for_each(|set| out.extend(set.to_bytes()));
    sections.push(("repair ranges", out.len()));
    repairs.iter().for_each(|r| out.extend(r.to_bytes()));
    sections.push(("basis", out.len()));
    for vector in decided_windows().flat_map(|window| &window.basis) {
        vector.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    sections.push(("proxies", out.len()));
    for plane in 0..Proxy::BYTES {
        out.extend(epochs.iter().flat_map(|epoch| &epoch.proxies).map(|p| p.to_bytes()[plane]));
    }
    sections.push(("tables", out.len()));
    model.tables.iter().for_each(|t| t.write(|bytes| out.extend_from_slice(bytes)));
    (out, sections)
}

fn write_epochs(out: &mut Vec<u8>, epochs: &[EpochSymbols], decisions: &Dgs1Decisions) {
    let (mut first_cluster, mut first_window) = (0, 0);
    for (epoch, decided) in epochs.iter().zip(&decisions.epochs) {
        let [origin_x, origin_y, origin_z] = decided.origin;
        let record = manifest::Epoch {
            first_frame: epoch.first_frame as u32,
            frames: epoch.frames as u32,
            gaussians: decided.clusters.iter().map(|c| c.gaussians.len() as u32).sum(),
            first_cluster,
            clusters: epoch.cells.len() as u32,
            first_window,
            windows: epoch.windows.len() as u32,
            origin_x,
            origin_y,
            origin_z,
            ..manifest::Epoch::default()
        };
        out.extend(record.to_bytes());
        first_cluster += record.clusters;
        first_window += record.windows;
    }
}

fn write_windows(out: &mut Vec<u8>, epochs: &[EpochSymbols], decisions: &Dgs1Decisions) {
    let (mut first_cell, mut basis_first) = (0u32, 0u32);
    for (e, (epoch, decided)) in epochs.iter().zip(&decisions.epochs).enumerate() {
        for (window, decided) in epoch.windows.iter().zip(&decided.windows) {
            let record = manifest::Window {
                epoch: e as u16,
                frames: window.frames as u16,
                first_frame: (epoch.first_frame + window.first_frame) as u32,
                first_cell,
                basis_first,
                rank: decided.basis.len() as u8,
            };
            out.extend(record.to_bytes());
            first_cell += epoch.cells.len() as u32;
            basis_first += (decided.basis.len() * window.frames) as u32;
        }
    }
}

/// Distinct quantisation profiles, in order of appearance. Steps lie on a coarse ladder, so even
/// long sequences have few; over 256 the manifest's own check refuses the stream.
fn distinct<'q>(quants: impl Iterator<Item = &'q Quant>) -> Vec<Quant> {
    let mut distinct: Vec<Quant> = Vec::new();
    for quant in quants {
        if !distinct.contains(quant) {
            distinct.push(*quant);
        }
    }
    distinct
}
