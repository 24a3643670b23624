//! Tests every reader on damaged bytes: it errs or it returns a valid scene; it never panics and never holds
//! much more than its limits. Also writes the small damaged files that `tests/import_damaged.rs` reads.

use std::{io::Write, sync::LazyLock};

use proptest::prelude::*;

use super::*;

/// Bytes a reader takes, and the reader.
struct Case {
    seed: Vec<u8>,
    read: fn(&[u8], &Limits) -> Result<usize, ImportError>,
}

static CASES: LazyLock<Vec<Case>> = LazyLock::new(cases);
static SOG: LazyLock<Vec<(&str, Vec<u8>)>> = LazyLock::new(sog::tests::files);
static UNITY: LazyLock<unity::tests::Sample> = LazyLock::new(|| unity::tests::sample(20));

fn cases() -> Vec<Case> {
    fn count(snapshot: Result<Snapshot, ImportError>) -> Result<usize, ImportError> {
        snapshot.map(|s| s.epoch.count())
    }
    let case = |seed, read| Case { seed, read };
    vec![
        case(ply::tests::sample("binary_little_endian", 9, 20), |b, l| count(ply::parse(b, l))),
        case(ply::tests::sample("ascii", 0, 5), |b, l| count(ply::parse(b, l))),
        case(compressed_ply::tests::sample(300), |b, l| count(compressed_ply::parse(b, l))),
        case(splat::tests::sample(10), |b, l| count(splat::parse(b, l))),
        case(spz::tests::sample(3), |b, l| count(spz::parse(b, l))),
        case(spz_4(), |b, l| count(spz::parse(b, l))),
        // Damage before compression, which a checksum would otherwise hide.
        case(unpacked(&spz::tests::sample(3)), |b, l| count(spz::parse(&gzip(b), l))),
        case(unpacked(&spz::tests::sample(1)), |b, l| count(spz::parse(&gzip(b), l))),
        case(sog::tests::sample(), |b, l| count(sog::parse(b, l))),
        case(points_npz::tests::sample(), |b, l| points_npz::parse(b, 30.0, l).map(|s| s.max_count())),
        case(gltf::tests::sample(), |b, l| {
            let beside = |name: &str| Err(Format::Gltf.malformed("uri", name, "nothing beside"));
            let options = gltf::GltfOptions { samples: 60, ..gltf::GltfOptions::default() };
            gltf::parse(b, beside, &options, l).map(|s| s.max_count())
        }),
        case(UNITY.description.clone().into_bytes(), |b, l| {
            count(unity::parse(&unity::Asset { description: b, ..UNITY.asset() }, l))
        }),
        case(UNITY.planes[0].clone(), |b, l| {
            count(unity::parse(&unity::Asset { chunks: b, ..UNITY.asset() }, l))
        }),
        case(UNITY.planes[2].clone(), |b, l| {
            count(unity::parse(&unity::Asset { others: b, ..UNITY.asset() }, l))
        }),
        case(sog_file("meta.json"), |b, l| count(sog_with("meta.json", b, l))),
        case(sog_file("l.webp"), |b, l| count(sog_with("l.webp", b, l))),
        case(sog_file("p.webp"), |b, l| count(sog_with("p.webp", b, l))),
        case(points_npz::tests::files()[0].1.clone(), |b, l| {
            let mut files = points_npz::tests::files();
            files[0].1 = b.to_vec();
            points_npz::parse(&points_npz::tests::zipped(&files), 30.0, l).map(|s| s.max_count())
        }),
    ]
}

fn sog_file(name: &str) -> Vec<u8> {
    SOG.iter().find(|f| f.0 == name).unwrap().1.clone()
}

