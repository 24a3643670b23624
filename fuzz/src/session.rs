//! Receiver sessions over small real streams: whatever is sent, in whatever order, the state is
//! that of the accepted packets and every state decodes to something that can be drawn.

use std::sync::OnceLock;

use codec_core::{
    Caps, ErrorKind, Gaussian, Result,
    internals::{
        closure::{Arrived, naive_usable},
        ids::{Level, PacketId, Span},
        receiver::{Content, Requirements, for_each_cell},
        wire::manifest::{Manifest, Profile},
    },
    player::Counters,
};
use dgs_player::{FrameDecoder, Player, Waiting};

use crate::{
    input::{Choices, Noise, edit},
    seal::with_crc,
    streams::{CAPS, cuts, fixture, player, small},
};

/// However a scene is cut into packets, equal states show the same. Input: flags, frame, then per
/// two bytes a packet of one cut that arrives.
pub fn sliced(data: &[u8]) {
    let mut choices = Choices::new(data);
    let (flags, frame) = (choices.u8(), u32::from(choices.u8()));
    let [small, large] = cuts() else { return };
    let ((stream, _), (other_stream, other)) = if flags & 1 == 0 { (small, large) } else { (large, small) };
    let (Ok(manifest), Ok(other_manifest)) = (stream.manifest(), other_stream.manifest()) else { return };
    let Some(mut player) = player(stream.message()) else { return };
    while !choices.is_empty() {
        let which = choices.below(stream.packets().len());
        let _ = player.push(&stream.packets()[which]);
    }
    let (part, whole) = (player.content(), other.content());
    assert_eq!(part.blocks.len(), whole.blocks.len(), "one lattice");
    let frame = frame % manifest.head().frames;
    let shown = instant(&mut FrameDecoder::new(&manifest), &part, frame);
    let same = instant(&mut FrameDecoder::new(&other_manifest), &whole.with_state(part.blocks), frame);
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

/// Gaussians and higher bands of a frame of `content`.
fn instant(
    decoder: &mut FrameDecoder,
    content: &Content<'_>,
    frame: u32,
) -> Result<(Vec<Gaussian>, Vec<f32>)> {
    let shown = decoder.frame(content, frame)?;
    Ok((shown.gaussians.to_vec(), shown.sh_rest.to_vec()))
}

pub(crate) fn assert_frame_drawable(content: &Content<'_>, frame: u32) {
    let instant = instant(&mut FrameDecoder::new(content.manifest), content, frame);
    assert!(instant.is_ok(), "{instant:?}");
    if let Ok((gaussians, sh_rest)) = instant {
        assert_drawable(&gaussians, &sh_rest);
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
    let Some(mut player) = player(stream.message()) else { return };
    let before = player.content().blocks.to_vec();
    match player.push(&forged) {
        Ok(accepted) => {
            assert!(player.has(accepted.id));
            assert!(player.push(&forged).is_err(), "a replay is refused");
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            assert_eq!(player.content().blocks, before, "a refusal changes nothing");
        }
    }
    if flags & 4 != 0 {
        for packet in packets {
            let _ = player.push(packet);
        }
    }
    assert_eq!(player.counters().early, 0, "nothing waits once there is a manifest");
    let frame = u32::from(flags >> 3) % manifest.head().frames;
    assert_frame_drawable(&player.content(), frame);
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
    let need = match Requirements::of(&manifest, &CAPS) {
        Ok(need) => need,
        Err(error) => return assert_eq!(error.kind, ErrorKind::Capacity, "{error}"),
    };
    let mut noise = Noise(seed.into());
    // Magnitudes from all-small to all-extreme.
    let shift = noise.next() % 16;
    let symbols: Vec<i16> = (0..need.symbols).map(|_| (noise.next() as i16) >> shift).collect();
    let state: Vec<u8> = (0..need.blocks).map(|_| noise.next() as u8).collect();
    let mut cells = Vec::new();
    let mut next = codec_core::internals::receiver::Cell::default();
    let walked = for_each_cell(&manifest, |_, _, shape| {
        cells.push(next);
        next.symbols += shape.len() as u32;
        next.blocks += shape.blocks() as u32;
        Ok(())
    });
    assert_eq!(walked, Ok(()), "every cell of a checked lattice has a shape");
    assert_eq!(cells.len(), manifest.cells(), "every cell of the lattice has a shape");
    assert_eq!((next.symbols as usize, next.blocks as usize), (symbols.len(), state.len()));
    let content = Content { manifest: &manifest, cells: &cells, symbols: &symbols, blocks: &state };
    let largest = manifest.largest_epoch();
    if largest <= 1 << 16 {
        assert_frame_drawable(&content, noise.next() as u32 % manifest.head().frames);
    }
}

/// States of a real stream. Input: flags, frame, then masks, repeated over the blocks.
pub fn closure(data: &[u8]) {
    static RECEIVED: OnceLock<Vec<Player>> = OnceLock::new();
    let received = RECEIVED
        .get_or_init(|| [false, true].into_iter().filter_map(|paper| small(paper).receive().ok()).collect());
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
    let content = received[usize::from(paper)].content();
    if masks.is_empty() {
        return;
    }
    let state: Vec<u8> = content.blocks.iter().zip(masks.iter().cycle()).map(|(b, m)| b & m).collect();
    // What is not usable must not matter.
    let usable: Vec<u8> = state.iter().map(|&m| (1u8 << Arrived(m).usable()) - 1).collect();
    let frame = frame % manifest.head().frames;
    let mut decoder = FrameDecoder::new(&manifest);
    let shown = instant(&mut decoder, &content.with_state(&state), frame);
    let same = instant(&mut FrameDecoder::new(&manifest), &content.with_state(&usable), frame);
    assert_eq!(shown, same, "levels above a gap are not seen");
    if let Ok((gaussians, sh_rest)) = shown {
        assert_drawable(&gaussians, &sh_rest);
    }
    // A decoder that saw another state before shows the same.
    let _ = decoder.frame(&content, frame);
    assert_eq!(instant(&mut decoder, &content.with_state(&usable), frame), same);
}

/// A player before and after its manifest, and what it was given.
struct Session {
    waiting: Option<Waiting>,
    player: Option<Player>,
    offered: u32,
    buffered: Vec<Vec<u8>>,
    accepted: Vec<Vec<u8>>,
}

impl Session {
    fn new(early_bytes: u32) -> Result<Self> {
        let waiting = Some(Waiting::new(Caps { early_bytes, ..CAPS })?);
        Ok(Self { waiting, player: None, offered: 0, buffered: Vec::new(), accepted: Vec::new() })
    }

    /// Whether `message` turns a waiting player into one that plays.
    fn manifest(&mut self, message: &[u8]) -> bool {
        let Some(waiting) = self.waiting.take() else { return false };
        match waiting.manifest(message) {
            Ok(player) => {
                self.player = Some(player);
                self.accepted.append(&mut self.buffered);
                true
            }
            Err((waiting, error)) => {
                assert!(!error.to_string().is_empty());
                self.waiting = Some(waiting);
                false
            }
        }
    }

    fn offer(&mut self, packet: &[u8]) {
        self.offered += 1;
        let error = if let Some(player) = &mut self.player {
            player.push(packet).map(|_| self.accepted.push(packet.to_vec())).err()
        } else {
            let waiting = self.waiting.as_mut().map(|waiting| waiting.push(packet));
            waiting.and_then(|pushed| pushed.map(|()| self.buffered.push(packet.to_vec())).err())
        };
        assert!(error.is_none_or(|error| !error.to_string().is_empty()));
    }
}

/// A session as a list of operations. Input: flags, then four bytes per operation: what, which
/// packet (2), how.
pub fn receiver(data: &[u8]) {
    let mut choices = Choices::new(data);
    let flags = choices.u8();
    let stream = fixture(flags & 1 != 0);
    let Ok(manifest) = stream.manifest() else { return };
    let packets = stream.packets();
    let Ok(mut session) = Session::new(if flags & 2 != 0 { 4000 } else { 0 }) else { return };
    let mut forged = false;
    if flags & 4 != 0 {
        assert!(session.manifest(stream.message()));
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
                    assert!(!session.manifest(&message));
                } else {
                    let waits = session.waiting.is_some();
                    assert_eq!(session.manifest(&message), waits);
                }
                continue;
            }
            _ => {
                // Some of the stream's packets in order.
                for packet in packets.iter().skip(which).take(usize::from(how) % 40) {
                    session.offer(packet);
                }
                continue;
            }
        }
        session.offer(&packet);
    }
    if session.waiting.is_some() {
        assert!(session.manifest(stream.message()));
    }
    let Session { player: Some(first), offered, mut accepted, .. } = session else { return };
    let c: &Counters = first.counters();
    let refused: u32 = c.refused.iter().sum();
    // What was kept is counted when it comes and again when it is taken.
    assert_eq!(c.media + c.parity + refused, offered, "{c:?}");
    assert!(c.recovered <= c.parity, "each parity packet gives back at most one");
    let frame = u32::from(flags >> 4) % manifest.head().frames;
    assert_frame_drawable(&first.content(), frame);
    if forged {
        return;
    }
    let Some(mut second) = player(stream.message()) else { return };
    let mut noise = Noise(data.len() as u64);
    for i in (1..accepted.len()).rev() {
        accepted.swap(i, (noise.next() % (i as u64 + 1)) as usize);
    }
    for packet in &accepted {
        let _ = second.push(packet);
    }
    for (id, _) in packets.iter().enumerate().filter(|(_, p)| accepted.contains(p)) {
        assert!(PacketId::new(id as u32).is_some_and(|id| second.has(id)));
    }
    assert_same(&first.content(), &second.content());
}

/// Equal states, and equal symbols wherever they count.
fn assert_same(a: &Content<'_>, b: &Content<'_>) {
    assert_eq!(a.blocks, b.blocks, "the same packets give the same state in any order");
    let manifest = a.manifest;
    let same = for_each_cell(manifest, |span: Span, cluster, shape| {
        let cell = a.cell_in_lattice(span, cluster)?;
        let blocks = if manifest.profile() == Profile::Paper { 1 } else { shape.blocks() };
        for block in 0..blocks {
            let arrived = a.arrived(cell, block)?;
            for level in Level::ALL.into_iter().filter(|&l| arrived.has(l)) {
                let (start, len) = shape.range(level, block..block + 1);
                let range = cell.symbols as usize + start..cell.symbols as usize + start + len;
                assert_eq!(a.symbols.get(range.clone()), b.symbols.get(range), "{span:?} {cluster} {level}");
            }
        }
        Ok(())
    });
    assert_eq!(same, Ok(()));
}
