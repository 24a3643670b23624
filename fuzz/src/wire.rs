//! The four wire formats: what parses writes back to the same bytes.

use codec_core::{
    Caps, Error, ErrorKind,
    internals::{
        ids::{ClusterId, EpochId, Level, WindowId},
        receiver::Requirements,
        wire::{
            checked::Checked,
            crc::{checked, crc32},
            file as dgs,
            manifest::{self as dgsm, Manifest, ManifestHead},
            packet::Packet,
            receipt::{IdRange, Receipt, Value},
        },
    },
};
use trainer_host::stream::Stream;

use crate::seal::{dgs_file, with_crc};

/// Formats an error as a person would see it; it must name a field.
fn shown(error: &Error) {
    assert!(!error.field.is_empty());
    assert!(error.to_string().contains(error.field));
}

/// A packet's content (DGSP without its CRC).
pub fn packet(data: &[u8]) {
    let packet = match Packet::parse(data) {
        Ok(packet) => packet,
        Err(error) => return shown(&error),
    };
    let mut out = vec![0u8; data.len() + 16];
    let written = match &packet {
        Packet::Chunk(p) => p.write(&mut out),
        Packet::Slices(p) => p.write(&mut out),
        Packet::Parity(p) => p.write(&mut out),
    };
    assert_eq!(written, Ok(data.len() + 4));
    let whole = &out[..data.len() + 4];
    assert_eq!(checked("packet.crc", whole, crc32), Ok(data));
    assert_eq!(Packet::parse(data).as_ref(), Ok(&packet));
    let stated = match &packet {
        Packet::Chunk(p) => p.wire_len(),
        Packet::Slices(p) => p.wire_len(),
        Packet::Parity(_) => whole.len(),
    };
    assert_eq!(stated, whole.len());
}

/// A DGSM message (its CRC is made to fit), or an unpacked manifest body.
pub fn manifest(data: &[u8]) {
    if data.starts_with(&dgsm::MAGIC) {
        let _ = dgsm::open(data, crc32, &mut []);
        let message = with_crc(&data[..data.len().saturating_sub(4)]);
        let Ok(sealed) = ManifestHead::parse(&message) else { return };
        let mut raw = vec![0u8; sealed.raw_len.min(1 << 20)];
        match dgsm::open(&message, crc32, &mut raw) {
            Ok(raw) => {
                let mut again = vec![0u8; message.len()];
                assert_eq!(dgsm::seal(raw, &mut again), Ok(message.len()), "one packed form");
                assert_eq!(again, message);
                body(raw);
            }
            Err(error) => shown(&error),
        }
        return;
    }
    body(data);
}

fn body(raw: &[u8]) {
    let manifest = match Manifest::parse(raw) {
        Ok(manifest) => manifest,
        Err(error) => {
            assert!(error.offset as usize <= raw.len(), "{error}: past the end");
            return shown(&error);
        }
    };
    let head = *manifest.head();
    for (e, epoch) in manifest.epochs().enumerate() {
        let id = EpochId(e as u16);
        assert_eq!(manifest.epoch_at(epoch.first_frame), Some(id));
        assert_eq!(manifest.epoch_at(epoch.first_frame + epoch.frames - 1), Some(id));
        for c in 0..epoch.clusters {
            let cluster = manifest.cluster(id, ClusterId(c as u16));
            assert!(cluster.is_some_and(|c| manifest.quant(c.quant).is_some()));
            for level in Level::ALL {
                let tables = manifest.byte_tables((epoch.first_cluster + c) as usize, level);
                assert_eq!(tables.is_ok(), manifest.chunk_coder() == Some(dgsm::ChunkCoder::Tables));
            }
        }
        assert!(manifest.cluster(id, ClusterId(epoch.clusters as u16)).is_none());
    }
    for (w, window) in manifest.windows().enumerate() {
        let id = WindowId(w as u16);
        assert_eq!(manifest.window_at(window.first_frame), Some(id));
        let clusters = manifest.epoch(EpochId(window.epoch)).map_or(0, |e| e.clusters);
        for c in 0..clusters {
            assert!(manifest.motion(id, ClusterId(c as u16)).is_some(), "window {w}, cluster {c}");
        }
        for index in 0..usize::from(window.rank) * usize::from(window.frames) {
            let value = manifest.basis(window.basis_first as usize + index);
            assert!(value.is_some_and(|value| value.abs() <= 2.0));
        }
    }
    assert_eq!(manifest.tables().filter(Result::is_ok).count(), usize::from(head.tables));
    assert_eq!(manifest.repairs().len(), usize::from(head.repairs));
    for stream in 0..dgsm::stream::COUNT {
        let choices = manifest.table_set(stream).into_iter().flat_map(|set| set.choices());
        assert!(choices.into_iter().all(|(table, _)| u16::from(table) < head.tables));
    }
    assert!(manifest.epoch_at(head.frames).is_none());
    if let Err(error) = Requirements::of(&manifest, &Caps::HOST) {
        shown(&error);
    }
    let mut message = vec![0u8; codec_core::internals::pack::packed_bound(raw.len()) + 32];
    let sealed = dgsm::seal(raw, &mut message);
    let mut back = vec![0u8; raw.len()];
    let opened = sealed.and_then(|len| dgsm::open(&message[..len], crc32, &mut back).map(<[u8]>::len));
    assert_eq!(opened, Ok(raw.len()));
    assert_eq!(back, raw);
}

