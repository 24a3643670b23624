//! Reads the cameras of COLMAP: `cameras` and `images`, binary (`.bin`) or text (`.txt`).
//!
//! Binary is little-endian. `cameras.bin`: u64 count, then per camera u32 id, i32 model, u64 width, u64
//! height and the model's f64 parameters. `images.bin`: u64 count, then per image u32 id, four f64 quaternion
//! (wxyz, world to camera), three f64 translation, u32 camera id, a name ending in 0, u64 number of points
//! and 24 bytes for each point, which we step over. Text holds the same, a line per camera and two per image.
//!
//! COLMAP centres pixels at halves, as we do. Lenses that distort are refused by name: COLMAP's own
//! undistorter makes pinhole images of them. Counts are checked against the bytes that are left before
//! anything is stored, so memory is bounded by the length of the input.

mod model;
mod text;

use std::collections::BTreeMap;

use self::model::{MAX_PARAMETERS, MODELS, MODELS_ALLOWED, view};
use super::{CameraError, Intrinsics, View};

/// Smallest record of each file, bytes.
const CAMERA_BYTES: u64 = 4 + 4 + 8 + 8 + 3 * 8;
const IMAGE_BYTES: u64 = 4 + 7 * 8 + 4 + 1 + 8;
/// Longest image name, bytes.
const NAME_BYTES: usize = 4096;

/// Reads `cameras` and `images`, both binary or both text: the images in order of name, without times.
///
/// # Errors
/// Bytes that are short, a model we do not know or whose lens distorts, an image that names a camera that is
/// not there, a camera that cannot be rendered from, bytes left over. Each error says where.
pub fn read(cameras: &[u8], images: &[u8], format: Format) -> Result<Vec<View>, CameraError> {
    let [cameras_file, images_file] = match format {
        Format::Binary => ["cameras.bin", "images.bin"],
        Format::Text => ["cameras.txt", "images.txt"],
    };
    let cameras = match format {
        Format::Binary => read_cameras(cameras),
        Format::Text => text::read_cameras(cameras),
    };
    let cameras = cameras.map_err(|error| error.of(cameras_file))?;
    let views = match format {
        Format::Binary => read_images(images, &cameras),
        Format::Text => text::read_images(images, &cameras),
    };
    let mut views = views.map_err(|error| error.of(images_file))?;
    views.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(views)
}

/// How COLMAP wrote a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `cameras.bin` and `images.bin`.
    Binary,
    /// `cameras.txt` and `images.txt`.
    Text,
}

fn read_cameras(bytes: &[u8]) -> Result<BTreeMap<u32, Intrinsics>, CameraError> {
    let mut cursor = Cursor { bytes, at: 0 };
    let count = cursor.count("number of cameras", CAMERA_BYTES)?;
    let mut cameras = BTreeMap::new();
    for _ in 0..count {
        let start = cursor.at;
        let id = cursor.u32("camera id")?;
        let at = cursor.at;
        let number = cursor.u32("camera model")?;
        let Some(model) = MODELS.get(number as usize) else {
            let (field, found) = ("camera model", u64::from(number));
            return Err(CameraError::Field { field, offset: at, found, allowed: MODELS_ALLOWED });
        };
        let size = (cursor.side("camera width")?, cursor.side("camera height")?);
        let (_, count) = model.counts(id)?;
        let mut parameters = [0.0; MAX_PARAMETERS];
        for parameter in &mut parameters[..count] {
            *parameter = cursor.f64("camera parameter")?;
        }
        if cameras.insert(id, model.intrinsics(id, size, &parameters)?).is_some() {
            let (field, found) = ("camera id", u64::from(id));
            let allowed = "an id that no camera before has";
            return Err(CameraError::Field { field, offset: start, found, allowed });
        }
    }
    cursor.finish()?;
    Ok(cameras)
}

