//! Receiver sessions over small real streams: whatever is sent, in whatever order, the state is
//! that of the accepted packets and every state decodes to something that can be drawn.

use std::sync::OnceLock;

use codec_core::{
    Gaussian,
    closure::{Arrived, naive_usable},
    ids::{Level, PacketId, Span},
    receiver::{Arrival, Content, Receiver, for_each_cell},
    wire::manifest::{Manifest, Profile},
};
use trainer_host::stream::{HostMemory, Player};

use crate::{
    input::{Choices, Noise, edit},
    seal::with_crc,
    streams::{cuts, fixture, memory, small},
};

/// However a scene is cut into packets, equal states show the same. Input: flags, frame, then per
/// two bytes a packet of one cut that arrives.
pub fn sliced(data: &[u8]) {
    let mut choices = Choices::new(data);
    let (flags, frame) = (choices.u8(), u32::from(choices.u8()));
    let [small, large] = cuts() else { return };
    let ((stream, _), (other_stream, other)) = if flags & 1 == 0 { (small, large) } else { (large, small) };
    let (Ok(manifest), Ok(other_manifest)) = (stream.manifest(), other_stream.manifest()) else { return };
    let Some(mut memory) = memory(&manifest, 0) else { return };
    {
        let mut receiver = Receiver::new(memory.memory());
        assert_eq!(receiver.control(stream.message()), Ok(()));
        while !choices.is_empty() {
            let which = choices.below(stream.packets().len());
            let _ = receiver.media(&stream.packets()[which]);
        }
    }
    let (part, whole) = (memory.content(&manifest), other.content(&other_manifest));
    assert_eq!(part.blocks.len(), whole.blocks.len(), "one lattice");
    let frame = frame % manifest.head().frames;
    let shown = Player::new(&manifest).instant(&part, frame);
    let same = Player::new(&other_manifest).instant(&whole.with_state(part.blocks), frame);
    assert_eq!(shown, same);
}

/// What must hold of anything decoded.
fn assert_drawable(gaussians: &[Gaussian], sh_rest: &[f32]) {
    for (i, g) in gaussians.iter().enumerate() {
        let finite = g.position.iter().chain(&g.scale).chain(&g.sh0).all(|v| v.is_finite());
        assert!(finite, "Gaussian {i}: {g:?}");
        let length2: f32 = g.rotation.iter().map(|v| v * v).sum();
        assert!((length2 - 1.0).abs() < 1e-4, "Gaussian {i}: rotation {:?}", g.rotation);
        assert!((0.0..=1.0).contains(&g.opacity), "Gaussian {i}: opacity {}", g.opacity);
        assert!(g.scale.iter().all(|&s| s > 0.0), "Gaussian {i}: scale {:?}", g.scale);
    }
    assert!(sh_rest.iter().all(|v| v.is_finite()));
}

pub(crate) fn assert_frame_drawable(content: &Content<'_>, frame: u32) {
    let mut player = Player::new(&content.manifest);
    let instant = player.instant(content, frame);
    assert!(instant.is_ok(), "{instant:?}");
    if let Ok(instant) = instant {
        assert_drawable(&instant.gaussians, &instant.sh_rest);
    }
}

/// One packet with fitting CRC among real ones. Input: flags, then either edits of a real packet
/// (flag 1) or a packet's content.
pub fn slices(data: &[u8]) {
    let mut choices = Choices::new(data);
    let flags = choices.u8();
    let stream = fixture(flags & 1 != 0);
    let packets = stream.packets();
    let forged = if flags & 2 != 0 {
        let picked = &packets[choices.below(packets.len())];
        let mut content = picked[..picked.len() - 4].to_vec();
        edit(&mut content, &mut choices);
        with_crc(&content)
    } else {
        with_crc(choices.rest())
    };
    let Ok(manifest) = stream.manifest() else { return };
    let Some(mut memory) = memory(&manifest, 0) else { return };
    {
        let mut receiver = Receiver::new(memory.memory());
        assert_eq!(receiver.control(stream.message()), Ok(()));
        let before = receiver.content().map(|c| c.blocks.to_vec());
        let mut buffered = false;
        match receiver.media(&forged) {
            Ok(Arrival::Accepted { id, .. }) => {
                assert!(receiver.has(id));
                assert!(receiver.media(&forged).is_err(), "a replay is refused");
            }
            Ok(Arrival::Buffered) => buffered = true,
            Err(error) => {
                assert!(!error.to_string().is_empty());
                assert_eq!(
                    receiver.content().map(|c| c.blocks.to_vec()),
                    before,
                    "a refusal changes nothing"
                );
            }
        }
        if flags & 4 != 0 {
            for packet in packets {
                let _ = receiver.media(packet);
            }
        }
        assert!(!buffered && receiver.counters().early == 0, "nothing waits once there is a manifest");
    }
    let frame = u32::from(flags >> 3) % manifest.head().frames;
    assert_frame_drawable(&memory.content(&manifest), frame);
}

