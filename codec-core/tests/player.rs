//! The front door: memory by caps alone, early packets, refusals that leave a player as it was, what is
//! usable, receipts. `conformance.rs` holds what players show against the golden streams.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers fail like tests")]

use std::path::Path;

use codec_core::{
    Caps, Error, ErrorKind, Gaussian, file,
    internals::{
        arena::FrameRequirements,
        decode::{Decoder, Memory},
        digest::Digest,
        ids::PacketId,
        receiver::Content,
        wire::{crc::crc32, receipt::Receipt},
    },
    player::{Player, Usable, Waiting},
};

const STREAMS: [&str; 5] = ["one", "everything", "cauchy", "paper", "blocks-of-one"];

fn stream(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance");
    std::fs::read(folder.join(format!("{name}.dgs"))).unwrap()
}

fn parts(bytes: &[u8]) -> (&[u8], Vec<&[u8]>) {
    let (message, packets) = file::parts(bytes).unwrap();
    (message, packets.collect())
}

fn play<'a>(arena: &'a mut [u64], caps: Caps, message: &[u8]) -> Result<Player<'a>, Error> {
    Waiting::new(arena, caps)?.manifest(message).map_err(|(_, error)| error)
}

/// FNV-1a over all frames.
fn digest(player: &mut Player<'_>) -> u64 {
    let mut digest = Digest::new();
    for frame in 0..player.manifest().head().frames {
        let shown = player.frame(frame).unwrap();
        digest = digest.frame(shown.gaussians, shown.sh_rest);
    }
    digest.get()
}

#[test]
fn an_arena_of_the_required_length_is_enough_and_a_word_less_is_not() {
    for name in STREAMS {
        let bytes = stream(name);
        let (message, packets) = parts(&bytes);
        let mut scratch = vec![0; 1 << 16];
        let need = Waiting::new(&mut scratch, Caps::SMALL).unwrap().required(message).unwrap();
        let mut digests = Vec::new();
        for words in [need.words, need.least_words] {
            let mut arena = vec![u64::MAX; words];
            let mut player = play(&mut arena, Caps::SMALL, message).unwrap();
            packets.iter().for_each(|packet| assert!(player.push(packet).is_ok()));
            digests.push(digest(&mut player));
        }
        assert_eq!(digests[0], digests[1], "{name}: tables of either form decode the same");
        let mut arena = vec![0; need.least_words - 1];
        let error = play(&mut arena, Caps::SMALL, message).unwrap_err();
        let bytes = |words: usize| words as u64 * 8;
        assert_eq!((error.field, error.kind), ("arena", ErrorKind::Capacity), "{name}");
        assert_eq!(error.found, bytes(need.least_words - 1), "{name}");
        assert_eq!(error.allowed.0, bytes(need.least_words), "{name}");
    }
}

#[test]
fn an_arena_sized_by_caps_alone_holds_every_stream_within_them() {
    let mut arena = vec![0; Caps::SMALL.arena_words()];
    for name in STREAMS {
        let bytes = stream(name);
        let (message, packets) = parts(&bytes);
        let mut player = play(&mut arena, Caps::SMALL, message).unwrap();
        packets.iter().for_each(|packet| assert!(player.push(packet).is_ok()));
        let epochs = player.manifest().epochs().map(|epoch| epoch.gaussians).max().unwrap();
        assert!(player.frame(0).is_ok());
        // Caps that the stream just meets still size an arena for it; one less refuses it by name.
        let caps = Caps { gaussians_per_epoch: epochs, early_bytes: 0, ..Caps::SMALL };
        assert!(play(&mut vec![0; caps.arena_words()], caps, message).is_ok(), "{name}");
        let caps = Caps { gaussians_per_epoch: epochs - 1, ..caps };
        let error = play(&mut vec![0; caps.arena_words()], caps, message).unwrap_err();
        assert_eq!((error.field, error.kind), ("epoch.gaussians", ErrorKind::Capacity), "{name}");
    }
    let caps = Caps { early_bytes: 100, ..Caps::SMALL };
    let error = Waiting::new(&mut [0; 12], caps).unwrap_err();
    assert_eq!((error.field, error.found, error.allowed.0), ("arena", 96, 100));
}

#[test]
fn packets_before_the_manifest_are_buffered_within_a_bound_and_shown_after_it() {
    for name in STREAMS {
        let bytes = stream(name);
        let (message, packets) = parts(&bytes);
        let mut after = vec![0; 1 << 16];
        let mut after = play(&mut after, Caps::SMALL, message).unwrap();
        packets.iter().for_each(|packet| assert!(after.push(packet).is_ok()));

        let buffered: usize = packets.iter().map(|packet| packet.len() + 2).sum();
        let caps = Caps { early_bytes: buffered as u32, ..Caps::SMALL };
        let mut arena = vec![0; 1 << 16];
        let mut waiting = Waiting::new(&mut arena, caps).unwrap();
        packets.iter().for_each(|packet| assert_eq!(waiting.push(packet), Ok(())));
        let error = waiting.push(packets[0]).unwrap_err();
        assert_eq!((error.field, error.kind), ("caps.early_bytes", ErrorKind::Capacity));
        let mut damaged = packets[0].to_vec();
        damaged[0] ^= 1;
        assert_eq!(waiting.push(&damaged).unwrap_err().kind, ErrorKind::Checksum);
        // A manifest that is refused leaves what was kept.
        let mut wrong = message.to_vec();
        wrong[30] ^= 1;
        let (waiting, error) = waiting.manifest(&wrong).unwrap_err();
        assert_eq!(error.field, "manifest.crc");
        let mut player = waiting.manifest(message).unwrap_or_else(|(_, error)| panic!("{error}"));
        let (early, late) = (*player.counters(), *after.counters());
        assert_eq!((early.media, early.parity), (late.media, late.parity), "{name}");
        assert_eq!((early.early as usize, late.early), (packets.len(), 0), "{name}");
        let refused = |kind: ErrorKind| early.refused[kind.index()];
        assert_eq!((refused(ErrorKind::Capacity), refused(ErrorKind::Checksum)), (1, 1));
        assert_eq!(digest(&mut player), digest(&mut after), "{name}");
    }
}

