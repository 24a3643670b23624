//! Tests videos: the boxes and elements that are written, and what an independent decoder shows of them.

use std::{
    fs,
    io::Cursor,
    path::Path,
    process::{Command, Stdio},
};

use render_host::{Image, metric};

use crate::{
    Container, Video,
    planes::{self, Planes},
};

const PICTURES: usize = 12;
const SIZE: (u32, u32) = (160, 95);

/// Discs that move over a gradient.
fn clip() -> Vec<Image> {
    (0..PICTURES).map(|picture| moving(picture as f32)).collect()
}

fn moving(time: f32) -> Image {
    let discs = [([40.0, 30.0], [4.0, 1.0], [0.9, 0.2, 0.1]), ([110.0, 60.0], [-3.0, -2.0], [0.1, 0.5, 0.9])];
    let mut rgb = Vec::new();
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (x, y) = (x as f32, y as f32);
            let mut colour = [x / 320.0, y / 190.0, 0.3];
            for (centre, velocity, own) in discs {
                let (dx, dy) = (x - centre[0] - velocity[0] * time, y - centre[1] - velocity[1] * time);
                let weight = (-(dx * dx + dy * dy) / 300.0).exp();
                (0..3).for_each(|c| colour[c] += weight * (own[c] - colour[c]));
            }
            rgb.extend(colour);
        }
    }
    Image::new(SIZE.0, SIZE.1, rgb).unwrap()
}

fn encode(pictures: &[Image], container: Container, rate: f64) -> Vec<u8> {
    let file = Cursor::new(Vec::new());
    let size = pictures[0].size();
    let mut video = Video::begin(file, container, size, rate, pictures.len()).unwrap();
    pictures.iter().for_each(|picture| video.add(picture).unwrap());
    video.finish().unwrap().into_inner()
}

fn number(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |value, byte| value << 8 | u64::from(*byte))
}

/// The bodies of all boxes at the end of `path`, each with where its body begins in `bytes`.
fn boxes<'a>(bytes: &'a [u8], path: &[&[u8; 4]]) -> Vec<(usize, &'a [u8])> {
    let Some((name, below)) = path.split_first() else { return vec![(0, bytes)] };
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let (mut size, mut head) = (number(&bytes[at..at + 4]) as usize, 8);
        if size == 1 {
            (size, head) = (number(&bytes[at + 8..at + 16]) as usize, 16);
        }
        let body = &bytes[at + head..at + size];
        if bytes[at + 4..at + 8] == name[..] {
            // What stands before the boxes inside: of a list of entries, and of an entry of video.
            let fields = match *name {
                b"stsd" => 8,
                b"av01" => 78,
                _ => 0,
            };
            let inner = boxes(&body[if below.is_empty() { 0 } else { fields }..], below);
            let fields = if below.is_empty() { 0 } else { fields };
            found.extend(inner.into_iter().map(|(start, body)| (at + head + fields + start, body)));
        }
        at += size;
    }
    assert_eq!(at, bytes.len(), "boxes fill what they stand in");
    found
}

/// The bodies of all elements at the end of `path`, each with where its identifier begins in `bytes`.
fn elements<'a>(bytes: &'a [u8], path: &[u32]) -> Vec<(usize, &'a [u8])> {
    let Some((id, below)) = path.split_first() else { return vec![(0, bytes)] };
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let id_width = 1 + bytes[at].leading_zeros() as usize;
        let start = at + id_width;
        let size_width = 1 + bytes[start].leading_zeros() as usize;
        let size = number(&bytes[start..start + size_width]) & ((1 << (7 * size_width)) - 1);
        let body = start + size_width;
        let end = body + size as usize;
        if number(&bytes[at..start]) == u64::from(*id) {
            if below.is_empty() {
                found.push((at, &bytes[body..end]));
            } else {
                let inner = elements(&bytes[body..end], below);
                found.extend(inner.into_iter().map(|(at, bytes)| (body + at, bytes)));
            }
        }
        at = end;
    }
    assert_eq!(at, bytes.len(), "elements fill what they stand in");
    found
}