/// Any symbols, any state, almost any manifest. Input: flags, seed, then edits of a real unpacked
/// manifest body (flag 2) or a body.
pub fn decode(data: &[u8]) {
    let mut choices = Choices::new(data);
    let (flags, seed) = (choices.u8(), choices.u32());
    let raw = if flags & 2 != 0 {
        let Ok(real) = fixture(flags & 1 != 0).manifest() else { return };
        let mut raw = real.raw().to_vec();
        edit(&mut raw, &mut choices);
        raw
    } else {
        choices.rest().to_vec()
    };
    let Ok(manifest) = Manifest::parse(&raw) else { return };
    let Some(memory) = memory(&manifest, 0) else { return };
    let mut noise = Noise(seed.into());
    let empty = memory.content(&manifest);
    // Magnitudes from all-small to all-extreme.
    let shift = noise.next() % 16;
    let symbols: Vec<i16> = empty.symbols.iter().map(|_| (noise.next() as i16) >> shift).collect();
    let state: Vec<u8> = empty.blocks.iter().map(|_| noise.next() as u8).collect();
    let mut cells = Vec::new();
    let mut next = codec_core::receiver::Cell::default();
    for_each_cell(&manifest, |_, _, shape| {
        cells.push(next);
        next.symbols += shape.len() as u32;
        next.blocks += shape.blocks() as u32;
    });
    assert_eq!(cells.len(), manifest.cells(), "every cell of the lattice has a shape");
    assert_eq!((next.symbols as usize, next.blocks as usize), (symbols.len(), state.len()));
    let content = Content { manifest, cells: &cells, symbols: &symbols, blocks: &state };
    let largest = manifest.epochs().map(|e| e.gaussians).max().unwrap_or(0);
    if largest <= 1 << 16 {
        assert_frame_drawable(&content, noise.next() as u32 % manifest.head().frames);
    }
}

/// States of a real stream. Input: flags, frame, then masks, repeated over the blocks.
pub fn closure(data: &[u8]) {
    static RECEIVED: OnceLock<Vec<HostMemory>> = OnceLock::new();
    let received = RECEIVED.get_or_init(|| {
        let full = |paper| {
            let stream = small(paper);
            let manifest = stream.manifest().ok()?;
            let mut memory = memory(&manifest, 0)?;
            let mut receiver = Receiver::new(memory.memory());
            receiver.control(stream.message()).ok()?;
            stream.packets().iter().for_each(|p| {
                let _ = receiver.media(p);
            });
            Some(memory)
        };
        [false, true].into_iter().filter_map(full).collect()
    });
    let mut choices = Choices::new(data);
    let (flags, frame) = (choices.u8(), u32::from(choices.u8()));
    let paper = flags & 1 != 0;
    let masks = choices.rest();
    for &mask in masks {
        let arrived = Arrived(mask);
        let naive = Level::ALL.into_iter().filter(|&l| naive_usable(|l| arrived.has(l), l)).count();
        assert_eq!(arrived.usable(), naive);
        for level in Level::ALL {
            assert!(arrived.with(level).has(level) && !arrived.without(level).has(level));
            assert!(arrived.with(level).usable() >= arrived.usable());
        }
    }
    let Ok(manifest) = small(paper).manifest() else { return };
    let content = received[usize::from(paper)].content(&manifest);
    if masks.is_empty() {
        return;
    }
    let state: Vec<u8> = content.blocks.iter().zip(masks.iter().cycle()).map(|(b, m)| b & m).collect();
    // What is not usable must not matter.
    let usable: Vec<u8> = state.iter().map(|&m| (1u8 << Arrived(m).usable()) - 1).collect();
    let frame = frame % manifest.head().frames;
    let mut player = Player::new(&manifest);
    let shown = player.instant(&content.with_state(&state), frame);
    let same = Player::new(&manifest).instant(&content.with_state(&usable), frame);
    assert_eq!(shown, same, "levels above a gap are not seen");
    if let Ok(instant) = shown {
        assert_drawable(&instant.gaussians, &instant.sh_rest);
    }
    // A player that saw another state before shows the same.
    let _ = player.instant(&content, frame);
    assert_eq!(player.instant(&content.with_state(&usable), frame), same);
}

