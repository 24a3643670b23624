//! Writes the committed corpus: small valid inputs for every body, made from formulas.
//!
//! `cargo test -p fuzz --test seed -- --ignored` writes all of `corpus/` anew. Inputs that once
//! broke something are kept beside these under names that start with `found-`, and the few that
//! bring a fuzzer to code which these do not reach under `reached-`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::{
    io::{Cursor, Write},
    path::Path,
};

use codec_core::internals::{
    ids::{ClusterId, EpochId, Group, Level, PacketId, Span, WindowId},
    wire::receipt::{Value, ViewerPose},
};
use dgs_quic::socket::message::{
    ClientMessage, Conditions, Granted, Message, Refusal, RefusalCode, ServerMessage, StreamChoice,
};
use fuzz::{fixture, small, unity_planes};
use serde_json::json;
use trainer_host::{
    Epoch,
    export::{self, ply as ply_writer, spz as spz_writer},
    import,
};

fn corpus() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

fn put(target: &str, name: &str, bytes: &[u8]) {
    assert!(fuzz::TARGETS.iter().any(|t| t.0 == target), "{target}");
    let folder = corpus().join(target);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join(name), bytes).unwrap();
}

/// A little of everything a byte can be.
fn noise(len: usize, seed: u32) -> Vec<u8> {
    let mut x = seed.wrapping_mul(747_796_405).wrapping_add(1);
    (0..len)
        .map(|_| {
            x ^= x << 13;
            x ^= x >> 17;
            x ^= x << 5;
            (x >> 11) as u8
        })
        .collect()
}

#[test]
#[ignore = "writes the committed corpus"]
fn write_corpus() {
    wire();
    control();
    coding();
    session();
    imports();
    traces();
}

fn wire() {
    for (p, name) in [(false, "dgs1"), (true, "paper")] {
        let stream = fixture(p);
        let packets = stream.packets();
        for id in [0, packets.len() / 2, packets.len() - 1] {
            let packet = &packets[id];
            put("packet", &format!("{name}-{id}"), &packet[..packet.len() - 4]);
        }
        if !p {
            put("manifest", &format!("{name}-message"), stream.message());
            put("manifest", &format!("{name}-body"), stream.manifest().unwrap().raw());
            let mut file = stream.to_bytes().unwrap();
            put("file", "cut", &file[..stream.message().len() + 3000]);
            file[stream.message().len() + 100] ^= 0x40;
            put("file", "flipped", &file);
        }
    }
    for (paper, name) in [(false, "small-dgs1"), (true, "small-paper")] {
        put("file", name, &small(paper).to_bytes().unwrap());
    }
    let id = |i| PacketId::new(i).unwrap();
    let groups = [
        Group { span: Span::Canonical(EpochId(0)), cluster: ClusterId(7), level: Level::BASE },
        Group { span: Span::Motion(WindowId(300)), cluster: ClusterId(700), level: Level::ALL[3] },
    ];
    let pose = Some(ViewerPose { position: [1.0, -2.0, 3.0], rotation: [1.0, 0.0, 0.0, 0.0] });
    let many: Vec<_> = (0..100).map(|i| (id(i * 1000), id(i * 1000 + 500))).collect();
    for (name, pose, acknowledged) in
        [("empty", None, &[][..]), ("one", None, &[(id(0), id(9))][..]), ("many", pose, &many)]
    {
        let value = Value {
            sequence: 300,
            playout_us: 1_234_567,
            pose,
            acknowledged,
            recovered: &[id(12), id(70_000)],
            completed: &groups,
        };
        let mut out = [0u8; 1300];
        let len = value.write(&mut out).unwrap();
        put("receipt", name, &out[..len - 4]);
    }
}