/// A SOG with one of its files replaced, past the checksums of a zip.
fn sog_with(name: &str, bytes: &[u8], limits: &Limits) -> Result<Snapshot, ImportError> {
    let file = |wanted: &str| if wanted == name { bytes.to_vec() } else { sog_file(wanted) };
    let known = |wanted: &str| {
        let error = || Format::Sog.malformed("file", wanted, "a known name");
        SOG.iter().find(|f| f.0 == wanted).map(|_| file(wanted)).ok_or_else(error)
    };
    sog::parse_files(&file("meta.json"), known, limits)
}

fn spz_4() -> Vec<u8> {
    let epoch = splat::parse(&splat::tests::sample(9), &Limits::default()).unwrap().epoch;
    let options = crate::scene::export::spz::SpzOptions {
        version: crate::scene::export::spz::Version::V4,
        fraction_bits: 12,
        antialiased: false,
    };
    crate::scene::export::spz::encode(&epoch, 0, &options).unwrap()
}

fn unpacked(gzip: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(gzip), &mut out).unwrap();
    out
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

#[derive(Clone, Debug)]
enum Damage {
    Cut(f64),
    Flip(f64, u8),
    Word(f64, u32),
    /// Another digit for the first digit after this place: damage that text formats still parse.
    Digit(f64, u8),
    Extend(Vec<u8>),
    Repeat(f64, f64),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = || 0.0..1.0f64;
    prop_oneof![
        at().prop_map(Damage::Cut),
        (at(), 1u8..).prop_map(|(at, bits)| Damage::Flip(at, bits)),
        (at(), prop_oneof![Just(0), Just(u32::MAX), Just(0x7fc0_0000), Just(i32::MAX as u32), any::<u32>()])
            .prop_map(|(at, word)| Damage::Word(at, word)),
        (at(), b'0'..=b'9').prop_map(|(at, digit)| Damage::Digit(at, digit)),
        proptest::collection::vec(any::<u8>(), 1..64).prop_map(Damage::Extend),
        (at(), at()).prop_map(|(from, to)| Damage::Repeat(from, to)),
    ]
}