/// A session as a list of operations. Input: flags, then four bytes per operation: what, which
/// packet (2), how.
pub fn receiver(data: &[u8]) {
    let mut choices = Choices::new(data);
    let flags = choices.u8();
    let stream = fixture(flags & 1 != 0);
    let Ok(manifest) = stream.manifest() else { return };
    let packets = stream.packets();
    let early = if flags & 2 != 0 { 4000 } else { 0 };
    let Some(mut first) = memory(&manifest, early) else { return };
    let mut accepted: Vec<Vec<u8>> = Vec::new();
    let mut forged = false;
    {
        let mut receiver = Receiver::new(first.memory());
        let (mut offered, mut waiting) = (0u32, Vec::new());
        let mut is_open = false;
        if flags & 4 != 0 {
            assert_eq!(receiver.control(stream.message()), Ok(()));
            is_open = true;
        }
        while !choices.is_empty() {
            let (op, which, how) = (choices.u8(), choices.below(packets.len()), choices.u8());
            let mut packet = packets[which].clone();
            match op % 16 {
                0..=8 => {}
                9 => {
                    let at = usize::from(how) * 5 % packet.len();
                    packet[at] ^= 1 << (how % 8);
                }
                10 => packet.truncate(packet.len() * usize::from(how) / 256),
                11 => packet.extend_from_slice(&[how; 9]),
                12 => packet = vec![how; usize::from(how) * 6],
                13 if flags & 8 != 0 => {
                    forged = true;
                    let mut content = packet[..packet.len() - 4].to_vec();
                    let at = usize::from(how) * 3 % content.len();
                    content[at] ^= 1 << (op >> 5);
                    packet = with_crc(&content);
                }
                14 => {
                    let mut message = stream.message().to_vec();
                    if how & 1 == 0 {
                        let at = usize::from(how) * 7 % message.len();
                        message[at] ^= 0x55;
                        assert!(receiver.control(&message).is_err());
                    } else {
                        assert_eq!(receiver.control(&message).is_ok(), !is_open);
                        is_open = true;
                        accepted.append(&mut waiting);
                    }
                    continue;
                }
                _ => {
                    // A run of the stream in order.
                    for packet in packets.iter().skip(which).take(usize::from(how) % 40) {
                        offered += 1;
                        note(receiver.media(packet), packet, &mut accepted, &mut waiting);
                    }
                    continue;
                }
            }
            offered += 1;
            note(receiver.media(&packet), &packet, &mut accepted, &mut waiting);
        }
        if !is_open {
            assert_eq!(receiver.control(stream.message()), Ok(()));
            accepted.append(&mut waiting);
        }
        let c = receiver.counters();
        let refused: u32 = c.refused.iter().sum();
        // What was buffered is counted when it comes and again when it is taken.
        assert_eq!(c.media + c.parity + refused, offered, "{c:?}");
        assert!(c.recovered <= c.parity, "each parity packet gives back at most one");
    }
    let frame = u32::from(flags >> 4) % manifest.head().frames;
    assert_frame_drawable(&first.content(&manifest), frame);
    if forged {
        return;
    }
    let Some(mut second) = memory(&manifest, 0) else { return };
    {
        let mut receiver = Receiver::new(second.memory());
        assert_eq!(receiver.control(stream.message()), Ok(()));
        let mut noise = Noise(data.len() as u64);
        for i in (1..accepted.len()).rev() {
            accepted.swap(i, (noise.next() % (i as u64 + 1)) as usize);
        }
        for packet in &accepted {
            let _ = receiver.media(packet);
        }
        for (id, _) in packets.iter().enumerate().filter(|(_, p)| accepted.contains(p)) {
            assert!(PacketId::new(id as u32).is_some_and(|id| receiver.has(id)));
        }
    }
    assert_same(&first.content(&manifest), &second.content(&manifest));
}

fn note(
    result: codec_core::Result<Arrival>,
    packet: &[u8],
    accepted: &mut Vec<Vec<u8>>,
    waiting: &mut Vec<Vec<u8>>,
) {
    match result {
        Ok(Arrival::Accepted { .. }) => accepted.push(packet.to_vec()),
        Ok(Arrival::Buffered) => waiting.push(packet.to_vec()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Equal states, and equal symbols wherever they count.
fn assert_same(a: &Content<'_>, b: &Content<'_>) {
    assert_eq!(a.blocks, b.blocks, "the same packets give the same state in any order");
    let manifest = a.manifest;
    for_each_cell(&manifest, |span: Span, cluster, shape| {
        let Some(cell) = a.cell(span, cluster) else { return };
        let blocks = if manifest.profile() == Profile::Paper { 1 } else { shape.blocks() };
        for block in 0..blocks {
            for level in Level::ALL.into_iter().filter(|&l| a.arrived(cell, block).has(l)) {
                let (start, len) = shape.range(level, block..block + 1);
                let range = cell.symbols as usize + start..cell.symbols as usize + start + len;
                assert_eq!(a.symbols.get(range.clone()), b.symbols.get(range), "{span:?} {cluster} {level}");
            }
        }
    });
}
