//! Reads SPZ, versions 1 to 4: planes of quantised attributes, compressed.
//!
//! Versions 1 to 3 are one gzip stream of a 16-byte header and six planes, in the order positions,
//! alphas, colours, scales, rotations, harmonics. Version 4 has a plain 32-byte header, optional
//! extension records, a table of (compressed, uncompressed) lengths, and one zstd stream per plane:
//!
//! ```text
//! 4e 47 53 50 | 04 00 00 00 | count u32 | degree fraction flags streams | toc u32 | 12 reserved
//! ```
//!
//! Sizes of all planes follow from the header and are checked against the bytes at hand before anything is
//! allocated. The file's axes (right, up, back by the format's rule: right-handed) are kept; a PLY of the
//! same scene usually is half a turn about x away, `(x, -y, -z)`. A degree above 3 is cut to 3. Absent:
//! extension records, which are skipped.

use std::io::Read;

use codec_core::{Footprint, ShDegree};
use flate2::read::GzDecoder;
use half::f16;

use super::{
    Limits,
    bytes::{array, u16_at, u32_at, u64_at},
    error::{ErrorKind, Format, ImportError},
    snapshot::{Columns, Snapshot, logit, smallest_three},
};

const FORMAT: Format = Format::Spz;
pub(crate) const MAGIC: [u8; 4] = *b"NGSP";
/// Deflate cannot expand a byte to more than 1032.
const DEFLATE_RATIO: u64 = 1032;
/// Display colour of one unit of `sh0` in the colour plane.
pub(crate) const COLOUR_SCALE: f32 = 0.15;
/// Natural log of the smallest scale, and of the ratio of one scale to the next larger.
pub(crate) const LEAST_LOG_SCALE: f32 = -10.0;
pub(crate) const LOG_SCALE_STEP: f32 = 1.0 / 16.0;

const AXES: &str = "axes are as stored, right-up-back by the format's rule: half a turn about x from PLY's";

/// The header fields all versions share.
#[derive(Clone, Copy, Debug)]
struct Header {
    version: u32,
    count: usize,
    degree: u8,
    fraction_bits: u8,
    flags: u8,
}

/// The six planes, decompressed.
struct Planes {
    positions: Vec<u8>,
    alphas: Vec<u8>,
    colours: Vec<u8>,
    scales: Vec<u8>,
    rotations: Vec<u8>,
    harmonics: Vec<u8>,
}

/// Reads an SPZ file of any version.
///
/// # Errors
/// A bad header, planes of the wrong length, a damaged stream, or more than `limits` allow.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Snapshot, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    let (header, planes, mut notes) = if bytes.starts_with(&MAGIC) {
        version_4(bytes, limits)?
    } else if bytes.starts_with(&[0x1f, 0x8b]) {
        gzipped(bytes, limits)?
    } else {
        return Err(FORMAT.malformed("magic", "other bytes", "NGSP or a gzip stream").at(0));
    };
    notes.push(AXES.to_owned());
    if header.flags & 1 != 0 {
        notes.push("trained with antialiasing: drawn with footprint compensated".to_owned());
    }
    if header.degree > 3 {
        notes.push("harmonics of degree 4 are cut to degree 3".to_owned());
    }
    let footprint = (header.flags & 1 != 0).then_some(Footprint::Compensated);
    let (whole, with_harmonics) = planes.whole(&header);
    if whole < header.count {
        notes
            .push(format!("of {} Gaussians the first {whole} are whole; the rest is left out", header.count));
    }
    if with_harmonics < whole {
        notes.push(format!("{} Gaussians lack harmonics, which are left out", whole - with_harmonics));
    }
    if whole == 0 {
        let allowed = "the planes of positions to rotations, which every Gaussian needs";
        return Err(FORMAT.malformed("planes", "no Gaussian that is whole", allowed));
    }
    let snapshot = read(&header, &planes, whole).finish(FORMAT, limits, notes)?;
    Ok(Snapshot { footprint, ..snapshot })
}