fn words(bytes: &[u8]) -> Vec<u64> {
    bytes.chunks(4).map(number).collect()
}

#[test]
fn the_boxes_of_an_mp4_say_what_is_in_it() {
    let rate = 30_000.0 / 1001.0;
    let file = encode(&clip(), Container::Mp4, rate);
    let top: Vec<&[u8]> = {
        let mut at = 0;
        std::iter::from_fn(|| {
            let head = file.get(at..at + 16)?;
            let size = number(&head[..4]);
            at += if size == 1 { number(&head[8..]) } else { size } as usize;
            Some(&head[4..8])
        })
        .collect()
    };
    assert_eq!(top, [b"ftyp", b"moov", b"free", b"mdat"], "what players need first stands first");
    let ftyp = boxes(&file, &[b"ftyp"])[0].1;
    assert!(ftyp.chunks(4).any(|brand| brand == b"av01"));
    let media: [&[u8; 4]; 3] = [b"moov", b"trak", b"mdia"];
    let one = |path: &[&[u8; 4]]| boxes(&file, &[&media, path].concat())[0].1;
    let mdhd = one(&[b"mdhd"]);
    let (timescale, duration) = match mdhd[0] {
        1 => (number(&mdhd[20..24]), number(&mdhd[24..32])),
        _ => (number(&mdhd[12..16]), number(&mdhd[16..20])),
    };
    assert_eq!((timescale, duration), (30_000, 12 * 1001));
    let table: [&[u8; 4]; 2] = [b"minf", b"stbl"];
    let table = |name: &[u8; 4]| words(one(&[table[0], table[1], name]));
    assert_eq!(table(b"stts"), [0, 1, 12, 1001], "twelve pictures of one length");
    let sizes = table(b"stsz");
    assert_eq!(sizes[1..3], [0, 12]);
    assert_eq!(table(b"stss")[1..], [1, 1], "the first is the only key picture");
    // All samples stand one after the other in the only chunk, which is all of mdat.
    let (mdat, bytes) = boxes(&file, &[b"mdat"])[0];
    assert_eq!(table(b"stco")[1..], [1, mdat as u64]);
    assert_eq!(sizes[3..].iter().sum::<u64>(), bytes.len() as u64);
    assert_eq!(bytes[0], 0x0a, "the first sample begins with a sequence header");
    let entry = [table_path(), &[b"stsd", b"av01"]].concat();
    let visual = one(&entry);
    assert_eq!((number(&visual[24..26]), number(&visual[26..28])), (160, 96), "an odd side is padded");
    let config = one(&[&entry[..], &[b"av1C"]].concat());
    assert_eq!(config[0], 0x81);
    assert!(bytes.starts_with(&config[4..]), "the sequence header is that of the stream");
    let colour = one(&[&entry[..], &[b"colr"]].concat());
    assert_eq!(colour, b"nclx\0\x01\0\x01\0\x01\0", "BT.709 in limited range");
}

fn table_path() -> &'static [&'static [u8; 4]] {
    &[b"minf", b"stbl"]
}

