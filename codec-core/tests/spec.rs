//! `SPEC.md` against the code: its tables are read here and compared with constants, with the
//! bytes the code writes, and with what it refuses. A wrong number in a table fails; the last test
//! shows that it does.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

#[path = "spec/coding.rs"]
mod coding;
#[path = "spec/errors.rs"]
mod errors;
#[path = "spec/listing.rs"]
mod listing;
#[path = "spec/manifest.rs"]
mod manifest;
#[path = "spec/packets.rs"]
mod packets;
#[path = "spec/refused.rs"]
mod refused;
#[allow(dead_code, reason = "the tests of golden streams use the rest")]
#[path = "conformance/session.rs"]
mod session;
#[path = "spec/tables.rs"]
mod tables;

use codec_core::internals::{
    ids::{EpochId, Level, Span},
    wire::packet::{Extent, Packet},
};

use tables::{Tables, tables, text};

/// Everything in which the tables and the code differ.
fn differences(tables: &Tables) -> Vec<String> {
    let checks = [
        manifest::limits_of,
        manifest::records,
        manifest::ranges,
        manifest::sealed,
        manifest::sections,
        packets::packets,
        packets::parity,
        packets::receipt,
        packets::dgs,
        coding::classes,
        coding::coding,
        coding::lane_body,
        coding::floats,
        errors::errors,
        listing::differences,
    ];
    let mut found = Vec::new();
    for check in checks {
        check(tables, &mut found);
    }
    found
}

#[test]
fn tables_and_code_agree() {
    let found = differences(&tables(&text()));
    assert!(found.is_empty(), "{} differences:\n{}", found.len(), found.join("\n"));
}

#[test]
fn the_example_packet_is_what_it_says() {
    let text = text();
    let line = text.lines().find(|l| l.starts_with("    a2 ")).unwrap();
    let bytes: Vec<u8> = line.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect();
    let Ok(Packet::Slices(packet)) = Packet::parse(&bytes) else { panic!("slices") };
    let extent = Extent { span: Span::Canonical(EpochId(0)), level: Level::ALL[2], first: 300, blocks: 4 };
    assert_eq!(packet.extents.as_slice(), [extent]);
    assert_eq!((packet.id.get(), packet.body), (0x01_02_03, &[0xaa, 0xbb][..]));
}

/// Each of these is wrong in one place, and is found there.
#[test]
fn a_wrong_table_is_found() {
    let text = text();
    for (right, wrong, named) in [
        ("| MAX_EXTENTS | 16 |", "| MAX_EXTENTS | 17 |", "MAX_EXTENTS"),
        ("| 16 | 4 | packets | u32 |", "| 20 | 4 | packets | u32 |", "head.packets"),
        ("| 2 | 2 | frames | u16 | 1..=64,", "| 2 | 4 | frames | u16 | 1..=64,", "window.frames"),
        ("| 1 | 1 | sh_degree | u8 | 0..=3 |", "| 1 | 1 | sh_degree | u8 | 0..=4 |", "manifest.sh_degree"),
        ("| track_shift | u8 | 0..=24 |", "| track_shift | u8 | 0..=23 |", "motion.track_shift"),
        ("| 8 | 4 | raw_len |", "| 8 | 2 | raw_len |", "sealed.raw_len"),
        (
            "| 12 | 2 | payload_len | u16 | 1..=1200 |",
            "| 12 | 2 | payload_len | u16 | 1..=1201 |",
            "chunk.payload_len",
        ),
        ("| 2 | 1 | motion |", "| 3 | 1 | motion |", "extent flag motion"),
        ("| Sh2 | 6 | 15 | 2 |", "| Sh2 | 6 | 15 | 1 |", "class"),
        ("| track | 40 | 12 |", "| track | 40 | 11 |", "track stream"),
        ("| 1 | 3R + 11F + H |", "| 1 | 3R + 10F + H |", "paper level 1"),
        ("| 3 | 2 | escape |", "| 4 | 2 | escape |", "table.escape"),
        ("1.6666667e-1", "1.6666666e-1", "exp("),
        ("-1.388888888888889e-3", "-1.388898888888889e-3", "cospi("),
        ("| 2 | 8 | playout_us |", "| 2 | 4 | playout_us |", "receipt.playout_us"),
        ("| 9 | 4 | index_len |", "| 9 | 2 | index_len |", "file.index_len"),
        ("| 1 | 0x", "| 2 | 0x", "coefficient(2, "),
        ("| checksum | 3 |", "| checksum | 4 |", "checksum"),
        ("| manifest.magic manifest.version", "| manifest.version", "manifest.magic"),
        (
            "| packet.crc receipt.crc file.index_crc | checksum |",
            "| packet.crc receipt.crc file.index_crc | illegal |",
            "packet.crc is checksum",
        ),
        ("cluster.radius | illegal |", "cluster.radius | unknown |", "cluster.radius is illegal"),
        ("| parity | 0b110 |", "| parity | 0b111 |", "kind parity"),
        ("| 296 | 05 db 8a a0 |", "| 296 | 05 db 8b a0 |", "one.dgs at 296"),
        ("| 366 | 00 00 | end of the packets |", "", "one.dgs row 362 ends"),
        ("| 628 | 01 00 00", "| 628 | 01 01 00", "one.dgs body at 628"),
        ("| 1356 | 80 88 80 21", "| 1356 | 80 88", "one.dgs body: first byte"),
    ] {
        assert!(text.contains(right), "{right}");
        let found = differences(&tables(&text.replacen(right, wrong, 1)));
        assert!(found.iter().any(|f| f.contains(named)), "{wrong}: {found:?}");
    }
    let lines: Vec<&str> = text.lines().collect();
    let at = lines.iter().position(|l| l.starts_with("| quants | quants |")).unwrap();
    let mut swapped = lines.clone();
    swapped.swap(at, at - 1);
    let found = differences(&tables(&swapped.join("\n")));
    assert!(found.iter().any(|f| f.contains("sections")), "{found:?}");
}