impl Header {
    fn parse(bytes: &[u8], limits: &Limits) -> Result<Self, ImportError> {
        let short = || FORMAT.truncated("header", bytes.len() as u64, 16);
        let raw: [u8; 16] = array(bytes, 0).ok_or_else(short)?;
        if raw[..4] != MAGIC {
            return Err(FORMAT.malformed("magic", format_args!("{:02x?}", &raw[..4]), "NGSP").at(0));
        }
        let version = u32_at(&raw, 4).ok_or_else(short)?;
        if !(1..=4).contains(&version) {
            return Err(FORMAT.unsupported("version", version, "1 to 4").at(4));
        }
        let declared = u32_at(&raw, 8).ok_or_else(short)?;
        let count = limits.gaussians(FORMAT, u64::from(declared)).map_err(|e| e.at(8))?;
        let [degree, fraction_bits, flags, _] = [raw[12], raw[13], raw[14], raw[15]];
        if degree > 4 {
            return Err(FORMAT.malformed("harmonic degree", degree, "0 to 4").at(12));
        }
        if fraction_bits > 24 {
            return Err(FORMAT.malformed("fractional bits", fraction_bits, "0 to 24").at(13));
        }
        Ok(Self { version, count, degree, fraction_bits, flags })
    }

    /// Bytes of each plane.
    fn sizes(&self) -> [u64; 6] {
        self.widths().map(|width| width as u64 * self.count as u64)
    }

    /// Bytes of a Gaussian in each plane.
    fn widths(&self) -> [usize; 6] {
        let degree = usize::from(self.degree);
        let position = if self.version == 1 { 6 } else { 9 };
        let rotation = if self.version >= 3 { 4 } else { 3 };
        [position, 1, 3, 3, rotation, ((degree + 1) * (degree + 1) - 1) * 3]
    }
}

impl Planes {
    /// How many Gaussians are in all planes but that of harmonics, and how many of those in that one too.
    fn whole(&self, header: &Header) -> (usize, usize) {
        let Self { positions, alphas, colours, scales, rotations, harmonics } = self;
        let [others @ .., width] = header.widths();
        let lengths = [positions, alphas, colours, scales, rotations].map(Vec::len);
        let whole = lengths.into_iter().zip(others).map(|(length, width)| length / width).min().unwrap_or(0);
        (whole, harmonics.len().checked_div(width).map_or(whole, |count| count.min(whole)))
    }
}

fn gzipped(bytes: &[u8], limits: &Limits) -> Result<(Header, Planes, Vec<String>), ImportError> {
    let mut stream = GzDecoder::new(bytes);
    let mut head = [0; 16];
    stream
        .read_exact(&mut head)
        .map_err(|e| FORMAT.malformed("gzip stream", e, "a gzip stream with a 16-byte header"))?;
    let header = Header::parse(&head, limits)?;
    if header.version > 3 {
        return Err(FORMAT.malformed("version", header.version, "1 to 3 inside gzip").at(4));
    }
    let sizes = header.sizes();
    let total: u64 = sizes.iter().sum();
    limits.bytes(FORMAT, "planes", total)?;
    if total > (bytes.len() as u64).saturating_mul(DEFLATE_RATIO) {
        let most = bytes.len() as u64 * DEFLATE_RATIO;
        return Err(FORMAT.error(
            ErrorKind::Truncated,
            "planes",
            format_args!("at most {most} bytes"),
            total,
        ));
    }
    let mut plane = |name: &str, size: u64| {
        let mut out = Vec::new();
        let read = (&mut stream).take(size).read_to_end(&mut out);
        if limits.keep_readable {
            return Ok(out);
        }
        read.map_err(|e| FORMAT.malformed(name, e, "an undamaged gzip stream"))?;
        if out.len() as u64 != size {
            return Err(FORMAT.truncated(name, out.len() as u64, size));
        }
        Ok(out)
    };
    let planes = Planes {
        positions: plane("positions", sizes[0])?,
        alphas: plane("alphas", sizes[1])?,
        colours: plane("colours", sizes[2])?,
        scales: plane("scales", sizes[3])?,
        rotations: plane("rotations", sizes[4])?,
        harmonics: plane("harmonics", sizes[5])?,
    };
    let mut notes = Vec::new();
    let mut tail = [0; 1];
    match stream.read(&mut tail) {
        Ok(0) => {}
        Ok(_) => notes.push("bytes after the planes (extensions) are ignored".to_owned()),
        Err(e) if limits.keep_readable => notes.push(format!("the gzip stream is damaged: {e}")),
        Err(e) => return Err(FORMAT.malformed("gzip trailer", e, "a checksum that agrees")),
    }
    Ok((header, planes, notes))
}

