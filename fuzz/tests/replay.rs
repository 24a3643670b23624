//! Replays the corpus on stable, with seeded mutations of each input: the same executions on every
//! machine and in every run. `DGS_FUZZ_ROUNDS=50` multiplies the mutations for a longer look.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::{collections::BTreeMap, path::Path, time::Instant};

use fuzz::TARGETS;

/// Mutations per target. Session bodies set up a whole receiver each time and take fewer.
const MUTATIONS: &[(&str, usize)] = &[
    ("slices", 600),
    ("sliced", 800),
    ("repair", 4000),
    ("cauchy", 2000),
    ("decode", 1200),
    ("closure", 2500),
    ("receiver", 350),
    ("forged", 2000),
    ("file", 800),
    ("pack", 2000),
    ("bytes", 2000),
    ("gltf", 6000),
    ("gltf_splats", 6000),
    ("splatv", 2000),
    ("fourdgs", 2000),
    ("deformation", 2000),
];
const MUTATIONS_OTHERS: usize = 12_000;

fn corpus(target: &str) -> BTreeMap<String, Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let read = |entry: std::io::Result<std::fs::DirEntry>| {
        let entry = entry.unwrap();
        (entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).unwrap())
    };
    entries.map(read).collect()
}

struct Random(u64);

impl Random {
    fn below(&mut self, most: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) % most.max(1) as u64) as usize
    }

    /// A short length more often than a long one.
    fn length(&mut self, most: usize) -> usize {
        let most = self.below(most + 1);
        self.below(most + 1)
    }
}

/// One of: flipped bits, another byte, a telling word, a cut, a splice with another input, a
/// repeated part, an inserted part.
fn mutate(bytes: &mut Vec<u8>, others: &[&Vec<u8>], random: &mut Random) {
    const WORDS: [u32; 8] = [0, 1, u32::MAX, i32::MAX as u32, 0x8000, 0x7fc0_0000, 0x7f80_0000, 0xff];
    let n = bytes.len();
    let at = random.below(n);
    match random.below(10) {
        0..=2 => {
            for _ in 0..=random.length(8) {
                let bit = random.below(n * 8);
                if let Some(byte) = bytes.get_mut(bit / 8) {
                    *byte ^= 1 << (bit % 8);
                }
            }
        }
        3 | 4 => bytes.iter_mut().skip(at).take(1).for_each(|b| *b = random.below(256) as u8),
        5 => {
            let word = WORDS[random.below(WORDS.len())].to_le_bytes();
            let len = [1, 2, 4][random.below(3)];
            bytes.iter_mut().skip(at).zip(&word[..len]).for_each(|(b, w)| *b = *w);
        }
        6 => bytes.truncate(at),
        7 => {
            let other = others[random.below(others.len())];
            let from = random.below(other.len());
            bytes.truncate(at);
            bytes.extend_from_slice(&other[from.min(other.len())..]);
        }
        8 => {
            let len = random.length(n - at);
            let part = bytes[at..at + len].to_vec();
            let to = random.below(n + 1);
            bytes.splice(to..to, part);
        }
        _ => {
            let part: Vec<u8> = (0..=random.length(16)).map(|_| random.below(256) as u8).collect();
            bytes.splice(at..at, part);
        }
    }
    bytes.truncate(1 << 17);
}

/// Runs a body and says which input it was if it fails.
fn run(target: &str, body: fuzz::Body, bytes: &[u8], what: &str) {
    let result = std::panic::catch_unwind(|| body(bytes));
    if result.is_err() {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let file = folder.join(format!("{target}-failed"));
        std::fs::write(&file, bytes).unwrap();
        panic!("{target}: {what} fails; its {} bytes are in {}", bytes.len(), file.display());
    }
}

fn replay(target: &str, body: fuzz::Body) -> (usize, usize) {
    let inputs = corpus(target);
    assert!(!inputs.is_empty(), "{target} has no corpus");
    for (name, bytes) in &inputs {
        run(target, body, bytes, name);
    }
    run(target, body, &[], "nothing");
    let rounds = std::env::var("DGS_FUZZ_ROUNDS").ok().and_then(|r| r.parse().ok()).unwrap_or(1);
    let known = MUTATIONS.iter().find(|m| m.0 == target).map_or(MUTATIONS_OTHERS, |m| m.1);
    let all: Vec<&Vec<u8>> = inputs.values().collect();
    let mut random =
        Random(target.bytes().fold(1, |seed: u64, b| seed.wrapping_mul(31).wrapping_add(b.into())));
    for i in 0..known * rounds {
        let mut bytes = all[random.below(all.len())].clone();
        for _ in 0..=random.length(3) {
            mutate(&mut bytes, &all, &mut random);
        }
        run(target, body, &bytes, &format!("mutation {i}"));
    }
    (inputs.len() + 1, known * rounds)
}

macro_rules! replays {
    ($($name:ident)*) => {
        $(
            #[test]
            fn $name() {
                let start = Instant::now();
                let body = TARGETS.iter().find(|t| t.0 == stringify!($name)).unwrap().1;
                let (inputs, mutations) = replay(stringify!($name), body);
                println!(
                    "{}: {inputs} inputs, {mutations} mutations, {:.2} s",
                    stringify!($name),
                    start.elapsed().as_secs_f64()
                );
            }
        )*
        const REPLAYED: &[&str] = &[$(stringify!($name)),*];
    };
}

replays! {
    packet manifest receipt control file tables lanes bytes pack slices sliced decode repair cauchy closure
    receiver forged
    ply compressed_ply spz splat sog points_npz gltf gltf_splats ksplat splatv fourdgs dynamic_npz deformation
    unity trace
}

#[test]
fn every_body_is_replayed_and_has_a_target_and_a_corpus() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let names: Vec<&str> = TARGETS.iter().map(|t| t.0).collect();
    assert_eq!(names, REPLAYED);
    let manifest = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
    let results = std::fs::read_to_string(root.join("RESULTS.md")).unwrap();
    let rows: Vec<&str> =
        results.lines().filter_map(|line| line.strip_prefix("| ")?.split(" |").next()).collect();
    let unmeasured = results.lines().skip_while(|line| !line.starts_with("Not measured: "));
    let unmeasured: String = unmeasured.take_while(|line| !line.is_empty()).collect();
    for name in &names {
        let (measured, not) = (rows.contains(name), unmeasured.contains(&format!("`{name}`")));
        assert!(measured != not, "{name} in RESULTS.md: measured {measured}, said not to be {not}");
        assert!(manifest.contains(&format!("path = \"fuzz_targets/{name}.rs\"")), "{name} in Cargo.toml");
        let target = std::fs::read_to_string(root.join(format!("fuzz_targets/{name}.rs"))).unwrap();
        assert!(target.contains(&format!("fuzz::{name}(data)")), "{name}");
    }
    for folder in ["corpus", "fuzz_targets"] {
        for entry in std::fs::read_dir(root.join(folder)).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            assert!(names.contains(&name.trim_end_matches(".rs")), "{folder}/{name} belongs to no body");
        }
    }
}

#[test]
#[should_panic(expected = "mutation")]
fn a_body_that_fails_is_reported() {
    fn picky(data: &[u8]) {
        assert!(data.starts_with(b"ply") || data.is_empty(), "this body cannot stand lies");
    }
    replay("ply", picky);
}
