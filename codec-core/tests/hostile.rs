//! Small files that claim much: each is refused by a cap that names field, found and allowed, or decodes
//! within the caps. `hostile/README.md` lists them and is the input of these tests.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use codec_core::{
    Caps, Error, ErrorKind, Result,
    internals::{
        ids::{EpochId, Level, PacketId, Span, WindowId},
        quant::Quantiser,
        receiver::{Receiver, for_each_cell},
        wire::{
            crc::crc32,
            file::{self, Missing, Record},
            manifest::{self, Cluster, Epoch, Head, Manifest, ManifestHead, Motion, Repair, Track, Window},
            packet::{Chunk, Extent, Packet, Parity, Slices},
        },
    },
    player::{Counters, Player, Waiting},
};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hostile")
}

/// A line of the table: file, and what the refusal says; nothing for a file that is not refused.
fn attacks() -> Vec<(String, Vec<String>)> {
    let text = std::fs::read_to_string(folder().join("README.md")).unwrap();
    let rows = text.lines().filter(|line| line.starts_with("| `"));
    let attack = |line: &str| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [file, _, says] = cells[..] else { panic!("three cells: {line}") };
        let says = says.split('`').skip(1).step_by(2).map(str::to_owned).collect();
        (file.trim_matches('`').to_owned(), says)
    };
    rows.map(attack).collect()
}

/// Caps of a player that is given its manifest first.
fn without_early(caps: &Caps) -> Caps {
    Caps { early_bytes: 0, ..*caps }
}

/// An arena of the length that the stream of `message` needs, which is within what `caps` say of all.
fn arena(message: &[u8], caps: &Caps) -> Result<Vec<u64>> {
    let caps = without_early(caps);
    let raw_len = ManifestHead::parse(message)?.within(&caps)?.raw_len;
    let need = Waiting::new(&mut vec![0; raw_len.div_ceil(8)], caps)?.required(message)?;
    assert!(need.words <= caps.arena_words(), "{} words", need.words);
    Ok(vec![0; need.words])
}

/// A player of the stream of `message` in `arena`.
fn play<'a>(arena: &'a mut [u64], message: &[u8], caps: &Caps) -> Result<Player<'a>> {
    Waiting::new(arena, without_early(caps))?.manifest(message).map_err(|(_, error)| error)
}

/// Receives the whole of `bytes` and decodes its first frame, with no more memory than `caps` allow.
/// The first refusal, of the manifest or of a packet, ends it.
fn receive(bytes: &[u8], caps: &Caps) -> Result<Counters> {
    let (message, packets) = file::parts(bytes)?;
    let mut arena = arena(message, caps)?;
    let mut player = play(&mut arena, message, caps)?;
    for packet in packets {
        player.push(packet)?;
    }
    player.frame(0)?;
    Ok(*player.counters())
}

#[test]
fn the_table_and_the_folder_agree() {
    let listed: BTreeSet<String> = attacks().into_iter().map(|attack| attack.0).collect();
    let there: BTreeSet<String> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name != "README.md")
        .collect();
    assert_eq!(listed, there);
    assert!(listed.len() >= 9);
}

#[test]
fn claims_are_refused_by_caps() {
    for (file, says) in attacks() {
        let bytes = std::fs::read(folder().join(&file)).unwrap();
        match receive(&bytes, &Caps::HOST) {
            Ok(counters) => {
                assert!(says.is_empty(), "{file} is not refused");
                assert_eq!(counters.refused, [0; ErrorKind::COUNT], "{file}");
            }
            Err(error) => {
                assert_eq!(error.kind, ErrorKind::Capacity, "{file}: {error}");
                let text = error.to_string();
                assert!(!says.is_empty(), "{file}: {text}");
                for part in says {
                    assert!(text.contains(&part), "{file}: {text:?} does not say {part:?}");
                }
            }
        }
    }
}