fn control() {
    let named = StreamChoice::Name("fox.2".to_owned());
    let client = [
        ClientMessage::Hello { stream: named, start_us: 1_500_000 },
        ClientMessage::Seek { round: 1, start_us: 0 },
        ClientMessage::Conditions { round: 2, start_us: 40_000, conditions: Conditions::NONE },
        ClientMessage::Bye,
    ];
    let indexed = ClientMessage::Hello { stream: StreamChoice::Index(1), start_us: 0 };
    let refusal = Refusal { code: RefusalCode::Full, sentence: "all 2 places are taken".to_owned() };
    let granted = ServerMessage::Granted { round: 2, granted: Granted { link: true, scheduler: true } };
    let manifest = ServerMessage::Manifest(small(false).message().to_vec());
    let server = [manifest, granted, ServerMessage::Refusal(refusal)];
    let client: Vec<u8> = client.iter().flat_map(Message::to_bytes).collect();
    let server: Vec<u8> = server.iter().flat_map(Message::to_bytes).collect();
    for (name, step, bytes) in
        [("client", 6, client), ("indexed", 0, indexed.to_bytes()), ("server", 30, server)]
    {
        put("control", name, &[&[step][..], &bytes].concat());
    }
}

fn coding() {
    for (i, mode) in [0u8, 1, 4, 5, 9].into_iter().enumerate() {
        let head = [mode, 12, 8 + i as u8, 200, 0];
        put("lanes", &format!("mode-{mode}"), &[&head[..], &noise(500, i as u32)].concat());
    }
    // A table of two tokens, sent in front of the values.
    let table = [1u8, 127, 2, 1, 0, 0xff, 3, 0, 4];
    put("lanes", "own-table", &[&[3u8, 30, 9][..], &table, &[0; 55], &[100, 0], &noise(200, 8)].concat());
    put("tables", "two-tokens", &[&[0u8, 0][..], &table].concat());
    put(
        "tables",
        "counts",
        &[&[1u8, 3][..], &(0..60u8).flat_map(|i| [100 + i, i % 7, i, 1]).collect::<Vec<u8>>()].concat(),
    );
    put("tables", "uneven", &[1u8, 0, 128, 23, 255, 255, 129, 0, 1, 0, 5, 0, 1, 0]);
    for shift in [0u8, 6, 12] {
        let head = [shift, shift, 0xff, 0];
        put("bytes", &format!("shift-{shift}"), &[&head[..], &noise(520, shift.into())].concat());
    }
    let raw: Vec<u8> = (0..600u32).flat_map(|i| [(i % 5) as u8, 0, 0, 1]).collect();
    put("pack", "records", &[&[0x60, 9][..], &raw].concat());
    put("pack", "noise", &[&[100, 0][..], &noise(300, 1)].concat());
    let mut packed = vec![0u8; 9000];
    let len = codec_core::internals::pack::pack(&raw, &mut packed).unwrap();
    put("pack", "packed", &[&(raw.len() as u16).to_le_bytes()[..], &packed[..len]].concat());
}

