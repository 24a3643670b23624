//! Tests of the reader of SOG.

use std::io::Write;

use super::*;

fn webp(width: u32, height: u32, pixel: impl Fn(u32) -> [u8; 4]) -> Vec<u8> {
    let raw: Vec<u8> = (0..width * height).flat_map(pixel).collect();
    let mut out = Vec::new();
    image_webp::WebPEncoder::new(&mut out).encode(&raw, width, height, image_webp::ColorType::Rgba8).unwrap();
    out
}

/// Six Gaussians with a palette of two: metadata and planes.
pub fn files() -> Vec<(&'static str, Vec<u8>)> {
    let book: Vec<f32> = (0..256).map(|i| (i as f32 - 128.0) / 64.0).collect();
    let meta = serde_json::json!({
        "version": 2, "count": 6,
        "means": {"mins": [-1.0, -1.0, -1.0], "maxs": [1.0, 1.0, 1.0], "files": ["l.webp", "u.webp"]},
        "scales": {"codebook": book, "files": ["s.webp"]},
        "quats": {"files": ["q.webp"]},
        "sh0": {"codebook": book, "files": ["c.webp"]},
        "shN": {"count": 2, "bands": 1, "codebook": book, "files": ["p.webp", "n.webp"]},
    });
    vec![
        ("meta.json", meta.to_string().into_bytes()),
        ("l.webp", webp(3, 2, |i| [i as u8, 255, 0, 255])),
        ("u.webp", webp(3, 2, |_| [0, 255, 128, 255])),
        ("s.webp", webp(3, 2, |i| [i as u8, 0, 128, 255])),
        ("q.webp", webp(3, 2, |i| [128, 128, 128, 252 + (i % 4) as u8])),
        ("c.webp", webp(3, 2, |i| [128, 64, 192, 50 * i as u8])),
        ("p.webp", webp(192, 1, |i| [i as u8, 128, 0, 255])),
        ("n.webp", webp(3, 2, |i| [(i % 2) as u8, 0, 0, 255])),
    ]
}

/// The same scene as version 1 writes it, but for its scales and colours.
pub fn files_of_version_1() -> Vec<(&'static str, Vec<u8>)> {
    let meta = serde_json::json!({
        "means": {"shape": [6, 3], "mins": [-1.0, -1.0, -1.0], "maxs": [1.0, 1.0, 1.0],
            "files": ["l.webp", "u.webp"]},
        "scales": {"shape": [6, 3], "mins": [-8.0, -4.0, 0.0], "maxs": [0.0, 0.0, 0.0],
            "files": ["s.webp"]},
        "quats": {"shape": [6, 4], "encoding": "quaternion_packed", "files": ["q.webp"]},
        "sh0": {"shape": [6, 1, 4], "mins": [-1.0, -1.0, -1.0, -6.0], "maxs": [1.0, 1.0, 1.0, 6.0],
            "files": ["c.webp"]},
        "shN": {"shape": [6, 9], "mins": -2.0, "maxs": 2.0, "quantization": 8,
            "files": ["p.webp", "n.webp"]},
    });
    let mut files = files();
    files[0].1 = meta.to_string().into_bytes();
    files
}