/// A lower cap refuses what a higher one takes on, naming itself.
#[test]
fn each_cap_refuses_what_exceeds_it() {
    let bytes = std::fs::read(folder().join("ok.dgs")).unwrap();
    receive(&bytes, &Caps::HOST).unwrap();
    let none = Caps { symbols: 0, ..Caps::HOST };
    let refused = |caps: Caps, field: &str| {
        let error: Error = receive(&bytes, &caps).unwrap_err();
        assert_eq!((error.field, error.kind), (field, ErrorKind::Capacity), "{error}");
        assert!(error.found > error.allowed.1, "{error}");
    };
    refused(none, "manifest.symbols");
    refused(Caps { blocks: 0, ..Caps::HOST }, "manifest.blocks");
    refused(Caps { cells: 0, ..Caps::HOST }, "manifest.cells");
    refused(Caps { packets: 0, ..Caps::HOST }, "manifest.packets");
    refused(Caps { frames: 0, ..Caps::HOST }, "manifest.frames");
    refused(Caps { tables: 0, ..Caps::HOST }, "manifest.tables");
    refused(Caps { manifest_bytes: 9, ..Caps::HOST }, "manifest.raw_len");
    refused(Caps { gaussians_per_epoch: 1, ..Caps::HOST }, "epoch.gaussians");
    refused(Caps { blocks_per_packet: 2, ..Caps::HOST }, "packet.blocks");
    refused(Caps { values_per_packet: 3, ..Caps::HOST }, "packet.values");
}

/// A packet of 22 bytes that claims 27 million values once took 160 ms to refuse, as often as it was
/// sent.
#[test]
#[expect(clippy::disallowed_methods, reason = "how long it takes is what is tested")]
fn a_refusal_costs_little_however_often() {
    let bytes = std::fs::read(folder().join("refused.dgs")).unwrap();
    let (message, start) = file::manifest(&bytes).unwrap();
    let packet = file::packets(&bytes, start, crc32).find_map(|record| match record {
        Record::Packet(_, packet) => Some(packet),
        _ => None,
    });
    let packet = packet.unwrap();
    let mut arena = arena(message, &Caps::HOST).unwrap();
    let mut player = play(&mut arena, message, &Caps::HOST).unwrap();
    let receiver = player.receiver();
    let began = Instant::now();
    for _ in 0..500 {
        let error = receiver.push(&packet).unwrap_err();
        assert_eq!((error.field, error.kind), ("packet.values", ErrorKind::Capacity));
    }
    assert!(began.elapsed() < Duration::from_secs(5), "{:?}", began.elapsed());
    assert_eq!(receiver.counters().refused[ErrorKind::Capacity.index()], 500);
}