fn session() {
    for paper in [0u8, 1] {
        let packets = fixture(paper == 1).packets();
        let content = &packets[1][..packets[1].len() - 4];
        put("slices", &format!("content-{paper}"), &[&[paper | 4][..], content].concat());
        put("slices", &format!("edits-{paper}"), &[paper | 2, 3, 0, 5, 0, 0, 2, 40, 0, 1, 9]);
        put("slices", &format!("headers-{paper}"), &[paper | 6, 0, 0, 4, 0, 5, 9, 5, 0, 4, 1, 6, 0, 1, 2]);
        for seed in [1u8, 2, 3] {
            put("decode", &format!("seed-{seed}-{paper}"), &[paper | 2, seed, 9, 8, 7]);
            put("decode", &format!("edit-{seed}-{paper}"), &[paper | 2, seed, 1, 1, 1, 50 * seed, 0, 0, 1]);
        }
        let mut states = vec![paper, 5];
        states.extend((0..64u8).map(|i| i.wrapping_mul(37)));
        put("closure", &format!("mixed-{paper}"), &states);
        put("closure", &format!("base-{paper}"), &[paper, 1, 1]);
        put("closure", &format!("gaps-{paper}"), &[paper, 7, 0b1011, 0b1111, 0b1110, 0b0111]);
        let run = [15u8, 0, 0, 39];
        let lossy: Vec<u8> = (0..40u8).flat_map(|i| [i % 3, i.wrapping_mul(11), 0, 0]).collect();
        put("receiver", &format!("in-order-{paper}"), &[&[paper | 4][..], &run, &run].concat());
        put("receiver", &format!("early-{paper}"), &[&[paper | 2][..], &run, &[14, 0, 0, 1], &run].concat());
        put("receiver", &format!("some-{paper}"), &[&[paper | 4][..], &lossy].concat());
        let damage: Vec<u8> =
            (0..40u8).flat_map(|i| [8 + i % 7, i.wrapping_mul(29), 0, i.wrapping_mul(53)]).collect();
        put("receiver", &format!("damage-{paper}"), &[&[paper | 4][..], &damage].concat());
        put("receiver", &format!("forged-{paper}"), &[&[paper | 12][..], &damage, &run].concat());
    }
    for paper in [0u8, 1] {
        // The frame rate doubled; then some packets true, some bent, and the true ones behind them.
        put("forged", &format!("true-{paper}"), &[paper | 2, 0, 1, 0, 0, 3, 0, 0, 2, 0, 0]);
        put(
            "forged",
            &format!("packets-{paper}"),
            &[paper, 0, 2, 0, 1, 9, 0, 0, 1, 4, 0, 2, 9, 0, 5, 3, 9, 1, 4, 1],
        );
        put(
            "forged",
            &format!("manifest-{paper}"),
            &[paper | 2, 2, 6, 0, 4, 1, 40, 0, 0, 2, 3, 0, 0, 1, 0, 0],
        );
    }
    // Members 0, 1 and 3 of four, then row 0.
    let mut set = vec![4u8, 0, 4];
    for member in [0u8, 1, 3] {
        set.extend([0, member, 20, 0]);
        set.extend(noise(20, member.into()));
    }
    set.extend([3, 0, 20, 0]);
    set.extend(noise(22, 9));
    put("repair", "one-missing", &set);
    put("repair", "long", &[&[32u8, 0, 255, 9, 4, 0xff, 4][..], &noise(1300, 5)].concat());
    // Two of eight there, all eight rows, for the six missing.
    let mut set = vec![8u8, 7, 4];
    for member in [2u8, 5] {
        set.extend([0, member, 20, 0]);
        set.extend(noise(20, member.into()));
    }
    for row in 0..8u8 {
        set.extend([3, row, 20, 0]);
        set.extend(noise(22, row.into()));
    }
    put("cauchy", "six-missing", &set);
    // A run of fifteen like members, one of them missing, rows 3 and 7 of them true.
    let mut set = vec![16u8, 7, 4, 0xf2, 1, 3, 0, 7, 8, 9];
    for row in [3u8, 7] {
        set.extend([3, row, 3, 0, 1, 2, 3, 0, 0]);
    }
    put("cauchy", "a-run", &set);
    put("cauchy", "long", &[&[64u8, 6, 200, 15, 4, 0xff, 4][..], &noise(1300, 6)].concat());
    let every: Vec<u8> = (0..120u8).flat_map(|i| [i, 0]).collect();
    for flags in [0u8, 1] {
        put("sliced", &format!("first-{flags}"), &[&[flags, 3][..], &every].concat());
        put("sliced", &format!("odd-{flags}"), &[&[flags, 6][..], &noise(160, flags.into())].concat());
    }
}