#[test]
fn the_elements_of_a_webm_say_what_is_in_it() {
    const SEGMENT: u32 = 0x1853_8067;
    let rate = 5.0;
    let file = encode(&clip(), Container::WebM, rate);
    let one = |path: &[u32]| elements(&file, &[&[SEGMENT], path].concat())[0].1;
    assert_eq!(elements(&file, &[0x1A45_DFA3, 0x4282])[0].1, b"webm");
    assert_eq!(one(&[0x1549_A966, 0x2A_D7B1]), &1_000_000u32.to_be_bytes()[1..], "milliseconds");
    assert_eq!(one(&[0x1549_A966, 0x4489]), 2400f64.to_be_bytes());
    let track = [0x1654_AE6B, 0xAE];
    let of_track = |path: &[u32]| one(&[&track, path].concat());
    assert_eq!(of_track(&[0x86]), b"V_AV1");
    assert_eq!(number(of_track(&[0x23_E383])), 200_000_000);
    assert_eq!((number(of_track(&[0xE0, 0xB0])), number(of_track(&[0xE0, 0xBA]))), (160, 96));
    let colour = [0x55B1, 0x55B9, 0x55BA, 0x55BB].map(|id| number(of_track(&[0xE0, 0x55B0, id])));
    assert_eq!(colour, [1; 4], "BT.709 in limited range");
    // Ten pictures are two seconds: the eleventh is a key picture and begins a cluster.
    let clusters = elements(&file, &[SEGMENT, 0x1F43_B675]);
    assert_eq!(clusters.len(), 2);
    let blocks = |cluster: &[u8]| {
        let start = number(elements(cluster, &[0xE7])[0].1);
        let blocks = elements(cluster, &[0xA3]);
        blocks.iter().map(|(_, block)| (start + number(&block[1..3]), block[3])).collect::<Vec<_>>()
    };
    let times: Vec<(u64, u8)> = clusters.iter().flat_map(|(_, cluster)| blocks(cluster)).collect();
    let wanted = (0..12).map(|i| (200 * i, if i % 10 == 0 { 0x80 } else { 0 }));
    assert_eq!(times, wanted.collect::<Vec<_>>());
    let first = elements(clusters[0].1, &[0xA3])[0].1;
    assert!(first[4..].starts_with(&of_track(&[0x63A2])[4..]), "the sequence header is that of the stream");
    // Places count from the first byte inside the segment.
    let inside = elements(&file, &[SEGMENT, 0x114D_9B74])[0].0;
    let cue = [0x1C53_BB6B, 0xBB];
    let cues = |path: &[u32]| {
        let found = elements(&file, &[&[SEGMENT], &cue[..], path].concat());
        found.iter().map(|(_, body)| number(body)).collect::<Vec<_>>()
    };
    assert_eq!(cues(&[0xB3]), [0, 2000]);
    let places: Vec<u64> = clusters.iter().map(|(at, _)| (at - inside) as u64).collect();
    assert_eq!(cues(&[0xB7, 0xF1]), places);
    let seek = |id: &[u8]| {
        let found = elements(&file, &[SEGMENT, 0x114D_9B74, 0x4DBB]);
        let (_, seek) = found.iter().find(|(_, seek)| elements(seek, &[0x53AB])[0].1 == id).unwrap();
        number(elements(seek, &[0x53AC])[0].1) as usize + inside
    };
    for id in [0x1549_A966u32, 0x1654_AE6B, 0x1C53_BB6B] {
        assert_eq!(seek(&id.to_be_bytes()), elements(&file, &[SEGMENT, id])[0].0, "{id:#x}");
    }
}

/// Bytes of pictures that come faster than milliseconds differ in their times.
#[test]
fn times_of_a_fast_webm_differ() {
    let pictures: Vec<Image> = (0..4).map(|_| Image::filled(16, 16, [0.5; 3]).unwrap()).collect();
    let file = encode(&pictures, Container::WebM, 10_000.0);
    let blocks = elements(&file, &[0x1853_8067, 0x1F43_B675, 0xA3]);
    let times: Vec<u64> = blocks.iter().map(|(_, block)| number(&block[1..3])).collect();
    assert_eq!(times, [0, 10, 20, 30]);
}

/// A picture of copies of `picture`.
fn tiled(picture: &Image, width: u32, height: u32) -> Image {
    let (wide, high) = picture.size();
    let pixel = |i: u32| picture.pixel(i % width % wide, i / width % high).unwrap();
    Image::new(width, height, (0..width * height).flat_map(pixel).collect()).unwrap()
}

