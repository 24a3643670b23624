//! Writes the `dgs1` stream that decisions describe.

use codec_core::internals::{
    ids::{Level, Span},
    quant::Class,
    rans::lanes::{HEAD_BYTES, MIN_PLANE_BYTES},
    wire::{manifest::stream, packet::PARITY_OVERHEAD_BYTES},
};
use rayon::prelude::*;

use super::{
    super::{
        EncodeError, Encoded, Ledger, Progress, Report, Share,
        decisions::{Decisions, Dgs1Decisions},
        ledger::manifest_parts,
        packetise::{PacketDraft, SliceBatch, packet_id, packetise},
        parity,
        progress::report,
        statistics::Model,
    },
    manifest_body::body,
    symbols::{EpochSymbols, check_table_indices, quantise, spans, streams, symbol_runs},
};
use crate::{scene::Scene, stream::Stream};

/// Writes `scene` as `decisions`, which have been checked against it, say.
///
/// # Errors
/// A block that does not fit a packet; what the format refuses.
pub(in crate::encode) fn write(
    scene: &Scene,
    decisions: &Dgs1Decisions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    report(progress, "quantise", 0.0)?;
    let epochs = quantise(scene, decisions)?;
    let model = Model::of(decisions)?;
    check_table_indices(&epochs, &model)?;

    report(progress, "packetise", 0.4)?;
    let batches = slice_batches(&epochs);
    let strength = |batch: &SliceBatch<'_>| {
        let moving = matches!(batch.span, Span::Motion(_));
        decisions.repair.of(moving, batch.level)
    };
    let limit = |batch: &SliceBatch<'_>| match strength(batch) {
        Some(_) => decisions.packet_bytes - PARITY_OVERHEAD_BYTES,
        None => decisions.packet_bytes,
    };
    let drafts: Result<Vec<Vec<PacketDraft>>, EncodeError> =
        batches.par_iter().map(|batch| packetise(batch, &model, limit(batch))).collect();
    let drafts = drafts?;
    report(progress, "packetise", 0.8)?;

    let order: Vec<Vec<u32>> = decisions
        .epochs
        .iter()
        .map(|epoch| epoch.clusters.iter().flat_map(|c| c.gaussians.iter().copied()).collect())
        .collect();
    let sent = order.iter().map(|epoch: &Vec<u32>| epoch.len() as u64).sum();
    let mut ledger = ledger(scene, &epochs, &model, sent);
    let mut packets = Vec::new();
    let mut repairs = Vec::new();
    for (batch, drafts) in batches.iter().zip(&drafts) {
        let first_packet = packets.len();
        for draft in drafts {
            let bytes = draft.write(packet_id(packets.len())?)?;
            ledger.payload += draft.body_len() as f64;
            ledger.lane_heads += HEAD_BYTES as f64;
            ledger.headers += (bytes.len() - draft.body_len() - 4) as f64;
            ledger.crc += 4.0;
            packets.push(bytes);
        }
        repairs.extend(strength(batch).and_then(|s| s.range(first_packet, &packets[first_packet..])));
    }
    ledger.packets = packets.len() as u64;
    parity::append(&mut repairs, &mut packets, &mut ledger)?;

    let (raw, sections) = body(scene, &epochs, &model, &repairs, packets.len(), decisions);
    let stream = Stream::new(raw, packets)?;
    ledger.manifest = stream.message().len() as f64;
    ledger.manifest_parts = manifest_parts(stream.manifest()?.raw(), &sections, stream.message().len())?;
    let decisions = Decisions::Dgs1(decisions.clone());
    let report = Report::of(ledger, &decisions);
    Ok(Encoded { stream, report, order, decisions })
}

/// What is packed together, in nominal sending order: per epoch the base of everything, then
/// level by level.
fn slice_batches(epochs: &[EpochSymbols]) -> Vec<SliceBatch<'_>> {
    let mut batches = Vec::new();
    let mut spans = spans(epochs).into_iter().peekable();
    while let Some(first) = spans.next() {
        let mut epoch = vec![first];
        while let Some(next) = spans.next_if(|(span, _)| matches!(span, Span::Motion(_))) {
            epoch.push(next);
        }
        for level in Level::ALL {
            batches.extend(epoch.iter().map(|&(span, cells)| SliceBatch { span, level, cells }));
        }
    }
    batches
}

/// What symbols and tables take, before packets.
fn ledger(scene: &Scene, epochs: &[EpochSymbols], model: &Model, sent: u64) -> Ledger {
    let streams = streams(epochs);
    let names = ["position", "scale", "rotation", "opacity", "sh0", "sh1", "sh2", "sh3"];
    let moving = ["position motion", "scale motion", "rotation motion", "opacity motion", "sh0 motion"];
    let gaussians = scene.epochs().iter().map(|e| e.count() as u64).sum();
    let mut ledger = Ledger {
        gaussians,
        invisible: gaussians - sent,
        frames: scene.frames() as u64,
        saturated: epochs.iter().map(|epoch| epoch.saturated).sum(),
        ..Ledger::default()
    };
    let name = |stream: usize| -> &'static str {
        match stream::attribute(stream) {
            (None, _) => "track",
            (Some(class), true) => moving[class.index() % Class::MOVING],
            (Some(class), false) => names[class.index()],
        }
    };
    for (_, cells) in spans(epochs) {
        for cell in cells {
            let mut indices = cell.table_indices.each_ref().map(|indices| indices.iter().copied());
            symbol_runs(cell, |level, stream, run| {
                let choice = indices[level.index()].next().unwrap_or_default().into();
                let (_, _, code_bits) = model.code(stream, choice);
                let bits = model.bits(stream, choice, run) - f64::from(code_bits);
                ledger.table_indices += f64::from(code_bits) / 8.0;
                ledger.symbols += run.len() as u64;
                let (attribute, level) = (name(stream), level.get());
                let found = ledger.shares.iter_mut().find(|s| s.attribute == attribute && s.level == level);
                match found {
                    Some(share) => share.bits += bits,
                    None => ledger.shares.push(Share { attribute, level, bits }),
                }
            });
        }
    }
    ledger.raw_symbols = 2.0 * ledger.symbols as f64;
    ledger.empirical_entropy = streams.entropy_bits() / 8.0;
    let bits: f64 = ledger.shares.iter().map(|s| s.bits).sum();
    ledger.monolithic = (bits / 8.0 + ledger.table_indices).ceil() + (HEAD_BYTES + MIN_PLANE_BYTES) as f64;
    ledger
}