fn version_4(bytes: &[u8], limits: &Limits) -> Result<(Header, Planes, Vec<String>), ImportError> {
    let header = Header::parse(bytes, limits)?;
    if header.version != 4 {
        return Err(FORMAT.malformed("version", header.version, "4 outside gzip").at(4));
    }
    let short = |needed: usize| FORMAT.truncated("header", bytes.len() as u64, needed as u64);
    let streams = usize::from(bytes.get(15).copied().ok_or_else(|| short(32))?);
    let table = u32_at(bytes, 16).ok_or_else(|| short(32))? as usize;
    let expected = header.sizes();
    let wanted = if expected[5] > 0 { 6 } else { 5 };
    if !(wanted..=6).contains(&streams) {
        return Err(FORMAT.malformed("streams", streams, format_args!("{wanted} planes")).at(15));
    }
    if table < 32 {
        return Err(FORMAT.malformed("table offset", table, "32 or more").at(16));
    }
    limits.bytes(FORMAT, "planes", expected.iter().sum())?;
    let mut planes: [Vec<u8>; 6] = Default::default();
    let mut offset = table + streams * 16;
    for (index, plane) in planes.iter_mut().take(streams).enumerate() {
        let name = ["positions", "alphas", "colours", "scales", "rotations", "harmonics"][index];
        let entry = table + index * 16;
        let truncated =
            || FORMAT.truncated("stream table", bytes.len() as u64, (entry + 16) as u64).at(entry);
        let compressed = u64_at(bytes, entry).ok_or_else(truncated)?;
        let length = u64_at(bytes, entry + 8).ok_or_else(truncated)?;
        if length != expected[index] {
            return Err(FORMAT
                .malformed(name, length, format_args!("{} bytes", expected[index]))
                .at(entry + 8));
        }
        let data = usize::try_from(compressed)
            .ok()
            .and_then(|c| bytes.get(offset..offset.checked_add(c)?))
            .or_else(|| bytes.get(offset..).filter(|_| limits.keep_readable))
            .ok_or_else(|| {
                let left = bytes.len().saturating_sub(offset);
                FORMAT.truncated(name, left as u64, compressed).at(offset)
            })?;
        *plane = inflate_zstd(name, data, length, limits.keep_readable).map_err(|e| e.at(offset))?;
        offset += data.len();
    }
    let [positions, alphas, colours, scales, rotations, harmonics] = planes;
    Ok((header, Planes { positions, alphas, colours, scales, rotations, harmonics }, Vec::new()))
}

/// The bytes of a plane; with `keeps` those before what is damaged.
fn inflate_zstd(name: &str, data: &[u8], length: u64, keeps: bool) -> Result<Vec<u8>, ImportError> {
    let damaged = |e: std::io::Error| FORMAT.malformed(name, e, "an undamaged zstd stream");
    if length == 0 || (keeps && data.is_empty()) {
        return Ok(Vec::new());
    }
    let mut out = Vec::new();
    let mut decoder = zstd::stream::read::Decoder::new(data).map_err(damaged)?;
    // A window larger than the limits on a plane is of no use and costs memory.
    decoder.window_log_max(27).map_err(damaged)?;
    let read = decoder.take(length + 1).read_to_end(&mut out);
    if keeps {
        out.truncate(usize::try_from(length).unwrap_or(usize::MAX));
        return Ok(out);
    }
    read.map_err(damaged)?;
    if out.len() as u64 != length {
        return Err(FORMAT.truncated(name, out.len() as u64, length));
    }
    Ok(out)
}