fn imports() {
    let of =
        |n: usize| -> Epoch { import::splat::parse(&splat(n), &import::Limits::default()).unwrap().epoch };
    let epoch = of(24);
    put("ply", "binary", &ply_writer::encode(&epoch, 0));
    put("ply", "ascii", &ascii_ply(3));
    put("compressed_ply", "two-chunks", &export::compressed_ply::encode(&of(260), 0));
    put("compressed_ply", "few", &export::compressed_ply::encode(&of(5), 0));
    put("splat", "few", &splat(5));
    put(
        "spz",
        "planes-V2",
        &[&b"NGSP\x02\0\0\0\x02\0\0\0\x01\x0c\0\0"[..], &noise(2 * (9 + 1 + 3 + 3 + 3 + 9), 3)].concat(),
    );
    for version in [spz_writer::Version::V3, spz_writer::Version::V4] {
        let options = spz_writer::SpzOptions { version, fraction_bits: 12, antialiased: false };
        put("spz", &format!("{version:?}"), &spz_writer::encode(&epoch, 0, &options).unwrap());
    }
    let (archive, description) = sog();
    put("sog", "archive", &archive);
    put("sog", "description", description.as_bytes());
    put("points_npz", "four", &points_npz());
    put("gltf", "strip.glb", &glb());
    put("gltf_splats", "few.glb", &export::gltf::encode(&epoch, 0).unwrap());
    let of_others = Path::new(env!("CARGO_MANIFEST_DIR")).join("../trainer-host/tests");
    for (target, name, file) in [
        ("gltf", "packed-strip.glb", "compressed/packed-strip.glb"),
        ("gltf", "draco-edgebreaker.glb", "compressed/draco-edgebreaker.glb"),
        ("gltf", "draco-sequential.glb", "compressed/draco-sequential.glb"),
        ("gltf_splats", "packed-splats.glb", "compressed/packed-splats.glb"),
        ("deformation", "planes", "deformation/planes.npz"),
        ("deformation", "all", "deformation/planes-all.safetensors"),
        ("deformation", "screw", "deformation/warp-screw.npz"),
        ("deformation", "options", "deformation/planes-all-cfg_args"),
        ("fourdgs", "reference", "golden/reference.4dgs"),
    ] {
        put(target, name, &std::fs::read(of_others.join(file)).unwrap());
    }
    put("ksplat", "floats", &ksplat(4, 0));
    put("ksplat", "bytes", &ksplat(4, 2));
    put("splatv", "three", &splatv(3));
    put("points_npz", "gsplat", &gsplat_npz());
    put("dynamic_npz", "two", &dynamic_npz());
    let (description, planes) = unity_planes(20);
    put("unity", "description", &[&[0u8][..], description.as_bytes()].concat());
    for (i, plane) in planes.iter().enumerate().filter(|(i, _)| *i != 3) {
        put("unity", &format!("plane-{i}"), &[&[i as u8 + 1][..], plane].concat());
    }
}

fn splat(n: usize) -> Vec<u8> {
    let mut out = Vec::new();
    for i in 0..n {
        for v in [i as f32, 0.5, -0.5, 0.01, 0.02, 0.03] {
            out.extend(v.to_le_bytes());
        }
        out.extend([255, 128, i as u8, 204, 255, 128, 128, 128]);
    }
    out
}

/// One section of `n` splats with harmonics of degree 1, in one bucket.
fn ksplat(n: u32, level: u16) -> Vec<u8> {
    let mut out = vec![0u8; 4096 + 1024];
    let mut put = |at: usize, bytes: &[u8]| out[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &[0, 1]);
    put(20, &level.to_le_bytes());
    let words = [(4, 1), (8, 1), (16, n)];
    let section = [(0, n), (4, n), (8, 256), (12, 1), (24, 32_767), (36, 1)].map(|(at, v)| (4096 + at, v));
    words.into_iter().chain(section).for_each(|(at, v): (usize, u32)| put(at, &v.to_le_bytes()));
    put(4096 + 16, &5f32.to_le_bytes());
    put(4096 + 20, &[12]);
    put(4096 + 40, &[1]);
    out.extend(n.to_le_bytes());
    out.extend([1f32, 2.0, 3.0].into_iter().flat_map(f32::to_le_bytes));
    for i in 0..n {
        if level == 0 {
            let numbers = [i as f32, 2.0, 3.0, 0.125, 0.25, 0.5, 0.5, -0.5, 0.5, 0.5];
            out.extend(numbers.into_iter().flat_map(f32::to_le_bytes));
            out.extend([255, 128, 0, 204]);
            out.extend([0.25f32; 9].into_iter().flat_map(f32::to_le_bytes));
        } else {
            // Half-precision 0.25, 0.25, 0.5, then 0.5, -0.5, 0.5, 0.5.
            let halves = [0x3400u16, 0x3400, 0x3800, 0x3800, 0xb800, 0x3800, 0x3800];
            let places = [32_767 + i as u16, 32_767, 32_767];
            out.extend(places.into_iter().chain(halves).flat_map(u16::to_le_bytes));
            out.extend([255, 128, 0, 204, 9, 8, 7, 6, 5, 4, 3, 2, 1]);
        }
    }
    out
}