/// Calls `change` with the manifest body of a conformance stream.
fn body_of<T>(name: &str, change: impl FnOnce(&[u8], &Manifest<'_>) -> T) -> T {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance").join(name);
    let bytes = std::fs::read(path).unwrap();
    let (message, _) = file::manifest(&bytes).unwrap();
    let mut raw = vec![0; ManifestHead::parse(message).unwrap().raw_len];
    manifest::open(message, crc32, &mut raw).unwrap();
    change(&raw, &Manifest::parse(&raw).unwrap())
}

/// A packet belongs to one set: ranges that overlap are refused where the second begins.
#[test]
fn overlapping_repair_ranges_are_refused() {
    let place = |body: &[u8], repair: &manifest::Repair| {
        let record = repair.to_bytes();
        body.windows(record.len()).position(|bytes| bytes == record).unwrap()
    };
    let mut tried = 0;
    for name in ["everything.dgs", "cauchy.dgs", "xor.dgs", "cauchy-eight.dgs"] {
        body_of(name, |body, manifest| {
            let ranges: Vec<manifest::Repair> = manifest.repairs().collect();
            let [first, second, ..] = ranges[..] else { return };
            let at = place(body, &second);
            for (field, offset, value, least) in [
                ("repair.first_packet", 0, first.first_packet, first.first_packet + first.packets),
                (
                    "repair.first_parity",
                    8,
                    first.first_parity,
                    first.first_parity + first.parity_packets() as u32,
                ),
            ] {
                let mut body = body.to_vec();
                body[at + offset..at + offset + 4].copy_from_slice(&value.to_le_bytes());
                let error = Manifest::parse(&body).unwrap_err();
                assert_eq!((error.field, error.found, error.allowed.0), (field, value.into(), least.into()));
                tried += 1;
            }
        });
    }
    assert!(tried >= 2);
}

/// What a broken record says is what stands in its field.
#[test]
fn errors_show_the_field_itself() {
    let quant = |body: &[u8], manifest: &Manifest<'_>| {
        let mut record = Vec::new();
        manifest.quant(0).unwrap().write(|bytes| record.extend_from_slice(bytes));
        body.windows(record.len()).position(|bytes| bytes == record).unwrap()
    };
    body_of("still.dgs", |body, manifest| {
        let at = quant(body, manifest);
        let error = |offset: usize, value: u8| {
            let mut body = body.to_vec();
            body[at + offset] = value;
            let error = Manifest::parse(&body).unwrap_err();
            (error.field, error.found, error.allowed)
        };
        assert_eq!(error(4, 2), ("quantiser.ratio", 2, (1, 1)));
        assert_eq!(error(5, 4), ("quantiser.ratio", 4, (3, 3)));
        assert_eq!(error(7, 3), ("quantiser.flags", 3, (0, 1)));
        // The sign bit of the step: less than nothing.
        assert_eq!(error(3, 0xc0), ("quantiser.step_billionths", 0, (1, 1_000_000_000_000_000_000)));
    });
    for (step, is_small) in [(7e-10, true), (-1.0, true), (f32::NAN, true), (1_000_000_064.0, false)] {
        let error = Quantiser::new(step, [3; 3], false).unwrap_err();
        let is_outside = if is_small { error.found < error.allowed.0 } else { error.found > error.allowed.1 };
        assert!(is_outside, "{step}: {error}");
    }
    body_of("still.dgs", |body, _| {
        let drawing = |value: u8| {
            let mut body = body.to_vec();
            body[35] = value;
            Manifest::parse(&body).map(|_| ()).map_err(|error| (error.field, error.found, error.allowed))
        };
        assert_eq!(drawing(0x52), Ok(()));
        assert_eq!(drawing(0x03), Err(("manifest.footprint", 3, (0, 2))));
        assert_eq!(drawing(0x60), Err(("manifest.up", 6, (0, 5))));
    });
}

/// An extent that does not fit is named with the byte at which it starts, and what would fit.
#[test]
fn errors_of_extents_show_where_they_start() {
    let refused = |name: &str, extents: &[Extent]| {
        body_of(name, |body, _| {
            let packet = Slices {
                id: PacketId::default(),
                extents: extents.iter().copied().collect(),
                body: &[0; 99],
            };
            let mut out = [0; 1280];
            let len = packet.write(&mut out).unwrap();
            let message = sealed(body);
            let mut arena = arena(&message, &Caps::HOST).unwrap();
            let mut player = play(&mut arena, &message, &Caps::HOST).unwrap();
            let error = player.push(&out[..len]).unwrap_err();
            (error.field, error.offset, error.found, error.allowed)
        })
    };
    let extent = |span, level: u8, first| Extent { span, level: Level::from_bits(level), first, blocks: 1 };
    let base = extent(Span::Canonical(EpochId(0)), 0, 0);
    let epoch = |id| extent(Span::Canonical(EpochId(id)), 0, 0);
    let window = |id| extent(Span::Motion(WindowId(id)), 0, 0);
    // Flags, id, span, first and blocks of the first extent take a byte each.
    assert_eq!(refused("still.dgs", &[epoch(1)]), ("extent.span", 0, 1, (0, 0)));
    assert_eq!(refused("still.dgs", &[base, epoch(9)]), ("extent.span", 5, 9, (0, 0)));
    assert_eq!(refused("still.dgs", &[base, window(0)]), ("extent.motion", 5, 1, (0, 0)));
    let (field, offset, found, allowed) = refused("tracks.dgs", &[base, window(9999)]);
    assert_eq!((field, offset, found, allowed.0), ("extent.span", 5, 9999, 0));
    assert!(allowed.1 < found, "{allowed:?}");
    assert_eq!(refused("still.dgs", &[base, base]), ("slice", 5, 0, (0, 0)));
    let (field, offset, found, allowed) = refused("still.dgs", &[base, extent(base.span, 1, 99_999)]);
    assert_eq!((field, offset, found, allowed.0), ("extent.first", 5, 99_999, 0));
    // The only cluster of the stream without its coefficients has nothing at level 3.
    let nothing = extent(window(0).span, 3, 0);
    assert_eq!(refused("made-levels-left-out.dgs", &[nothing]), ("extent.symbols", 0, 0, (1, 1 << 18)));
}

