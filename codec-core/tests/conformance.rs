//! Golden streams: what every decoder of this format must make of them. `conformance/index.txt` has
//! one line each; `conformance/README.md` says how they are written anew.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

#[path = "conformance/session.rs"]
mod session;

use std::{collections::BTreeSet, path::Path};

use codec_core::{
    ErrorKind,
    internals::wire::{
        crc::{checked, crc32},
        file,
        manifest::{Repair, seal},
        packet::Packet,
    },
};

use session::{Line, Session, parts, unpacked};

/// Name, what it exercises, the file, its line.
fn golden() -> Vec<(String, String, Vec<u8>, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance");
    let index = std::fs::read_to_string(folder.join("index.txt")).unwrap();
    let read = |line: &str| {
        let mut cells = line.split(" | ");
        let (name, exercises) = (cells.next().unwrap(), cells.next().unwrap());
        let bytes = std::fs::read(folder.join(format!("{name}.dgs"))).unwrap();
        (name.to_owned(), exercises.to_owned(), bytes, line.to_owned())
    };
    index.lines().map(read).collect()
}

/// Numbers below `n` in another order.
fn shuffled(n: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    let mut x = seed | 1;
    for i in (1..n).rev() {
        x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        order.swap(i, (x >> 33) as usize % (i + 1));
    }
    order
}