#[test]
fn the_same_pictures_are_the_same_bytes_on_any_number_of_threads() {
    // Large enough for several tiles.
    let pictures: Vec<Image> = clip().iter().map(|picture| tiled(picture, 512, 320)).collect();
    let encoded = [1, 4].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| encode(&pictures[..3], Container::Mp4, 30.0))
    });
    assert!(encoded[0] == encoded[1], "one thread and four");
    assert!(encode(&pictures[1..4], Container::Mp4, 30.0) != encoded[0], "other pictures are other bytes");
}

#[test]
fn what_cannot_be_a_video_is_refused() {
    let begin = |size, rate| Video::begin(Cursor::new(Vec::new()), Container::Mp4, size, rate, 1);
    for (size, rate, says) in [
        ((14, 64), 30.0, "found 14 × 64 pixels; sides of 15"),
        ((64, 0), 30.0, "64 × 0"),
        ((64, 64), 0.0, "frames per second: found 0"),
        ((64, 64), f64::NAN, "frames per second"),
    ] {
        let error = begin(size, rate).err().unwrap().to_string();
        assert!(error.contains(says), "{error}");
    }
    let error = begin((64, 64), 30.0).unwrap().finish().err().unwrap().to_string();
    assert!(error.contains("no pictures"), "{error}");
    let mut video = begin((64, 64), 30.0).unwrap();
    let error = video.add(&Image::filled(64, 66, [0.0; 3]).unwrap()).unwrap_err().to_string();
    assert!(error.contains("64 × 66") && error.contains("64 × 64"), "{error}");
}

/// What an installed ffmpeg decodes of `file`; none without one that can.
fn decoded(file: &Path, size: (usize, usize)) -> Option<Vec<Planes>> {
    let decoders = Command::new("ffmpeg").args(["-hide_banner", "-decoders"]).stdin(Stdio::null()).output();
    let decoders = decoders.map(|listed| String::from_utf8_lossy(&listed.stdout).into_owned());
    let decoder = ["libdav1d", "libaom-av1"];
    let decoder = decoder.into_iter().find(|name| decoders.as_ref().is_ok_and(|list| list.contains(name)))?;
    let output = Command::new("ffmpeg")
        .args(["-hide_banner", "-loglevel", "error", "-c:v", decoder, "-i"])
        .arg(file)
        .args(["-f", "rawvideo", "-"])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
    let (luma, chroma) = (size.0 * size.1, size.0 * size.1 / 4);
    let pictures = output.stdout.chunks(luma + 2 * chroma).map(|picture| Planes {
        size,
        luma: picture[..luma].to_vec(),
        blue: picture[luma..luma + chroma].to_vec(),
        red: picture[luma + chroma..].to_vec(),
    });
    Some(pictures.collect())
}

#[test]
fn another_decoder_shows_the_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let clip = clip();
    for (name, container) in [("a.mp4", Container::Mp4), ("a.webm", Container::WebM)] {
        let path = folder.path().join(name);
        fs::write(&path, encode(&clip, container, 30.0)).unwrap();
        let Some(found) = decoded(&path, planes::even(SIZE)) else {
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "ffmpeg with AV1 is missing");
            eprintln!("skipped: no ffmpeg that decodes AV1 is installed");
            return;
        };
        assert_eq!(found.len(), PICTURES, "{name}");
        let shown: Vec<Image> = found.iter().map(|picture| planes::tests::shown(picture, SIZE)).collect();
        let psnr = |shown: &Image, picture: &Image| metric::psnr(shown, picture).unwrap();
        for (index, (shown, picture)) in shown.iter().zip(&clip).enumerate() {
            let db = psnr(shown, picture);
            assert!(db >= 35.0, "{name}, picture {index}: {db:.1} dB");
        }
        // The comparison can fail: pictures in another order are seen.
        let swapped = psnr(&shown[0], &clip[PICTURES - 1]).max(psnr(&shown[PICTURES - 1], &clip[0]));
        assert!(swapped < 30.0, "{name}: {swapped:.1} dB");
    }
}