#[test]
fn usable_counts_are_those_of_the_state() {
    for name in STREAMS {
        let bytes = stream(name);
        let (message, packets) = parts(&bytes);
        let mut arena = vec![0; 1 << 16];
        let mut player = play(&mut arena, Caps::SMALL, message).unwrap();
        let nothing = player.usable(0).unwrap();
        assert!(nothing.blocks > 0 && nothing.canonical == [0; 4], "{name}: {nothing:?}");
        let mut before = nothing;
        for packet in packets {
            player.push(packet).unwrap();
            let usable = player.usable(0).unwrap();
            let grows = |a: [u32; 4], b: [u32; 4]| a.iter().zip(b).all(|(a, b)| *a <= b);
            assert!(grows(before.canonical, usable.canonical) && grows(before.motion, usable.motion));
            assert!(usable.canonical.is_sorted_by(|a, b| a >= b), "{name}: a level needs those below");
            let decoded = player.frame(0).unwrap().decoded;
            assert_eq!((decoded.blocks, decoded.present_blocks), (usable.blocks, usable.canonical[0]));
            before = usable;
        }
        assert_eq!(before.canonical, [before.blocks; 4], "{name}: all has arrived");
        let frames = player.manifest().head().frames;
        let error = player.usable(frames).unwrap_err();
        assert_eq!((error.field, error.allowed), ("frame", (0, u64::from(frames) - 1)));
        assert_ne!(before, Usable::default());
    }
}

#[test]
fn a_receipt_acknowledges_what_has_arrived_and_nothing_else() {
    let bytes = stream("everything");
    let (message, packets) = parts(&bytes);
    let mut arena = vec![0; 1 << 16];
    let mut player = play(&mut arena, Caps::SMALL, message).unwrap();
    let missing = [3, 4, 9];
    for (i, packet) in packets.iter().enumerate().filter(|(i, _)| !missing.contains(i)) {
        assert_eq!(player.push(packet).unwrap().id, PacketId::new(i as u32).unwrap());
    }
    let mut out = [0; codec_core::internals::limits::MAX_RECEIPT_BYTES];
    let len = player.receipt(7, 40_000, None, &mut out).unwrap();
    let receipt = Receipt::parse(&out[..len], crc32).unwrap();
    assert_eq!((receipt.sequence, receipt.playout_us), (7, 40_000));
    let acknowledged: Vec<u32> =
        receipt.acknowledged().map(Result::unwrap).flat_map(|(a, z)| a.get()..=z.get()).collect();
    let wanted: Vec<u32> =
        (0..packets.len() as u32).filter(|&id| player.has(PacketId::new(id).unwrap())).collect();
    assert_eq!(acknowledged, wanted);
    assert!(wanted.len() < packets.len() && !wanted.contains(&3));
    assert_eq!(player.receipt(7, 0, None, &mut out[..8]).unwrap_err().kind, ErrorKind::Capacity);
}

/// Decodes every frame of `content`; the field of the first error.
fn fault(content: &Content<'_>) -> Option<&'static str> {
    let FrameRequirements { gaussians, blocks, sh_rest } = FrameRequirements::of(content.manifest);
    let (mut canonical, mut known) = (vec![Gaussian::ABSENT; gaussians], vec![0; blocks]);
    let (mut out, mut rest) = (canonical.clone(), vec![0.0; sh_rest]);
    let mut decoder = Decoder::new(Memory { canonical: &mut canonical, known: &mut known });
    let mut frames = 0..content.manifest.head().frames;
    frames.find_map(|frame| decoder.frame(content, frame, &mut out, &mut rest).err()).map(|error| {
        assert_eq!(error.kind, ErrorKind::Capacity, "{error}");
        error.field
    })
}

/// What is not there is an error by its name, and no Gaussian that is absent or at rest.
#[test]
fn content_that_is_short_is_named() {
    for name in STREAMS {
        let bytes = stream(name);
        let (message, packets) = parts(&bytes);
        let mut arena = vec![0; 1 << 16];
        let mut player = play(&mut arena, Caps::SMALL, message).unwrap();
        packets.iter().for_each(|packet| assert!(player.push(packet).is_ok()));
        let content = player.content();
        assert_eq!(fault(&content), None, "{name}");
        let symbols = Content { symbols: &content.symbols[..content.symbols.len() - 1], ..content };
        assert_eq!(fault(&symbols), Some("memory.symbols"), "{name}");
        let blocks = content.with_state(&content.blocks[..content.blocks.len() - 1]);
        assert_eq!(fault(&blocks), Some("memory.blocks"), "{name}");
        let cells = Content { cells: &content.cells[..content.manifest.cells() - 1], ..content };
        assert_eq!(fault(&cells), Some("memory.cells"), "{name}");
    }
}