/// The DGSM message of an unpacked body.
fn sealed(body: &[u8]) -> Vec<u8> {
    let mut message = vec![0; 2 * body.len() + 4096];
    let len = manifest::seal(body, &mut message).unwrap();
    message.truncate(len);
    message
}

/// A parity packet that is refused costs a bisection of the repair ranges, however many there are: a walk
/// over 65,535 of them took 0.45 ms, again for every copy of 11 bytes.
#[test]
#[expect(clippy::disallowed_methods, reason = "how long it takes is what is tested")]
fn a_refused_parity_packet_walks_over_no_repair_ranges() {
    const RANGES: u32 = 65_535;
    let repair = |i| Repair {
        first_packet: 10 + i,
        packets: 1,
        first_parity: 100_000 + i,
        set_len: 2,
        parity: 1,
        longest: 16,
    };
    body_of("one.dgs", |body, manifest| {
        let head = Head { packets: 1 << 20, repairs: RANGES as u16, ..*manifest.head() };
        // Head, an epoch, a cluster, a quantisation profile, table sets; then the repair ranges.
        let at = Head::BYTES + Epoch::BYTES + Cluster::BYTES + manifest::Quant::BYTES + 87 * 13;
        let ranges: Vec<u8> = (0..RANGES).flat_map(|i| repair(i).to_bytes()).collect();
        let body = [&head.to_bytes()[..], &body[Head::BYTES..at], &ranges, &body[at..]].concat();
        let message = sealed(&body);
        let mut arena = arena(&message, &Caps::HOST).unwrap();
        let mut player = play(&mut arena, &message, &Caps::HOST).unwrap();
        let packet = |id, content: &[u8]| {
            let mut out = vec![0; 64];
            let parity = Parity { id: PacketId::new(id).unwrap(), length: 5, content };
            let len = parity.write(&mut out).unwrap();
            out.truncate(len);
            out
        };
        let last = 100_000 + RANGES - 1;
        let began = Instant::now();
        for (packet, field) in [
            (packet(99_999, &[1]), "packet.kind"),
            (packet(last + 1, &[1]), "parity.id"),
            (packet(last, &[1; 17]), "parity.content"),
        ] {
            for _ in 0..5000 {
                let error = player.push(&packet).unwrap_err();
                assert_eq!((error.field, error.kind), (field, ErrorKind::Contradiction));
            }
        }
        assert!(began.elapsed() < Duration::from_secs(2), "{:?}", began.elapsed());
        // The ranges are found all the same.
        for id in [100_000, 100_001, last - 1, last] {
            player.push(&packet(id, &[1])).unwrap();
        }
        assert_eq!(player.counters().parity, 4);
    });
}