/// The first `count` Gaussians, of which the planes hold as many.
fn read(header: &Header, planes: &Planes, count: usize) -> Columns {
    let degree = ShDegree::new(header.degree.min(3)).unwrap_or(ShDegree::MAX);
    let stored = header.widths()[5];
    let mut c = Columns::with_capacity(count, degree);
    if header.version == 1 {
        let half = |at: &[u8], axis: usize| f16::from_bits(u16_at(at, axis * 2).unwrap_or(0)).to_f32();
        c.positions.extend(
            planes.positions.chunks_exact(6).take(count).map(|p| [half(p, 0), half(p, 1), half(p, 2)]),
        );
    } else {
        let step = 1.0 / (1u32 << header.fraction_bits) as f32;
        let fixed = |b: &[u8]| (i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) as f32 * step;
        let points = planes.positions.chunks_exact(9).take(count);
        c.positions.extend(points.map(|p| [fixed(&p[..3]), fixed(&p[3..6]), fixed(&p[6..])]));
    }
    c.opacity_logits.extend(planes.alphas.iter().take(count).map(|&a| logit(f32::from(a) / 255.0)));
    let colour = |u: u8| (f32::from(u) / 255.0 - 0.5) / COLOUR_SCALE;
    c.sh0.extend(
        planes.colours.chunks_exact(3).take(count).map(|v| [colour(v[0]), colour(v[1]), colour(v[2])]),
    );
    let scale = |u: u8| f32::from(u) * LOG_SCALE_STEP + LEAST_LOG_SCALE;
    c.log_scales
        .extend(planes.scales.chunks_exact(3).take(count).map(|v| [scale(v[0]), scale(v[1]), scale(v[2])]));
    if header.version >= 3 {
        let words = planes.rotations.chunks_exact(4).take(count);
        c.rotations.extend(words.map(|b| unpack_rotation(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))));
    } else {
        c.rotations.extend(
            planes
                .rotations
                .chunks_exact(3)
                .take(count)
                .map(|b| smallest_three([b[0], b[1], b[2]].map(|u| f32::from(u) / 127.5 - 1.0), 0)),
        );
    }
    if stored > 0 {
        for values in planes.harmonics.chunks_exact(stored).take(count) {
            c.sh_rest.extend(values[..degree.rest_len()].iter().map(|&u| (f32::from(u) - 128.0) / 128.0));
        }
        c.sh_rest.resize(count * degree.rest_len(), 0.0);
    }
    c
}