/// A receipt (DGSF) without its CRC.
pub fn receipt(data: &[u8]) {
    let bytes = with_crc(data);
    let receipt = match Receipt::parse(&bytes, crc32) {
        Ok(receipt) => receipt,
        Err(error) => {
            assert!(error.offset as usize <= bytes.len(), "{error}: past the end");
            return shown(&error);
        }
    };
    let acknowledged: Result<Vec<IdRange>, _> = receipt.acknowledged().collect();
    let recovered: Result<Vec<_>, _> = receipt.recovered().collect();
    let completed: Result<Vec<_>, _> = receipt.completed().collect();
    let lists = (acknowledged, recovered, completed);
    assert!(matches!(lists, (Ok(_), Ok(_), Ok(_))), "what was read once can be read again: {lists:?}");
    let (Ok(acknowledged), Ok(recovered), Ok(completed)) = lists else { return };
    for pair in acknowledged.windows(2) {
        assert!(pair[0].1.get() + 1 < pair[1].0.get(), "ranges ascend and do not touch");
    }
    let value = Value {
        sequence: receipt.sequence,
        playout_us: receipt.playout_us,
        pose: receipt.pose,
        acknowledged: &acknowledged,
        recovered: &recovered,
        completed: &completed,
    };
    let mut out = vec![0u8; 1300];
    let written = value.write(&mut out);
    assert!(written.is_ok_and(|len| len <= codec_core::internals::limits::MAX_RECEIPT_BYTES), "{written:?}");
    let len = written.unwrap_or(0);
    // The writer keeps to one datagram by worst-case sizes; below that it keeps everything.
    if 8 * acknowledged.len() + 4 * recovered.len() + 7 * completed.len() <= 1148 {
        assert_eq!(out[..len], bytes);
    } else {
        assert!(Receipt::parse(&out[..len], crc32).is_ok());
    }
}

/// A `.dgs` file, as it is and with CRCs that fit.
pub fn file(data: &[u8]) {
    walk(data);
    let sealed = dgs_file(data);
    if sealed != data {
        walk(&sealed);
    }
}

fn walk(data: &[u8]) {
    let start = match dgs::manifest(data) {
        Ok((_, start)) => start,
        Err(error) => {
            shown(&error);
            // The walk must hold from anywhere.
            data.len() / 2
        }
    };
    let mut at = start;
    let mut ended = false;
    for record in dgs::packets(data, start, crc32) {
        assert!(!ended, "nothing follows the end");
        match record {
            dgs::Record::Packet(offset, packet) => {
                assert_eq!(offset, at + 2);
                assert_eq!(Checked::new(packet.bytes(), crc32), Ok(packet.clone()));
                at = offset + packet.bytes().len();
            }
            dgs::Record::Illegal(offset, len, error) => {
                assert_eq!(offset, at + 2);
                let bytes = &data[offset..offset + len];
                assert_eq!(Checked::new(bytes, crc32), Err(error), "the CRC fits, the header does not");
                assert_ne!(error.kind, ErrorKind::Checksum);
                at = offset + len;
            }
            dgs::Record::Damaged(offset, len) => {
                assert_eq!(offset, at);
                assert!(len > 0);
                at += len;
            }
            dgs::Record::End => ended = true,
        }
    }
    assert!(ended || at == data.len().max(start));
    match dgs::index(data, crc32) {
        Ok(entries) => assert!(entries.len() * 4 + 16 <= data.len()),
        Err(error) => shown(&error),
    }
    if let Ok((stream, _)) = Stream::from_bytes(data) {
        let bytes = stream.to_bytes().unwrap_or_default();
        let again = Stream::from_bytes(&bytes);
        assert!(again.as_ref().is_ok_and(|(_, d)| d.ranges.is_empty() && d.index.is_none() && !d.truncated));
        assert_eq!(again.and_then(|(s, _)| s.to_bytes()).as_ref(), Ok(&bytes));
    }
}