fn read_images(bytes: &[u8], cameras: &BTreeMap<u32, Intrinsics>) -> Result<Vec<View>, CameraError> {
    let mut cursor = Cursor { bytes, at: 0 };
    let count = cursor.count("number of images", IMAGE_BYTES)?;
    let mut views = Vec::with_capacity(count);
    for _ in 0..count {
        cursor.u32("image id")?;
        let mut pose = [0.0; 7];
        for v in &mut pose {
            *v = cursor.f64("image pose")?;
        }
        let at = cursor.at;
        let id = cursor.u32("image's camera id")?;
        let name = cursor.name()?;
        let points = cursor.count("number of points", 24)?;
        cursor.take("points", 24 * points)?;
        let Some(intrinsics) = cameras.get(&id) else {
            let (field, found) = ("image's camera id", u64::from(id));
            let allowed = "an id from cameras.bin";
            return Err(CameraError::Field { field, offset: at, found, allowed }.of(&name));
        };
        views.push(view(name, pose, *intrinsics)?);
    }
    cursor.finish()?;
    Ok(views)
}

/// A place in the bytes; no method reads past the end.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, field: &'static str, n: usize) -> Result<&'a [u8], CameraError> {
        let left = &self.bytes[self.at..];
        let Some(taken) = left.get(..n) else {
            return Err(CameraError::Short { field, offset: self.at, found: left.len(), needed: n as u64 });
        };
        self.at += n;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], CameraError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(field, N)?);
        Ok(array)
    }

    fn u32(&mut self, field: &'static str) -> Result<u32, CameraError> {
        self.array(field).map(u32::from_le_bytes)
    }

    fn u64(&mut self, field: &'static str) -> Result<u64, CameraError> {
        self.array(field).map(u64::from_le_bytes)
    }

    fn f64(&mut self, field: &'static str) -> Result<f64, CameraError> {
        self.array(field).map(f64::from_le_bytes)
    }

    /// A u64 count of records of at least `record` bytes each, all of which must still be there.
    fn count(&mut self, field: &'static str, record: u64) -> Result<usize, CameraError> {
        let offset = self.at;
        let count = self.u64(field)?;
        let needed = count.saturating_mul(record);
        let found = self.bytes.len() - self.at;
        if needed > found as u64 {
            return Err(CameraError::Short { field, offset, found, needed });
        }
        Ok(count as usize)
    }

    fn side(&mut self, field: &'static str) -> Result<u32, CameraError> {
        let offset = self.at;
        let found = self.u64(field)?;
        match u32::try_from(found) {
            Ok(side) if (1..=super::MAX_SIDE).contains(&side) => Ok(side),
            _ => Err(CameraError::Field { field, offset, found, allowed: "1..=16384" }),
        }
    }

    fn name(&mut self) -> Result<String, CameraError> {
        let left = &self.bytes[self.at..];
        let window = &left[..left.len().min(NAME_BYTES + 1)];
        let Some(end) = window.iter().position(|&b| b == 0) else {
            let (field, found) = ("image name", window.len() as u64);
            let allowed = "a name of up to 4096 bytes that ends in 0";
            return Err(CameraError::Field { field, offset: self.at, found, allowed });
        };
        self.at += end + 1;
        Ok(String::from_utf8_lossy(&window[..end]).into_owned())
    }

    fn finish(&self) -> Result<(), CameraError> {
        let found = (self.bytes.len() - self.at) as u64;
        if found == 0 {
            return Ok(());
        }
        let (field, allowed) = ("number of bytes after the last record", "0");
        Err(CameraError::Field { field, offset: self.at, found, allowed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cameras_bin(model: u32, params: &[f64]) -> Vec<u8> {
        let mut b = 1u64.to_le_bytes().to_vec();
        b.extend(7u32.to_le_bytes());
        b.extend(model.to_le_bytes());
        b.extend(640u64.to_le_bytes());
        b.extend(480u64.to_le_bytes());
        params.iter().for_each(|p| b.extend(p.to_le_bytes()));
        b
    }

    fn images_bin(camera: u32, names: &[&str]) -> Vec<u8> {
        let mut b = (names.len() as u64).to_le_bytes().to_vec();
        for (i, name) in names.iter().enumerate() {
            b.extend((i as u32).to_le_bytes());
            [1.0f64, 0.0, 0.0, 0.0, 0.1, 0.2, 3.0].iter().for_each(|p| b.extend(p.to_le_bytes()));
            b.extend(camera.to_le_bytes());
            b.extend(name.as_bytes());
            b.push(0);
            b.extend(2u64.to_le_bytes());
            b.extend([0; 48]);
        }
        b
    }

    fn read(cameras: &[u8], images: &[u8]) -> Result<Vec<View>, CameraError> {
        super::read(cameras, images, Format::Binary)
    }

    #[test]
    fn every_model_without_distortion_becomes_a_pinhole() {
        let expected = [
            (0, vec![500.0, 320.0, 240.0]),
            (1, vec![500.0, 510.0, 320.0, 240.0]),
            (2, vec![500.0, 320.0, 240.0, 0.0]),
            (3, vec![500.0, 320.0, 240.0, 0.0, 0.0]),
            (4, vec![500.0, 510.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0]),
        ];
        for (model, params) in expected {
            let views = read(&cameras_bin(model, &params), &images_bin(7, &["b.png", "a.png"])).unwrap();
            let names: Vec<_> = views.iter().map(|v| v.name.as_str()).collect();
            assert_eq!(names, ["a.png", "b.png"]);
            let i = views[0].camera.intrinsics();
            let fy = if model == 1 || model == 4 { 510.0 } else { 500.0 };
            assert_eq!((i.fx, i.fy, i.cx, i.cy), (500.0, fy, 320.0, 240.0), "{model}");
            assert_eq!(views[0].camera.translation(), [0.1, 0.2, 3.0]);
        }
    }

    #[test]
    fn lenses_that_distort_are_refused_by_name() {
        let refused = |model: u32, params: &[f64]| {
            read(&cameras_bin(model, params), &images_bin(7, &["x"])).unwrap_err().to_string()
        };
        let error = refused(3, &[500.0, 320.0, 240.0, 0.1, -0.2]);
        assert!(error.contains("camera 7 has model RADIAL with distortion [0.1, -0.2]"), "{error}");
        let error = refused(4, &[500.0, 510.0, 320.0, 240.0, 0.0, 0.0, 0.0, 1e-3]);
        assert!(error.contains("OPENCV with distortion"), "{error}");
        let error = refused(5, &[0.0; 8]);
        assert!(error.contains("camera 7 has model OPENCV_FISHEYE; SIMPLE_PINHOLE"), "{error}");
        let error = refused(12, &[0.0; 8]);
        assert!(error.contains("camera model at byte 12 is 12"), "{error}");
    }

    #[test]
    fn errors_say_where() {
        let good = cameras_bin(0, &[500.0, 320.0, 240.0]);
        let check = |cameras: &[u8], images: &[u8], expected: &str| {
            let error = read(cameras, images).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        };
        let pinhole = cameras_bin(1, &[1.0; 4]);
        check(&pinhole[..60], &[], "camera parameter at byte 56: 4 bytes left, 8 needed");
        check(&good[..50], &[], "number of cameras at byte 0: 42 bytes left, 48 needed");
        check(&u64::MAX.to_le_bytes(), &[], "number of cameras at byte 0: 0 bytes left");
        let mut twice = good.clone();
        twice[0] = 2;
        twice.extend_from_slice(&good[8..]);
        check(
            &twice,
            &[],
            "cameras.bin: camera id at byte 56 is 7; an id that no camera before has is allowed",
        );
        check(&good, &images_bin(8, &["x"]), "images.bin: x: image's camera id at byte 68 is 8");
        let mut long = good.clone();
        long.push(0);
        check(&long, &[], "cameras.bin: number of bytes after the last record at byte 56 is 1; 0 is allowed");
        check(&cameras_bin(0, &[f64::NAN, 1.0, 1.0]), &images_bin(7, &["x"]), "x: fx is NaN");
    }

    proptest! {
        #[test]
        fn no_bytes_panic(
            at in 0usize..300,
            with in any::<u8>(),
            end in 0usize..400,
            noise in proptest::collection::vec(any::<u8>(), 0..200),
        ) {
            let (cameras, mut images) = (cameras_bin(4, &[1.0; 8]), images_bin(7, &["a", "b"]));
            let mut broken = cameras.clone();
            let n = broken.len();
            broken[at % n] = with;
            broken.truncate(end);
            let _ = read(&broken, &images);
            let n = images.len();
            images[at % n] = with;
            images.truncate(end);
            let _ = read(&cameras, &images);
            let _ = read(&noise, &noise);
        }
    }
}