/// Splats that go along x.
fn splatv(n: usize) -> Vec<u8> {
    let text = format!("[{{\"type\":\"splat\",\"size\":{}}}]", n * 64);
    let mut out =
        [&0x674bu32.to_le_bytes()[..], &(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
    for i in 0..n {
        out.extend([i as f32, 0.0, 2.0].into_iter().flat_map(f32::to_le_bytes));
        // Half-precision wxyz and scales, colour, motion, turning, centre and width.
        let first = [0x3c00u16, 0, 0, 0, 0x3400, 0x3800, 0x3000, 0];
        let motion = [0x3c00u16, 0, 0, 0x4000, 0, 0, 0x4400, 0, 0, 0, 0, 0x3c00, 0, 0, 0, 0x3800];
        out.extend(first.into_iter().flat_map(u16::to_le_bytes));
        out.extend([255, 0, 128, 204]);
        out.extend(motion.into_iter().flat_map(u16::to_le_bytes));
    }
    out
}

/// An archive of NumPy arrays: name, shape, how many numbers.
fn npz<const N: usize>(arrays: [(&str, &str, usize); N]) -> Vec<u8> {
    let npy = |shape: &str, count: usize| {
        let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}), }}\n");
        let values: Vec<f32> = (0..count).map(|i| 0.25 * i as f32 - 0.5).collect();
        let length = (header.len() as u16).to_le_bytes();
        [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), &floats(&values)].concat()
    };
    zipped(&arrays.map(|(name, shape, count)| (name, npy(shape, count))))
}

/// Two Gaussians of degree 1.
fn gsplat_npz() -> Vec<u8> {
    let (means, scales, quats) =
        (("means.npy", "2, 3", 6), ("scales.npy", "2, 3", 6), ("quats.npy", "2, 4", 8));
    npz([means, scales, quats, ("opacities.npy", "2", 2), ("sh0.npy", "2, 3", 6), ("shN.npy", "2, 3, 3", 18)])
}

/// Two frames of two Gaussians.
fn dynamic_npz() -> Vec<u8> {
    let (means, rotations) = (("means3D.npy", "2, 2, 3", 12), ("unnorm_rotations.npy", "2, 2, 4", 16));
    let (opacities, scales) = (("logit_opacities.npy", "2, 1", 2), ("log_scales.npy", "2, 3", 6));
    npz([means, rotations, ("rgb_colors.npy", "2, 2, 3", 12), opacities, scales])
}

fn ascii_ply(n: usize) -> Vec<u8> {
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let mut out = format!("ply\nformat ascii 1.0\nelement vertex {n}\n");
    names.split(' ').for_each(|name| out += &format!("property float {name}\n"));
    out += "end_header\n";
    (0..n).for_each(|i| out += &format!("{i} 0.5 -1e-3 0.1 0.2 0.3 2 -4 -4 -5 1 0 0 0.{i}\n"));
    out.into_bytes()
}

fn webp(width: u32, height: u32, pixel: impl Fn(u32) -> [u8; 4]) -> Vec<u8> {
    let raw: Vec<u8> = (0..width * height).flat_map(pixel).collect();
    let mut out = Vec::new();
    image_webp::WebPEncoder::new(&mut out).encode(&raw, width, height, image_webp::ColorType::Rgba8).unwrap();
    out
}