fn apply(bytes: &mut Vec<u8>, damage: &Damage) {
    let place = |at: f64, bytes: &[u8]| (at * bytes.len() as f64) as usize;
    match damage {
        Damage::Cut(at) => bytes.truncate(place(*at, bytes)),
        Damage::Flip(at, bits) => {
            let at = place(*at, bytes);
            bytes.iter_mut().skip(at).take(1).for_each(|b| *b ^= bits);
        }
        Damage::Word(at, word) => {
            let at = place(*at, bytes) / 4 * 4;
            bytes.iter_mut().skip(at).zip(word.to_le_bytes()).for_each(|(b, w)| *b = w);
        }
        Damage::Digit(at, digit) => {
            let at = place(*at, bytes);
            if let Some(b) = bytes.iter_mut().skip(at).find(|b| b.is_ascii_digit()) {
                *b = *digit;
            }
        }
        Damage::Extend(more) => bytes.extend(more),
        Damage::Repeat(from, to) => {
            let (from, to) = (place(*from, bytes), place(*to, bytes));
            let part = bytes[from.min(to)..from.max(to)].to_vec();
            bytes.extend(part);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 4000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn no_reader_panics(
        which in 0usize..18,
        damages in proptest::collection::vec(damage(), 1..4),
        keep_readable in any::<bool>(),
    ) {
        let case = &CASES[which];
        let mut bytes = case.seed.clone();
        damages.iter().for_each(|d| apply(&mut bytes, d));
        let limits = Limits { max_gaussians: 50_000, max_bytes: 4 << 20, keep_readable };
        match (case.read)(&bytes, &limits) {
            Ok(count) => prop_assert!(count > 0 && count <= limits.max_gaussians),
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }

    #[test]
    fn noise_is_refused_by_all(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        for case in CASES.iter() {
            let _ = (case.read)(&bytes, &Limits::default());
        }
        let _ = sniff(&bytes, "noise".as_ref());
    }
}

#[test]
fn undamaged_seeds_are_read() {
    assert_eq!(CASES.len(), 18);
    for (i, case) in CASES.iter().enumerate() {
        assert!((case.read)(&case.seed, &Limits::default()).is_ok(), "case {i}");
    }
}

/// Writes `tests/data`. Run after changing what is damaged:
/// `cargo test -p trainer-host --lib write_damaged_files -- --ignored`.
#[test]
#[ignore = "writes the committed files"]
fn write_damaged_files() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
    let replaced = |bytes: &[u8], from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        let mut out = bytes.to_vec();
        out[at..at + to.len()].copy_from_slice(to.as_bytes());
        out
    };
    let put = |bytes: &[u8], at: usize, with: &[u8]| {
        let mut out = bytes.to_vec();
        out[at..at + with.len()].copy_from_slice(with);
        out
    };
    let cut = |bytes: &[u8], end: usize| bytes[..bytes.len() - end].to_vec();

    let good = ply::tests::sample("binary_little_endian", 0, 4);
    write("cut.ply", &cut(&good, 30));
    write("too_many.ply", &replaced(&good, "vertex 4\nproperty", "vertex 9\nproperty"));
    write("no_opacity.ply", &replaced(&good, "float opacity", "float opticty"));
    write("not_a_number.ply", &put(&good, good.len() - 4, &f32::NAN.to_le_bytes()));
    write("no_end.ply", &replaced(&good, "end_header", "end-header"));
    write("none.ply", &ply::tests::sample("binary_little_endian", 0, 0));
    write("word.ply", &replaced(&ply::tests::sample("ascii", 0, 2), "1.15", "1..5"));

    let good = compressed_ply::tests::sample(8);
    write("cut.compressed.ply", &cut(&good, 100));
    write("few_chunks.compressed.ply", &{
        let good = compressed_ply::tests::sample(258);
        let end = good.len() - 258 * 25 - 72;
        let mut out = replaced(&good, "chunk 2", "chunk 1");
        out.truncate(end + 400);
        out
    });
    write("other_sh.compressed.ply", &replaced(&good, "sh 8", "sh 7"));

    write("cut.splat", &cut(&splat::tests::sample(3), 5));
    write("negative.splat", &put(&splat::tests::sample(3), 44, &(-1f32).to_le_bytes()));
    write("empty.splat", &[]);

    let good = spz::tests::sample(3);
    write("cut.spz", &cut(&good, 12));
    write("checksum.spz", &put(&good, good.len() - 8, &[0; 4]));
    write("degree.spz", &gzip(&put(&unpacked(&good), 12, &[9])));
    write("count.spz", &gzip(&put(&unpacked(&good), 8, &1000u32.to_le_bytes())));
    write("bomb.spz", &gzip(&put(&unpacked(&good), 8, &19_000_000u32.to_le_bytes())));
    let good = spz_4();
    write("table.spz", &put(&good, 40, &90u64.to_le_bytes()));
    write("offset.spz", &put(&good, 16, &4_000_000u32.to_le_bytes()));
    write("flipped.spz", &put(&good, 115, &[0xff; 4]));

    let good = sog::tests::sample();
    write("cut.sog", &cut(&good, 40));
    let at = good.windows(4).position(|w| w == b"VP8L").unwrap();
    write("plane.sog", &put(&good, at + 9, &[0xff; 6]));

    let good = points_npz::tests::sample();
    write("cut.npz", &cut(&good, 200));

    let good = gltf::tests::sample();
    write("cut.glb", &cut(&good, 64));
    write("index.glb", &replaced(&good, "\"mesh\":0", "\"mesh\":7"));
    write("ring.glb", &replaced(&good, "\"children\":[2]", "\"children\":[1]"));
    write("count.glb", &replaced(&good, "\"count\":12", "\"count\":99"));

    write("other_version.asset", unity::tests::sample(4).description.replace("1020", "0101").as_bytes());
    write("no_planes.asset", unity::tests::sample(4).description.as_bytes());
    write("noise.bin", b"\x00\x01\x02 no scene here");
}
