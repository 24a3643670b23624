//! A liar's whole session: a manifest that passes and says what it likes, then packets whose CRCs fit.

use codec_core::internals::{
    limits::MAX_PACKET_BYTES,
    pack::packed_bound,
    wire::manifest::{self as dgsm, Manifest},
};

use crate::{
    input::{Choices, edit},
    seal::with_crc,
    session::assert_frame_drawable,
    streams::{player, small},
};

/// Up to `count` edits, four bytes each.
fn bent(bytes: &[u8], count: usize, choices: &mut Choices<'_>) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    edit(&mut bytes, &mut Choices::new(choices.take(4 * count)));
    bytes
}

/// Input: flags (profile; true packets after the lies; from bit 2 the frame), the number of edits
/// of the unpacked manifest and those edits, then per packet its place (2 bytes), the number of
/// edits of its content and those edits.
pub fn forged(data: &[u8]) {
    let mut choices = Choices::new(data);
    let (flags, edits) = (choices.u8(), usize::from(choices.u8() % 16));
    let stream = small(flags & 1 != 0);
    let Ok(real) = stream.manifest() else { return };
    let raw = bent(real.raw(), edits, &mut choices);
    let Ok(manifest) = Manifest::parse(&raw) else { return };
    let mut message = vec![0u8; packed_bound(raw.len()) + 32];
    let sealed = dgsm::seal(&raw, &mut message);
    assert!(sealed.is_ok(), "{sealed:?}");
    let message = &message[..sealed.unwrap_or(0)];
    // What parses and stays within the caps is taken.
    let Some(mut player) = player(message) else { return };
    let mut offered = 0;
    while !choices.is_empty() {
        let (which, edits) = (choices.below(stream.packets().len()), choices.u8());
        let packet = &stream.packets()[which];
        let mut content = bent(&packet[..packet.len() - 4], usize::from(edits % 8), &mut choices);
        content.truncate(MAX_PACKET_BYTES + 4);
        let packet = with_crc(&content);
        offered += 1;
        let arrival = player.push(&packet);
        match arrival {
            Ok(_) => {
                assert!(player.push(&packet).is_err(), "a replay is refused");
                offered += 1;
            }
            Err(error) => assert!(error.to_string().contains(error.field)),
        }
    }
    if flags & 2 != 0 {
        for packet in stream.packets() {
            offered += 1;
            let _ = player.push(packet);
        }
    }
    let c = player.counters();
    assert_eq!(c.media + c.parity + c.refused.iter().sum::<u32>(), offered, "{c:?}");
    let most = manifest.epochs().map(|e| e.gaussians).max().unwrap_or(0);
    if most <= 1 << 14 {
        let frame = u32::from(flags >> 2) % manifest.head().frames.max(1);
        assert_frame_drawable(&player.content(), frame);
    }
}