fn zipped(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, bytes) in files {
        zip.start_file(*name, stored).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn sog() -> (Vec<u8>, String) {
    let book: Vec<f32> = (0..256).map(|i| (i as f32 - 128.0) / 64.0).collect();
    let meta = json!({
        "version": 2, "count": 6,
        "means": {"mins": [-1.0, -1.0, -1.0], "maxs": [1.0, 1.0, 1.0], "files": ["l.webp", "u.webp"]},
        "scales": {"codebook": book, "files": ["s.webp"]},
        "quats": {"files": ["q.webp"]},
        "sh0": {"codebook": book, "files": ["c.webp"]},
        "shN": {"count": 2, "bands": 1, "codebook": book, "files": ["p.webp", "n.webp"]},
    })
    .to_string();
    let files = [
        ("meta.json", meta.clone().into_bytes()),
        ("l.webp", webp(3, 2, |i| [i as u8, 255, 0, 255])),
        ("u.webp", webp(3, 2, |_| [0, 255, 128, 255])),
        ("s.webp", webp(3, 2, |i| [i as u8, 0, 128, 255])),
        ("q.webp", webp(3, 2, |i| [128, 128, 128, 252 + (i % 4) as u8])),
        ("c.webp", webp(3, 2, |i| [128, 64, 192, 50 * i as u8])),
        ("p.webp", webp(192, 1, |i| [i as u8, 128, 0, 255])),
        ("n.webp", webp(3, 2, |i| [(i % 2) as u8, 0, 0, 255])),
    ];
    (zipped(&files), meta)
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn points_npz() -> Vec<u8> {
    let npy = |descr: &str, shape: &str, data: &[u8]| {
        let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
    };
    zipped(&[
        ("means3d.npy", npy("<f4", "(4, 3)", &floats(&[0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1.]))),
        ("colors.npy", npy("|u1", "(4, 3)", &[255, 0, 128, 0, 0, 0, 10, 20, 30, 40, 50, 60])),
        ("viewmats.npy", npy("<f4", "(1, 3, 4)", &floats(&[1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 5.]))),
        ("Ks.npy", npy("<f4", "(1, 3, 3)", &floats(&[100., 0., 50., 0., 100., 40., 0., 0., 1.]))),
        ("width.npy", npy("<i8", "()", &100i64.to_le_bytes())),
        ("height.npy", npy("<i8", "()", &80i64.to_le_bytes())),
    ])
}

/// A skinned strip of two triangles whose joint rises.
fn glb() -> Vec<u8> {
    let data = [
        floats(&[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.]),
        [[0u8, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]].concat(),
        floats(&[1., 0., 0., 0.].repeat(4)),
        [0u16, 1, 2, 0, 2, 3].iter().flat_map(|v| v.to_le_bytes()).collect(),
        floats(&[0., 1.]),
        floats(&[0., 0., 0., 0., 2., 0.]),
    ];
    let (mut blob, mut views) = (Vec::new(), Vec::new());
    for data in &data {
        views.push(json!({"buffer": 0, "byteOffset": blob.len(), "byteLength": data.len()}));
        blob.extend(data);
        blob.resize(blob.len().next_multiple_of(4), 0);
    }
    fn accessor(view: u32, kind: u32, count: u32, shape: &str) -> serde_json::Value {
        json!({"bufferView": view, "componentType": kind, "count": count, "type": shape})
    }
    let mut first = accessor(0, 5126, 4, "VEC3");
    first["min"] = json!([0.0, 0.0, 0.0]);
    first["max"] = json!([1.0, 1.0, 0.0]);
    let root = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0}, {"children": [2]}, {"name": "lift"}],
        "meshes": [{"primitives": [{
            "attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2},
            "indices": 3,
        }]}],
        "skins": [{"joints": [1, 2]}],
        "animations": [{"name": "rise",
            "channels": [{"sampler": 0, "target": {"node": 2, "path": "translation"}}],
            "samplers": [{"input": 4, "output": 5}]}],
        "accessors": [first, accessor(1, 5121, 4, "VEC4"), accessor(2, 5126, 4, "VEC4"),
            accessor(3, 5123, 6, "SCALAR"), accessor(4, 5126, 2, "SCALAR"), accessor(5, 5126, 2, "VEC3")],
        "bufferViews": views, "buffers": [{"byteLength": blob.len()}],
    });
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + text.len() as u32 + blob.len() as u32).to_le_bytes());
    for (kind, data) in [(b"JSON", &text), (b"BIN\0", &blob)] {
        out.extend((data.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(data);
    }
    out
}

fn traces() {
    put("trace", "opportunities", b"0\n0\n3\n7\n7\n20\n1000\n");
    put("trace", "two-columns", b"0.0 1.5\n0.5 2.25\n1.0\t0\n1.5 12e0\n");
    put("trace", "delays", b"12\n9.5\n60000\n0\n");
    let mut log = String::from("Timestamp,DL_bitrate,UL_bitrate,State,PINGAVG\n");
    for second in 0..20 {
        let (rate, ping) = if second % 5 == 2 { (0, "81.5") } else { (9000 + second * 7, "-") };
        log += &format!("2020.02.14_09.38.{second:02},{rate},40,D,{ping}\n");
    }
    put("trace", "log", log.as_bytes());
}