#[test]
fn version_1_has_ranges_and_logits() {
    let read = |files: &[(&str, Vec<u8>)]| {
        let found = |name: &str| {
            let file = files.iter().find(|file| file.0 == name);
            Ok(file.ok_or_else(|| missing(name))?.1.clone())
        };
        parse_files(&files[0].1, found, &Limits::default())
    };
    let files = files_of_version_1();
    let s = read(&files).unwrap();
    let a = s.epoch.attributes();
    let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-4, "{a} and {b}");
    near(a.log_scales.frame(0, 6)[5][0], -8.0 + 5.0 / 255.0 * 8.0);
    near(a.log_scales.frame(0, 6)[5][1], -4.0);
    near(a.sh0.frame(0, 6)[0][0], 128.0 / 127.5 - 1.0);
    near(a.opacity_logits.frame(0, 6)[5], 250.0 / 255.0 * 12.0 - 6.0);
    assert_eq!(a.sh_degree.get(), 1);
    near(a.sh_rest[9], 3.0 / 255.0 * 4.0 - 2.0);
    // The positions and turns are those of version 2.
    let two = parse(&sample(), &Limits::default()).unwrap();
    assert_eq!(a.positions, two.epoch.attributes().positions);
    assert_eq!(a.rotations, two.epoch.attributes().rotations);
    for (from, to, words) in [
        ("[-1.0,-1.0,-1.0],\"shape\":[6,3]", "[-1.0,-1.0,-1.0]", "means.shape"),
        ("[-8.0,-4.0,0.0]", "[-8.0]", "scales.mins"),
        ("\"mins\":-2.0,", "", "shN.mins"),
    ] {
        let text = String::from_utf8(files[0].1.clone()).unwrap();
        assert!(text.contains(from), "{text}");
        let mut bent = files.clone();
        bent[0].1 = text.replace(from, to).into_bytes();
        let error = read(&bent).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

/// The same, zipped.
pub fn sample() -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files() {
        let options = zip::write::SimpleFileOptions::default();
        zip.start_file(name, options.compression_method(zip::CompressionMethod::Stored)).unwrap();
        zip.write_all(&bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn planes_read_back() {
    let s = parse(&sample(), &Limits::default()).unwrap();
    let a = s.epoch.attributes();
    assert_eq!(a.log_scales.frame(0, 6)[5], [-123.0 / 64.0, -2.0, 0.0]);
    assert!((a.positions.frame(0, 6)[0][1] - (1f32.exp() - 1.0)).abs() < 1e-6);
    assert!(a.rotations.frame(0, 6)[2][2] > 0.99);
    assert_eq!(a.sh_rest[9], (3.0 - 128.0) / 64.0, "second entry starts at pixel 3");
}

#[test]
fn harmonics_and_gaussians_that_are_damaged_are_left_out() {
    let keep = Limits { keep_readable: true, ..Limits::default() };
    let read = |name: &str, bytes: Vec<u8>, limits: &Limits| {
        let mut files = files();
        files.iter_mut().find(|file| file.0 == name).unwrap().1 = bytes;
        let file = |name: &str| Ok(files.iter().find(|file| file.0 == name).unwrap().1.clone());
        parse_files(&files[0].1, file, limits)
    };
    let whole = parse(&sample(), &keep).unwrap();
    let damaged = || b"no picture".to_vec();
    assert!(read("p.webp", damaged(), &Limits::default()).is_err());
    let part = read("p.webp", damaged(), &keep).unwrap();
    assert!(part.notes[0].contains("harmonics are left out: SOG: p.webp"), "{:?}", part.notes);
    assert_eq!(part.epoch.attributes().sh_degree, ShDegree::ZERO);
    assert_eq!(part.epoch.attributes().positions, whole.epoch.attributes().positions);
    for (name, pixel) in [("q.webp", [128, 128, 128, 9]), ("n.webp", [7, 0, 0, 255])] {
        let bytes = || webp(3, 2, |i| if i == 4 { pixel } else { [0, 0, 0, 253] });
        assert!(read(name, bytes(), &Limits::default()).is_err(), "{name}");
        assert_eq!(read(name, bytes(), &keep).unwrap().epoch.count(), 5, "{name}");
    }
    assert!(read("q.webp", damaged(), &keep).is_err(), "every Gaussian needs one");
}

#[test]
fn metadata_is_read_up_to_a_bound() {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("meta.json", zip::write::SimpleFileOptions::default()).unwrap();
    zip.write_all(&vec![b' '; META_BYTES as usize + 1]).unwrap();
    let bomb = zip.finish().unwrap().into_inner();
    assert!(bomb.len() < 10_000);
    let error = parse(&bomb, &Limits::default()).unwrap_err();
    assert_eq!(error.kind, ErrorKind::TooLarge, "{error}");
    assert!(error.to_string().contains("meta.json: found more bytes; allowed: up to 1048576"), "{error}");
    let spaces = vec![b' '; META_BYTES as usize + 1];
    let error = parse_files(&spaces, |_| Ok(Vec::new()), &Limits::default()).unwrap_err();
    assert_eq!(error.kind, ErrorKind::TooLarge, "{error}");
}

#[test]
fn names_that_leave_the_folder_are_refused() {
    let meta = br#"{"version":2,"count":1,"means":{"mins":[0,0,0],"maxs":[0,0,0],"files":["../a"]},
        "scales":{"codebook":[],"files":[]},"quats":{"files":[]},"sh0":{"codebook":[],"files":[]}}"#;
    let error = parse_files(meta, |_| Ok(Vec::new()), &Limits::default()).unwrap_err();
    assert!(error.to_string().contains("plain file name"), "{error}");
}
