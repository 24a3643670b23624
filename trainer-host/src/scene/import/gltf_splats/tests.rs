//! Tests of the reader of glTF of Gaussians.

use super::*;
use crate::scene::{
    export,
    import::{ErrorKind, splat},
};

pub fn sample(n: usize) -> Vec<u8> {
    let epoch = splat::parse(&splat::tests::sample(n), &Limits::default()).unwrap().epoch;
    export::gltf::encode(&epoch, 0).unwrap()
}

fn nothing(name: &str) -> Result<Vec<u8>, ImportError> {
    Err(FORMAT.malformed(name, "nothing", "a file"))
}

/// A GLB with another text.
fn edited(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let (text, binary) = json_chunk(bytes, false).unwrap();
    let text = std::str::from_utf8(text).unwrap();
    assert!(text.contains(from), "{from}: {text}");
    let text = text.replace(from, to);
    let binary = binary.unwrap();
    let mut out = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, chunk) in [(b"JSON", text.as_bytes()), (b"BIN\0", binary)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}

#[test]
fn nodes_move_what_hangs_on_them() {
    let bytes = sample(3);
    let plain = parse(&bytes, nothing, &Limits::default()).unwrap().epoch;
    let moved = edited(
        &bytes,
        r#"{"mesh":0}"#,
        r#"{"mesh":0,"rotation":[1,0,0,0],"scale":[2,2,2],"translation":[1,0,0]}"#,
    );
    let moved = parse(&moved, nothing, &Limits::default()).unwrap().epoch;
    let (a, b) = (plain.instant(0).gaussians[2], moved.instant(0).gaussians[2]);
    let [x, y, z] = a.position;
    assert_eq!(b.position, [2.0 * x + 1.0, -2.0 * y, -2.0 * z]);
    assert!((b.scale[0] / a.scale[0] - 2.0).abs() < 1e-5);
    let squeezed = edited(&bytes, r#"{"mesh":0}"#, r#"{"mesh":0,"scale":[1,2,1]}"#);
    let error = parse(&squeezed, nothing, &Limits::default()).unwrap_err();
    assert!(error.to_string().contains("transform of node 0"), "{error}");
}

#[test]
fn linear_colours_are_encoded() {
    let bytes = export::gltf::encode(&export::tests::epoch(20, 1), 0).unwrap();
    let read = |bytes: &[u8]| parse(bytes, nothing, &Limits::default()).unwrap();
    let plain = read(&bytes);
    for name in ["lin_rec709_display", "BT.709-linear"] {
        let linear = read(&edited(&bytes, "srgb_rec709_display", name));
        assert!(linear.notes[0].contains("higher bands"), "{:?}", linear.notes);
        let (a, b) = (plain.epoch.attributes(), linear.epoch.attributes());
        for (a, b) in a.sh0.frame(0, 20).iter().flatten().zip(b.sh0.frame(0, 20).iter().flatten()) {
            let (a, b) = (0.5 + SH_C0 * a, 0.5 + SH_C0 * b);
            let back = if b <= 0.040_45 { b / 12.92 } else { ((b + 0.055) / 1.055).powf(2.4) };
            assert!((back - a).abs() < 1e-4 && (b - a).abs() > 1e-3, "{a} and {b}");
        }
        assert_eq!((&a.sh_rest, &a.positions), (&b.sh_rest, &b.positions));
    }
    // As drafts wrote it, and without a word.
    for to in [r#""colorSpace":"BT.709-srgb","#, ""] {
        let same = read(&edited(&bytes, r#""colorSpace":"srgb_rec709_display","#, to));
        assert_eq!(same, plain);
    }
}

#[test]
fn without_scenes_each_node_is_read_once() {
    let bytes = sample(3);
    let nested = edited(&bytes, r#"[{"mesh":0}]"#, r#"[{"mesh":0},{"children":[0],"translation":[0,5,0]}]"#);
    let nested = edited(&nested, r#""scenes":[{"nodes":[0]}]"#, r#""scenes":[]"#);
    let read = |bytes: &[u8]| parse(bytes, nothing, &Limits::default()).unwrap().epoch.instant(0).gaussians;
    let (plain, nested) = (read(&bytes), read(&nested));
    assert_eq!(nested.len(), 3);
    assert_eq!(nested[2].position[1], plain[2].position[1] + 5.0);
}

#[test]
fn what_contradicts_itself_is_named() {
    let bytes = sample(3);
    for (from, to, says) in [
        (r#""mesh":0"#, r#""mesh":5"#, "no such mesh"),
        (r#""nodes":[0]"#, r#""nodes":[4]"#, "no such node"),
        (r#""mesh":0"#, r#""mesh":0,"children":[0]"#, "a tree without end"),
        (r#""VEC4""#, r#""VEC3""#, "ROTATION"),
        (r#""count":3"#, r#""count":4"#, "POSITION"),
        (r#""componentType":5126"#, r#""componentType":9"#, "component type"),
        (r#""ellipse""#, r#""customShape""#, "kernel: found customShape; allowed: ellipse"),
        (r#""ellipse""#, "7", "kernel: found 7"),
        (r#""perspective""#, r#""orthographic""#, "projection: found orthographic; allowed: perspective"),
        (r#""scene":0"#, r#""scene":4"#, "scene: found 4; allowed: one of the file's 1"),
        // Elements of 12 bytes would overlap, or lie where the format allows none.
        (r#""target""#, r#""byteStride":8,"target""#, "byteStride of POSITION: found 8; allowed: 12 to 252"),
        (r#""target""#, r#""byteStride":14,"target""#, "byteStride of POSITION: found 14"),
        (r#""target""#, r#""byteStride":256,"target""#, "byteStride of POSITION: found 256"),
        (
            "srgb_rec709_display",
            "BT.2020-pq",
            "colorSpace: found BT.2020-pq; allowed: srgb_rec709_display or",
        ),
        (r#""extensionsUsed""#, r#""extensionsRequired":["EXT_x"],"extensionsUsed""#, "EXT_x"),
    ] {
        let error = parse(&edited(&bytes, from, to), nothing, &Limits::default()).unwrap_err();
        assert!(error.to_string().contains(says), "{to}: {error}");
    }
    let error = parse(&bytes[..bytes.len() - 9], nothing, &Limits::default()).unwrap_err();
    assert_eq!(error.kind, ErrorKind::Truncated);
}

/// A degree is that of the highest coefficient there is: one that lacks others is refused, not left out.
#[test]
fn no_band_is_left_out_unsaid() {
    let key = |degree: u8| format!("\"KHR_gaussian_splatting:SH_DEGREE_{degree}_COEF_0\":");
    let bytes = export::gltf::encode(&export::tests::epoch(5, 3), 0).unwrap();
    for degree in [1, 2, 3] {
        let without = edited(&bytes, &key(degree), "\"_OTHER\":");
        let error = parse(&without, nothing, &Limits::default()).unwrap_err().to_string();
        assert!(error.contains(&format!("SH_DEGREE_{degree}_COEF_0: found nothing")), "{error}");
    }
    let more = edited(&bytes, &key(3), &format!("{}0,{}", key(4), key(3)));
    let read = parse(&more, nothing, &Limits::default()).unwrap();
    assert_eq!(read.epoch.attributes().sh_degree, ShDegree::MAX);
    assert_eq!(read.notes, ["harmonics of degree 4 are cut to degree 3"]);
}

#[test]
fn opacities_beyond_their_range_are_refused_or_said() {
    // Before them 36 bytes of positions, 12 of colours, 48 of rotations and 36 of scales.
    let with = |opacity: f32| {
        let mut bytes = sample(3);
        let binary = json_chunk(&bytes, false).unwrap().1.unwrap().len();
        let second = bytes.len() - binary + 132 + 4;
        bytes[second..second + 4].copy_from_slice(&opacity.to_le_bytes());
        bytes
    };
    let keep = Limits { keep_readable: true, ..Limits::default() };
    for (opacity, drawn) in [(1.5, 1.0), (-0.25, 0.0)] {
        let error = parse(&with(opacity), nothing, &Limits::default()).unwrap_err().to_string();
        let says = format!("opacity of Gaussian 1: found {opacity}; allowed: 0 to 1");
        assert!(error.contains(&says), "{error}");
        let read = parse(&with(opacity), nothing, &keep).unwrap();
        assert!(read.notes[0].contains("opacities of 1 Gaussians"), "{:?}", read.notes);
        assert!((read.epoch.instant(0).gaussians[1].opacity - drawn).abs() < 1e-4);
    }
    let rounded = parse(&with(1.000_01), nothing, &Limits::default()).unwrap();
    assert!(rounded.notes.is_empty(), "{:?}", rounded.notes);
    // What is no number is left out, as ever.
    assert!(parse(&with(f32::NAN), nothing, &Limits::default()).is_err());
    assert_eq!(parse(&with(f32::NAN), nothing, &keep).unwrap().epoch.count(), 2);
}

const PLAIN: &[u8] = include_bytes!("../../../../tests/compressed/splats.glb");
const PACKED: &[u8] = include_bytes!("../../../../tests/compressed/packed-splats.glb");

#[test]
fn compressed_gaussians_are_those_that_were_compressed() {
    let read = |bytes| parse(bytes, nothing, &Limits::default()).unwrap().epoch;
    let (plain, packed) = (read(PLAIN).instant(0), read(PACKED).instant(0));
    assert_eq!(plain.gaussians.len(), packed.gaussians.len());
    for (a, b) in plain.gaussians.iter().zip(&packed.gaussians) {
        assert_eq!(a.position, b.position);
        let turn: f32 = a.rotation.iter().zip(b.rotation).map(|(a, b)| a * b).sum();
        assert!(turn.abs() > 0.999_999, "{:?} {:?}", a.rotation, b.rotation);
        assert!((a.opacity - b.opacity).abs() < 0.5 / 254.0);
        for c in 0..3 {
            assert!((a.scale[c] / b.scale[c] - 1.0).abs() < 1e-3, "{:?} {:?}", a.scale, b.scale);
            assert!((a.sh0[c] - b.sh0[c]).abs() < 1e-4);
        }
    }
    let rest = plain.sh_rest.iter().zip(&packed.sh_rest);
    assert!(plain.sh_rest.len() == 9 * 90 && rest.into_iter().all(|(a, b)| (a - b).abs() < 1e-4));
}

#[test]
fn what_is_compressed_is_bounded_and_checked() {
    for (from, to, says) in [
        ("\"mode\":\"ATTRIBUTES\"", "\"mode\":\"TRIANGLES\"", "byteStride of buffer view 0"),
        ("\"mode\":\"ATTRIBUTES\"", "\"mode\":\"OTHER\"", "OTHER"),
        ("\"filter\":\"QUATERNION\"", "\"filter\":\"CUBIC\"", "CUBIC"),
        ("\"byteLength\":1080,", "\"byteLength\":9,", "byteLength of buffer view 0"),
        ("\"KHR_mesh_quantization\"", "\"KHR_draco\"", "KHR_draco"),
    ] {
        let error = parse(&edited(PACKED, from, to), nothing, &Limits::default()).unwrap_err();
        assert!(error.to_string().contains(says), "{to}: {error}");
    }
    let limits = Limits { max_bytes: PACKED.len() as u64, ..Limits::default() };
    let error = parse(PACKED, nothing, &limits).unwrap_err();
    assert_eq!(error.kind, ErrorKind::TooLarge, "{error}");
    assert!(error.to_string().contains("buffer view"), "{error}");
}

#[test]
fn what_is_there_is_read() {
    let epoch = export::tests::epoch(50, 1);
    let keep = Limits { keep_readable: true, ..Limits::default() };
    let whole = export::gltf::encode(&epoch, 0).unwrap();
    // Bands of 3 coefficients of 50 Gaussians come last, 600 bytes each.
    let cut = |bytes: usize| &whole[..whole.len() - bytes];
    let part = |bytes: usize| parse(cut(bytes), nothing, &keep).unwrap();
    for (bytes, count, note) in
        [(12, 50, "1 Gaussians lack harmonics"), (1800 + 24, 48, "of 50 Gaussians the first 48 are there")]
    {
        let error = parse(cut(bytes), nothing, &Limits::default()).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Truncated, "{error}");
        let part = part(bytes);
        assert!(part.notes[0].contains(note), "{:?}", part.notes);
        assert_eq!(part.epoch.count(), count);
        let positions = part.epoch.attributes().positions.frame(0, count);
        assert_eq!(positions, &epoch.attributes().positions.frame(0, 50)[..count]);
    }
    assert_eq!(part(12).epoch.attributes().sh_rest[..9], epoch.attributes().sh_rest[..9]);
    assert_eq!(part(12).epoch.attributes().sh_rest[49 * 9..], [0.0; 9]);
    assert_eq!(parse(cut(4700), nothing, &keep).unwrap_err().kind, ErrorKind::Empty);
}