/// Top two bits name the largest of x, y, z, w; the others are sign and nine bits of magnitude over
/// `1/√2`, the last of them lowest. Returned as wxyz.
fn unpack_rotation(word: u32) -> [f32; 4] {
    let component = |field: u32| {
        let magnitude = (field & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        if field & 512 != 0 { -magnitude } else { magnitude }
    };
    let three = [word >> 20, word >> 10, word].map(component);
    let [x, y, z, w] = smallest_three(three, (word >> 30) as usize);
    [w, x, y, z]
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::io::Write;

    /// Two Gaussians in the layout of `version` 1 to 3, gzipped.
    pub fn sample(version: u32) -> Vec<u8> {
        let mut raw = MAGIC.to_vec();
        raw.extend(version.to_le_bytes());
        raw.extend(2u32.to_le_bytes());
        raw.extend([1, 12, 1, 0]);
        for v in [1.0f32, -0.5, 2.0, 0.25, 0.0, -3.0] {
            if version == 1 {
                raw.extend(f16::from_f32(v).to_le_bytes());
            } else {
                raw.extend(&((v * 4096.0) as i32).to_le_bytes()[..3]);
            }
        }
        raw.extend([255, 51]);
        raw.extend([128, 0, 255, 10, 20, 30]);
        raw.extend([160, 96, 0, 128, 128, 128]);
        if version == 3 {
            raw.extend((3u32 << 30 | 511 << 20).to_le_bytes());
            raw.extend((1u32 << 30 | 512).to_le_bytes());
        } else {
            raw.extend([255, 128, 128, 128, 128, 128]);
        }
        raw.extend((0..18).map(|i| 120 + i));
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(&raw).unwrap();
        gzip.finish().unwrap()
    }

    #[test]
    fn gzip_versions_read() {
        for version in 1..=3 {
            let s = parse(&sample(version), &Limits::default()).unwrap();
            let a = s.epoch.attributes();
            assert_eq!(a.positions.frame(0, 2), [[1.0, -0.5, 2.0], [0.25, 0.0, -3.0]], "version {version}");
            assert_eq!(a.log_scales.frame(0, 2)[0], [0.0, -4.0, -10.0]);
            assert!((a.opacity_logits.frame(0, 2)[1] - logit(0.2)).abs() < 1e-6);
            assert_eq!(a.sh_rest[..4], [-8.0 / 128.0, -7.0 / 128.0, -6.0 / 128.0, -5.0 / 128.0]);
            let q = a.rotations.frame(0, 2)[0];
            let expected = if version == 3 { std::f32::consts::FRAC_1_SQRT_2 } else { 1.0 };
            assert!((q[1] - expected).abs() < 1e-2, "version {version}: {q:?}");
            assert!(s.notes[1].contains("antialiasing"), "{:?}", s.notes);
            assert_eq!(s.footprint, Some(Footprint::Compensated));
        }
    }

    #[test]
    fn what_is_whole_is_read() {
        let (plain, keep) = (Limits::default(), Limits { keep_readable: true, ..Limits::default() });
        let epoch = crate::scene::export::tests::epoch(500, 3);
        let whole = crate::scene::export::spz::encode(&epoch, 0, &Default::default()).unwrap();
        let read = parse(&whole, &keep).unwrap();
        assert_eq!(read, parse(&whole, &plain).unwrap(), "nothing is damaged");
        let mut counts = Vec::new();
        for share in [99, 60, 20] {
            let cut = &whole[..whole.len() * share / 100];
            assert!(parse(cut, &plain).is_err());
            let Ok(part) = parse(cut, &keep) else { continue };
            let (a, b) = (part.epoch.attributes(), read.epoch.attributes());
            let n = part.epoch.count();
            assert_eq!(a.positions.frame(0, n), &b.positions.frame(0, 500)[..n]);
            assert_eq!(a.rotations.frame(0, n), &b.rotations.frame(0, 500)[..n]);
            assert_eq!(a.sh_rest[..45], b.sh_rest[..45], "{share} %");
            assert!(a.sh_rest.ends_with(&[0.0; 45]), "{share} %");
            assert!(part.notes.iter().any(|note| note.contains("lack harmonics")), "{:?}", part.notes);
            counts.push(n);
        }
        assert_eq!(counts, [500, 500], "of the first fifth not one is whole");
        let mut trailer = sample(3);
        let at = trailer.len() - 8;
        trailer[at] ^= 1;
        assert!(parse(&trailer, &plain).is_err());
        assert!(parse(&trailer, &keep).unwrap().notes[0].contains("gzip stream is damaged"));
    }

    #[test]
    fn a_count_no_stream_of_this_length_can_hold_is_refused() {
        let mut raw = MAGIC.to_vec();
        raw.extend(3u32.to_le_bytes());
        raw.extend(10_000_000u32.to_le_bytes());
        raw.extend([3, 12, 0, 0]);
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(&raw).unwrap();
        let error = parse(&gzip.finish().unwrap(), &Limits::default()).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Truncated, "{error}");
    }

    #[test]
    fn version_4_lengths_that_contradict_the_count_are_refused() {
        let mut raw = MAGIC.to_vec();
        raw.extend(4u32.to_le_bytes());
        raw.extend(7u32.to_le_bytes());
        raw.extend([0, 12, 0, 5]);
        raw.extend(32u32.to_le_bytes());
        raw.extend([0; 12]);
        raw.extend(20u64.to_le_bytes());
        raw.extend(62u64.to_le_bytes());
        let error = parse(&raw, &Limits::default()).unwrap_err();
        assert!(error.to_string().contains("positions at byte 40: found 62; allowed: 63"), "{error}");
    }
}