/// Where a cluster's track is missing, the windows before are looked through for one that is there, frame
/// after frame: a window passed over must cost far less than the shape of its cell.
#[test]
#[expect(clippy::disallowed_methods, reason = "how long it takes is what is tested")]
fn a_window_without_a_track_is_soon_passed_over() {
    const WINDOWS: u16 = 1000;
    const CLUSTERS: u32 = 100;
    body_of("one.dgs", |body, manifest| {
        let head = Head {
            frames: WINDOWS.into(),
            windows: WINDOWS,
            clusters: CLUSTERS,
            proxies: 0,
            ..*manifest.head()
        };
        let epoch = Epoch {
            frames: WINDOWS.into(),
            gaussians: CLUSTERS,
            clusters: CLUSTERS,
            windows: WINDOWS.into(),
            ..manifest.epochs().next().unwrap()
        };
        let window =
            |w: u32| Window { frames: 1, first_frame: w, first_cell: w * CLUSTERS, ..Window::default() };
        let windows: Vec<u8> = (0..WINDOWS.into()).flat_map(|w| window(w).to_bytes()).collect();
        let (clusters, rest) = body[Head::BYTES + Epoch::BYTES..].split_at(Cluster::BYTES);
        let motion = Motion { kind: Track::Rigid as u8, track: 1, ..Motion::default() }.to_bytes();
        let proxies = 13;
        let tables = rest.len() - 2 * usize::from(head.tables) - proxies;
        let body = [
            &head.to_bytes()[..],
            &epoch.to_bytes(),
            &windows[..],
            &clusters.repeat(CLUSTERS as usize),
            &motion.repeat(usize::from(WINDOWS) * CLUSTERS as usize),
            &rest[..tables],
            &rest[tables + proxies..],
        ]
        .concat();
        let message = sealed(&body);
        let mut arena = arena(&message, &Caps::HOST).unwrap();
        let mut player = play(&mut arena, &message, &Caps::HOST).unwrap();
        let manifest = Manifest::parse(&body).unwrap();
        let least = |work: &mut dyn FnMut()| {
            let times = (0..5).map(|_| {
                let began = Instant::now();
                work();
                began.elapsed()
            });
            times.min().unwrap()
        };
        let frame = least(&mut || assert!(player.frame(u32::from(WINDOWS) - 1).is_ok()));
        let mut cells = 0;
        let shapes = least(&mut || {
            for_each_cell(&manifest, |_, _, shape| {
                cells += shape.blocks();
                Ok(())
            })
            .unwrap();
        });
        assert!(cells > 0 && frame * 2 < shapes, "{frame:?} a frame, {shapes:?} for the shapes of all cells");
    });
}

/// Chunks that overlap bring no symbol twice, so that a group with a hole never counts as whole.
#[test]
fn overlapping_chunks_leave_their_group_incomplete() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance/paper.dgs");
    let bytes = std::fs::read(path).unwrap();
    let (message, start) = file::manifest(&bytes).unwrap();
    let packets: Vec<_> = file::packets(&bytes, start, crc32)
        .filter_map(|record| if let Record::Packet(_, packet) = record { Some(packet) } else { None })
        .collect();
    // The second chunk of a group, moved back over the first.
    let chunk = packets.iter().find_map(|packet| match packet.packet() {
        Packet::Chunk(chunk) if chunk.first_symbol > 0 => Some(chunk.clone()),
        _ => None,
    });
    let honest = chunk.unwrap();
    let forged = Chunk { first_symbol: honest.first_symbol - 100, ..honest.clone() };
    let mut out = [0; 1280];
    let len = forged.write(&mut out).unwrap();
    let mut arena = arena(message, &Caps::HOST).unwrap();
    let mut player = play(&mut arena, message, &Caps::HOST).unwrap();
    let receiver = player.receiver();
    for packet in &packets {
        let whole = |receiver: &Receiver<'_>| receiver.content().blocks.to_vec();
        if packet.id() == honest.id {
            let before = whole(receiver);
            let error = receiver.media(&out[..len]).unwrap_err();
            let wanted = ("chunk.first_symbol", ErrorKind::Duplicate, u64::from(forged.first_symbol));
            assert_eq!((error.field, error.kind, error.found), wanted);
            assert_eq!(whole(receiver), before);
        }
        receiver.push(packet).unwrap();
    }
    assert!(receiver.content().blocks.iter().all(|&mask| mask == 0b1111), "the honest ones do");
}

/// Which of the packets that are not there repair gives back, and which are lost.
#[test]
fn missing_packets_are_lost_or_repairable() {
    body_of("xor.dgs", |_, manifest| {
        let repair = manifest.repairs().next().unwrap();
        let [first, second] = [0, 1].map(|at| repair.member(0, at));
        let parity = repair.parity_id(0, 0);
        let missing = |ids: &[u32]| file::missing(manifest, |id| !ids.contains(&id));
        assert_eq!(missing(&[]), Missing::default());
        assert_eq!(missing(&[first]), Missing { lost: 0, repairable: 1 });
        assert_eq!(missing(&[parity]), Missing { lost: 1, repairable: 0 });
        assert_eq!(missing(&[first, second]), Missing { lost: 2, repairable: 0 });
        assert_eq!(missing(&[first, parity]), Missing { lost: 2, repairable: 0 });
    });
}