#[test]
fn every_stream_and_every_checkpoint_is_as_its_line_says() {
    let all = golden();
    assert!(all.len() >= 18);
    for (name, exercises, bytes, line) in &all {
        assert_eq!(&Line::of(name, exercises, bytes).text(), line);
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance");
    let files = std::fs::read_dir(folder).unwrap().filter(|entry| {
        entry.as_ref().unwrap().path().extension().is_some_and(|extension| extension == "dgs")
    });
    assert_eq!(files.count(), all.len(), "every file has its line");
    assert!(all.iter().map(|g| g.2.len()).sum::<usize>() < 400_000, "the set stays small");
}

#[test]
fn more_bytes_are_never_worse() {
    for (name, exercises, bytes, _) in golden() {
        let line = Line::of(&name, &exercises, &bytes);
        let usable = line.checkpoints.map(|c| c.0);
        assert!(usable.is_sorted(), "{name}: {usable:?}");
        assert_ne!(line.checkpoints[0].1, line.digest, "{name}: the digest sees what is missing");
    }
}

/// A file that grows byte by byte shows each packet as soon as it is whole, and nothing else.
#[test]
fn byte_by_byte() {
    for (name, _, bytes, _) in golden() {
        let (_, start) = file::manifest(&bytes).unwrap();
        let ends: Vec<usize> = file::packets(&bytes, start, crc32)
            .filter_map(|r| match r {
                file::Record::Packet(offset, packet) => Some(offset + packet.bytes().len()),
                _ => None,
            })
            .collect();
        let (_, all) = parts(&bytes);
        let step = if bytes.len() < 3000 { 1 } else { bytes.len() / 61 };
        for len in (0..bytes.len()).step_by(step) {
            let (message, packets) = parts(&bytes[..len]);
            assert_eq!(message.is_empty(), len < start, "{name} at {len}");
            let whole = ends.iter().filter(|&&end| end <= len).count();
            // The parity of a set of one is a copy of it, which is found where that record is cut.
            let shown: BTreeSet<&[u8]> = packets.into_iter().collect();
            let whole = if len < start { 0 } else { whole };
            assert_eq!(shown, all[..whole].iter().copied().collect(), "{name} at {len}");
        }
    }
}

#[test]
fn order_and_repeats_do_not_matter() {
    for (name, _, bytes, _) in golden() {
        let (message, packets) = parts(&bytes);
        let whole = Session::open(message).after(&packets);
        assert_eq!(whole.counters.refused, [0; ErrorKind::COUNT], "{name}");
        for seed in 0..3 {
            let some: Vec<&[u8]> = shuffled(packets.len(), seed).into_iter().map(|i| packets[i]).collect();
            let after = Session::open(message).after(&some);
            assert_eq!(after.digest(), whole.digest(), "{name}, order {seed}");
            assert!(after.symbols == whole.symbols, "{name}, order {seed}");
        }
        let twice: Vec<&[u8]> = packets.iter().flat_map(|&p| [p, p]).collect();
        let after = Session::open(message).after(&twice);
        assert_eq!(after.digest(), whole.digest(), "{name}");
        let duplicates = after.counters.refused[ErrorKind::Duplicate.index()];
        assert_eq!(duplicates as usize, packets.len(), "{name}");
    }
}

/// Whoever takes no values from what was lost keeps every bit.
#[test]
fn a_loss_changes_only_its_own_gaussians() {
    for (name, _, bytes, _) in golden() {
        let (message, packets) = parts(&bytes);
        let whole = Session::open(message).after(&packets);
        let (masks, frames) = (&whole.masks, &whole.frames);
        let epochs: Vec<_> = Session::open(message).manifest().epochs().collect();
        let media: Vec<&[u8]> = packets.iter().copied().filter(|p| p[0] >> 5 != 6).collect();
        let mut changes = 0;
        for lost in 0..media.len().min(40) {
            let lost = lost * media.len() / media.len().min(40);
            let rest: Vec<&[u8]> =
                media.iter().enumerate().filter(|(i, _)| *i != lost).map(|(_, p)| *p).collect();
            let after = Session::open(message).after(&rest);
            let (lossy_masks, lossy_frames) = (&after.masks, &after.frames);
            assert_ne!(after.state, whole.state, "{name}: packet {lost} brings something");
            for (e, epoch) in epochs.iter().enumerate() {
                let own = epoch.first_frame as usize..(epoch.first_frame + epoch.frames) as usize;
                for (a, b) in frames[own.clone()].iter().zip(&lossy_frames[own]) {
                    let rest = a.1.len() / a.0.len().max(1);
                    for i in 0..a.0.len() {
                        let same = a.0[i] == b.0[i]
                            && a.1[i * rest..(i + 1) * rest] == b.1[i * rest..(i + 1) * rest];
                        assert!(
                            same || masks[e][i] != lossy_masks[e][i],
                            "{name}: packet {lost}, Gaussian {i}"
                        );
                        changes += usize::from(!same);
                    }
                }
            }
        }
        assert!(changes > 0, "{name}: losses are seen");
    }
}

/// Every repair set loses as many packets as it has parity, in several patterns, and nothing is
/// missed; one more is lost for good.
#[test]
fn as_many_losses_as_parity_are_repaired() {
    let mut ranges = 0;
    for (name, _, bytes, _) in golden() {
        let (message, packets) = parts(&bytes);
        let session = Session::open(message);
        let repairs: Vec<Repair> = session.manifest().repairs().collect();
        let whole = session.after(&packets);
        for pattern in 0..3u32 {
            for extra in [0, 1] {
                let mut lost = vec![false; packets.len()];
                let (mut some, mut gone) = (0, 0);
                for repair in &repairs {
                    for set in 0..repair.sets() {
                        let members = repair.members(set);
                        let count = (u32::from(repair.parity) + extra).min(members);
                        (0..count).for_each(|i| {
                            lost[repair.member(set, (i * (pattern + 1) + pattern) % members) as usize] = true;
                        });
                        let missing = (0..members).filter(|&p| lost[repair.member(set, p) as usize]).count();
                        some += missing;
                        gone += usize::from(missing > usize::from(repair.parity));
                    }
                }
                ranges += repairs.len();
                let rest: Vec<&[u8]> = shuffled(packets.len(), pattern.into())
                    .into_iter()
                    .filter(|&i| !lost[i])
                    .map(|i| packets[i])
                    .collect();
                let after = Session::open(message).after(&rest);
                assert_eq!(after.counters.repair_failed, 0, "{name}");
                if gone == 0 {
                    assert_eq!(after.digest(), whole.digest(), "{name}, pattern {pattern}");
                    assert_eq!(after.counters.recovered as usize, some, "{name}, pattern {pattern}");
                } else {
                    assert_ne!(after.digest(), whole.digest(), "{name}, pattern {pattern}");
                }
            }
        }
    }
    assert!(ranges > 0, "some streams have parity");
}

/// What is parsed is written as it was: packets, manifest, file.
#[test]
fn written_again_it_is_the_same_bytes() {
    for (name, _, bytes, _) in golden() {
        let (message, packets) = parts(&bytes);
        let raw = unpacked(message);
        let mut again = vec![0u8; message.len()];
        assert_eq!(seal(&raw, &mut again), Ok(message.len()), "{name}");
        assert_eq!(again, message, "{name}");
        let mut out = Vec::new();
        let mut index = file::Index::begin(&again, |b| out.extend_from_slice(b));
        let mut entries = Vec::new();
        for packet in packets {
            let mut again = vec![0u8; packet.len()];
            let written = match Packet::parse(checked("packet.crc", packet, crc32).unwrap()).unwrap() {
                Packet::Chunk(p) => p.write(&mut again),
                Packet::Slices(p) => p.write(&mut again),
                Packet::Parity(p) => p.write(&mut again),
            };
            assert_eq!(written, Ok(packet.len()), "{name}");
            assert_eq!(again, packet, "{name}");
            entries.push(index.packet(&again, |b| out.extend_from_slice(b)).unwrap());
        }
        index.end(&entries, |b| out.extend_from_slice(b));
        assert_eq!(out, bytes, "{name}");
    }
}
