//! What sessions refuse: golden streams whose bytes are changed and sealed again, caps and memory that are
//! too small.

use std::{collections::BTreeMap, path::Path, sync::OnceLock};

use codec_core::{
    Caps, Error,
    internals::{
        arena::Plan,
        ids::PacketId,
        wire::{
            crc::crc32,
            file,
            manifest::{Manifest, ManifestHead, open},
            packet::Packet,
            receipt::{Receipt, Value, ViewerPose},
        },
    },
    player::Waiting,
};

use crate::session::{parts, unpacked};

/// Streams of both profiles, with and without windows, proxies, repair and several extents in a packet.
const STREAMS: [&str; 5] = ["one", "tracks", "made-extents", "made-paper", "paper-repaired"];

/// The first error of every field and kind that changed streams gave.
#[derive(Default)]
struct Seen(BTreeMap<(&'static str, usize), Error>);

impl Seen {
    fn note<T>(&mut self, result: codec_core::Result<T>) -> Option<T> {
        result.map_err(|e| self.0.entry((e.field, e.kind.index())).or_insert(e)).ok()
    }
}

/// An error of every field and kind that is seen.
pub fn errors() -> &'static [Error] {
    static ERRORS: OnceLock<Vec<Error>> = OnceLock::new();
    ERRORS.get_or_init(|| {
        let mut seen = Seen::default();
        for name in STREAMS {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/conformance/{name}.dgs"));
            let bytes = std::fs::read(path).unwrap();
            let (message, packets) = parts(&bytes);
            envelopes(&bytes, message, &mut seen);
            bodies(&unpacked(message), &mut seen);
            sessions(message, &packets, &mut seen);
        }
        receipts(&mut seen);
        let errors: Vec<Error> = seen.0.into_values().collect();
        assert!(errors.len() > 90, "{} fields and kinds were seen", errors.len());
        errors
    })
}

/// `bytes` with other values of the byte at `at`.
fn changed(bytes: &[u8], at: usize) -> impl Iterator<Item = Vec<u8>> {
    let old = bytes[at];
    [0, 0xff, old ^ 1, old ^ 0x10, old ^ 0x80].into_iter().map(move |new| {
        let mut bytes = bytes.to_vec();
        bytes[at] = new;
        bytes
    })
}

/// `content` with its CRC.
fn with_crc(content: &[u8]) -> Vec<u8> {
    [content, &crc32(content).to_le_bytes()].concat()
}

/// Files and messages, whose CRCs are left as they are, and cut ones.
fn envelopes(bytes: &[u8], message: &[u8], seen: &mut Seen) {
    let mut raw = unpacked(message);
    for at in 0..40 {
        for bytes in changed(bytes, at) {
            seen.note(file::manifest(&bytes));
        }
        for bytes in changed(bytes, bytes.len() - 1 - at) {
            seen.note(file::index(&bytes, crc32).map(|_| ()));
        }
        seen.note(open(&message[..at], crc32, &mut raw));
    }
    let packed = &message[..message.len() - 4];
    for at in 0..24 {
        for message in changed(packed, at).map(|packed| with_crc(&packed)) {
            seen.note(open(&message, crc32, &mut raw));
        }
    }
    seen.note(open(&with_crc(&packed[..packed.len() - 1]), crc32, &mut raw));
    seen.note(open(&[message, &[0]].concat(), crc32, &mut raw));
    seen.note(open(message, crc32, &mut raw[1..]));
}

/// Manifests with other bytes, cut ones, and caps that are too small for them.
fn bodies(body: &[u8], seen: &mut Seen) {
    // All of the head and of the first records; of what follows enough to meet every field.
    let step = |at: usize| if at < 400 { 1 } else { 1 + body.len() / 1500 };
    let mut at = 0;
    while at < body.len() {
        for body in changed(body, at) {
            if let Some(manifest) = seen.note(Manifest::parse(&body)) {
                seen.note(Plan::of(&manifest, &Caps::SMALL));
            }
        }
        seen.note(Manifest::parse(&body[..at]));
        at += step(at);
    }
    seen.note(Manifest::parse(&[body, &[0]].concat()));
    let manifest = Manifest::parse(body).unwrap();
    let most = Caps::HOST;
    for caps in [
        Caps { gaussians_per_epoch: 0, ..most },
        Caps { frames: 0, ..most },
        Caps { cells: 0, ..most },
        Caps { symbols: 0, ..most },
        Caps { blocks: 0, ..most },
        Caps { packets: 0, ..most },
        Caps { tables: 0, ..most },
        Caps { manifest_bytes: 0, ..most },
    ] {
        seen.note(Plan::of(&manifest, &caps));
    }
}

/// Packets with other bytes, cut ones, doubled ones; players whose memory is too small.
fn sessions(message: &[u8], packets: &[&[u8]], seen: &mut Seen) {
    let raw_len = ManifestHead::parse(message).unwrap().raw_len;
    for caps in [
        Caps { early_bytes: 0, ..Caps::HOST },
        Caps { early_bytes: 0, values_per_packet: 0, ..Caps::HOST },
        Caps { early_bytes: 0, blocks_per_packet: 0, ..Caps::HOST },
    ] {
        let mut scratch = vec![0; raw_len.div_ceil(8)];
        let need = Waiting::new(&mut scratch, caps).unwrap().required(message).unwrap();
        let mut arena = vec![0; need.words];
        let waiting = Waiting::new(&mut arena, caps).unwrap();
        let mut player = waiting.manifest(message).map_err(|(_, error)| error).unwrap();
        for packet in packets.iter().take(30).chain(packets.iter().rev().take(10)) {
            let content = &packet[..packet.len() - 4];
            for at in (0..content.len()).take(40).chain(content.len().saturating_sub(5)..content.len()) {
                changed(content, at).for_each(|content| {
                    seen.note(player.push(&with_crc(&content)));
                    seen.note(Packet::parse(&content).map(|_| ()));
                });
                seen.note(player.push(&with_crc(&content[..at])));
            }
            seen.note(player.push(content));
            seen.note(player.push(packet));
            seen.note(player.push(packet));
        }
        seen.note(player.frame(player.info().frames).map(|_| ()));
    }
    let caps = Caps { early_bytes: 8, ..Caps::HOST };
    seen.note(Waiting::new(&mut [], caps).map(|_| ()));
    let mut arena = vec![0; 1 + raw_len.div_ceil(8)];
    let mut waiting = Waiting::new(&mut arena, caps).unwrap();
    seen.note(waiting.push(packets[0]));
    if let Err((_, error)) = waiting.manifest(message) {
        seen.note::<()>(Err(error));
    }
}

/// Receipts with other bytes and cut ones.
fn receipts(seen: &mut Seen) {
    let id = |i| PacketId::new(i).unwrap();
    let value = Value {
        sequence: 300,
        playout_us: 5,
        pose: Some(ViewerPose { position: [1.0, 2.0, 3.0], rotation: [1.0, 0.0, 0.0, 0.0] }),
        acknowledged: &[(id(2), id(5)), (id(9), id(PacketId::MAX))],
        recovered: &[id(4)],
        completed: &[],
    };
    let mut out = [0u8; 200];
    let len = value.write(&mut out).unwrap();
    let content = &out[..len - 4];
    for at in 0..content.len() {
        for content in changed(content, at) {
            seen.note(Receipt::parse(&with_crc(&content), crc32));
        }
        seen.note(Receipt::parse(&with_crc(&content[..at]), crc32));
    }
    seen.note(Receipt::parse(content, crc32));
    let backwards = Value { acknowledged: &[(id(9), id(9)), (id(2), id(5))], ..value };
    seen.note(backwards.write(&mut out));
}
