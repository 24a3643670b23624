//! Reads COLMAP datasets: `sparse/0` and a folder of images.
//!
//! Images are in `images`, or in the first folder named `images_N`, where they may be smaller than the
//! cameras say. Nothing moves. Every eighth image in the order of names is for testing, as in Mip-NeRF 360.

use std::path::{Path, PathBuf};

use codec_core::Footprint;
use render_host::camera::{
    View,
    colmap::{self, Format},
};

use super::{
    error::DatasetError,
    files::{is_copy, name_of, read_bytes},
    listed::{Listed, ListedPhotograph, claimed_sizes},
};
use crate::{
    scene::Up,
    train::{
        reduction::ReductionReport,
        views::{ColouredPoint, Dataset, FreeSpace, Start},
    },
};

/// One image in this many is for testing.
const TEST_EVERY: usize = 8;
/// Bytes of a point before its track: id, position, colour, error, length of the track.
const POINT_BYTES: usize = 8 + 24 + 3 + 8 + 8;
/// Bytes of each entry of a track.
const TRACK_BYTES: usize = 8;

/// Where a reconstruction is looked for.
const MODELS: [&str; 3] = ["sparse/0", "sparse", "colmap/sparse/0"];

/// The folder with the reconstruction of the dataset in `folder`, if it has one.
pub(super) fn model(folder: &Path) -> Option<PathBuf> {
    let has_cameras = |model: &PathBuf| {
        ["bin", "txt"].iter().any(|ending| model.join(format!("cameras.{ending}")).is_file())
    };
    MODELS.map(|model| folder.join(model)).into_iter().find(has_cameras)
}

pub(super) fn read(folder: &Path, max_side: Option<u32>) -> Result<(Dataset, ReductionReport), DatasetError> {
    let model = model(folder).unwrap_or_else(|| folder.join(MODELS[0]));
    let (extension, format) =
        if model.join("cameras.bin").is_file() { ("bin", Format::Binary) } else { ("txt", Format::Text) };
    let file = |name: &str| model.join(format!("{name}.{extension}"));
    let views = colmap::read(&read_bytes(&file("cameras"))?, &read_bytes(&file("images"))?, format)
        .map_err(|source| DatasetError::Cameras { path: model.clone(), source })?;
    // They come in order of name.
    if let Some(twice) = views.windows(2).find(|pair| pair[0].name == pair[1].name) {
        return Err(DatasetError::Field {
            path: file("images"),
            field: "name of two images".to_owned(),
            found: twice[0].name.clone(),
            allowed: "each name once is allowed: one image could be both for training and for testing",
        });
    }
    let images = image_folder(folder)?;
    let paths: Vec<PathBuf> = views.iter().map(|view| image_path(&images, &view.name)).collect();
    let sizes = claimed_sizes(&paths)?;
    let mut listed =
        Listed { folder: folder.to_owned(), train: Vec::new(), validation: Vec::new(), test: Vec::new() };
    for (index, ((View { name, camera, .. }, image), size)) in
        views.into_iter().zip(paths).zip(sizes).enumerate()
    {
        let (width, height) = size;
        if !is_copy(&camera, width, height) {
            let (camera_width, camera_height) = (camera.width(), camera.height());
            return Err(DatasetError::Field {
                path: image,
                field: "size".to_owned(),
                found: format!("{width} x {height}, of a camera of {camera_width} x {camera_height}"),
                allowed: "that of its camera, or of a larger or smaller copy, is allowed",
            });
        }
        let camera = camera.resized(width, height);
        let camera = camera.map_err(|source| DatasetError::Cameras { path: image.clone(), source })?;
        let split = if index.is_multiple_of(TEST_EVERY) { &mut listed.test } else { &mut listed.train };
        split.push(ListedPhotograph {
            name,
            camera,
            time: 0.0,
            image,
            size,
            foreground: None,
            counted: None,
        });
    }
    if listed.train.is_empty() {
        return Err(DatasetError::Field {
            path: file("images"),
            field: "number of images".to_owned(),
            found: listed.test.len().to_string(),
            allowed: "at least 2 are needed: every eighth, from the first on, is for testing",
        });
    }
    let photographs = listed.read(max_side)?;
    let points = points(&file("points3D"), format)?;
    let dataset = Dataset {
        name: name_of(folder),
        train: photographs.train,
        validation: photographs.validation,
        test: photographs.test,
        test_scale: photographs.test_scale,
        start: Start::Points(points),
        free_space: FreeSpace::default(),
        has_alpha: photographs.has_alpha,
        frames: 1,
        up: Up::MinusY,
        footprint: Footprint::Pixel,
    };
    Ok((dataset, photographs.report))
}

/// The image of this name; of reduced copies, which are often JPEG, the one of this stem.
fn image_path(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name);
    let copies = ["jpg", "jpeg", "png", "webp", "JPG"].map(|extension| path.with_extension(extension));
    let found = copies.into_iter().find(|copy| !path.is_file() && copy.is_file());
    found.unwrap_or(path)
}

fn image_folder(folder: &Path) -> Result<PathBuf, DatasetError> {
    let images = folder.join("images");
    if images.is_dir() {
        return Ok(images);
    }
    let entries =
        std::fs::read_dir(folder).map_err(|source| DatasetError::File { path: folder.to_owned(), source })?;
    let mut reduced: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| {
            path.is_dir() && path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("images_"))
        })
        .collect();
    reduced.sort();
    reduced.into_iter().next().ok_or_else(|| DatasetError::Field {
        path: folder.to_owned(),
        field: "folder of images".to_owned(),
        found: "absent".to_owned(),
        allowed: "a folder named images, or images_2, images_4 and so on, is needed",
    })
}

/// The points of `points3D`.
fn points(path: &Path, format: Format) -> Result<Vec<ColouredPoint>, DatasetError> {
    let bytes = read_bytes(path)?;
    let points = match format {
        Format::Binary => binary_points(&bytes),
        Format::Text => text_points(&bytes),
    };
    points.and_then(|points| if points.is_empty() { Err(PointError::empty()) } else { Ok(points) }).map_err(
        |PointError { field, found, allowed }| DatasetError::Field {
            path: path.to_owned(),
            field,
            found,
            allowed,
        },
    )
}

/// Points that cannot be read: which field of which of them.
#[derive(Debug, PartialEq)]
struct PointError {
    field: String,
    found: String,
    allowed: &'static str,
}

impl PointError {
    fn empty() -> Self {
        let allowed = "one point at least, with place and colour, is needed";
        Self { field: "list of points".to_owned(), found: "empty".to_owned(), allowed }
    }

    fn position(of: &str, found: String) -> Self {
        Self { field: format!("{of}: position"), found, allowed: "3 numbers up to 3.4e38 are needed" }
    }
}

fn binary_points(bytes: &[u8]) -> Result<Vec<ColouredPoint>, PointError> {
    let short = |points: usize| PointError {
        field: "list of points".to_owned(),
        found: format!("{} bytes long and ends in point {points}, counted from 0", bytes.len()),
        allowed: "as many points as its first 8 bytes say, and their tracks, are needed",
    };
    let (count, mut rest) = bytes.split_first_chunk::<8>().ok_or_else(|| short(0))?;
    let count = u64::from_le_bytes(*count);
    let mut points = Vec::new();
    while (points.len() as u64) < count {
        let index = points.len();
        let (point, after) = binary_point(rest).ok_or_else(|| short(index))?;
        if !point.position.iter().all(|v| v.is_finite()) {
            return Err(PointError::position(&format!("point {index}"), format!("{:?}", point.position)));
        }
        points.push(point);
        rest = after;
    }
    Ok(points)
}

/// The first point in `bytes`, and what comes after its track.
fn binary_point(bytes: &[u8]) -> Option<(ColouredPoint, &[u8])> {
    let (point, after) = bytes.split_at_checked(POINT_BYTES)?;
    let number = |at: usize| Some(f64::from_le_bytes(point.get(at..at + 8)?.try_into().ok()?) as f32);
    let position = [number(8)?, number(16)?, number(24)?];
    let colour = [point[32], point[33], point[34]].map(|v| f32::from(v) / 255.0);
    let track = u64::from_le_bytes(point[43..51].try_into().ok()?);
    let after = after.get(usize::try_from(track).ok()?.checked_mul(TRACK_BYTES)?..)?;
    Some((ColouredPoint { position, colour }, after))
}

fn text_points(bytes: &[u8]) -> Result<Vec<ColouredPoint>, PointError> {
    let mut points = Vec::new();
    for (index, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
        let line = String::from_utf8_lossy(line);
        let line = line.trim();
        if !line.is_empty() && !line.starts_with('#') {
            points.push(text_point(&format!("line {}", index + 1), line)?);
        }
    }
    Ok(points)
}

/// The point in the line that is called `of`.
fn text_point(of: &str, line: &str) -> Result<ColouredPoint, PointError> {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let &[_, x, y, z, r, g, b, ..] = words.as_slice() else {
        let found = format!("{:?}", line.chars().take(40).collect::<String>());
        return Err(PointError {
            field: of.to_owned(),
            found,
            allowed: "id, x, y, z, r, g and b are needed",
        });
    };
    let numbers = |words: [&str; 3]| words.map(|word| word.parse::<f32>().unwrap_or(f32::NAN));
    let (position, colour) = (numbers([x, y, z]), numbers([r, g, b]));
    if !position.iter().all(|v| v.is_finite()) {
        return Err(PointError::position(of, [x, y, z].join(" ")));
    }
    if !colour.iter().all(|v| (0.0..=255.0).contains(v)) {
        let (field, found) = (format!("{of}: colour"), [r, g, b].join(" "));
        return Err(PointError { field, found, allowed: "3 numbers of 0 to 255 are needed" });
    }
    Ok(ColouredPoint { position, colour: colour.map(|v| v / 255.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binary_and_text_points_agree_and_short_ones_are_refused() {
        let mut bytes = 1u64.to_le_bytes().to_vec();
        bytes.extend(7u64.to_le_bytes());
        [1.5f64, -2.0, 0.25].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes.extend([255, 0, 51]);
        bytes.extend(0.3f64.to_le_bytes());
        bytes.extend(1u64.to_le_bytes());
        bytes.extend([0; 8]);
        let text = b"# id x y z r g b error track\n7 1.5 -2 0.25 255 0 51 0.3 1 2\n";
        let point = ColouredPoint { position: [1.5, -2.0, 0.25], colour: [1.0, 0.0, 0.2] };
        assert_eq!(binary_points(&bytes), Ok(vec![point]));
        assert_eq!(text_points(text), Ok(vec![point]));
        let short = binary_points(&bytes[..bytes.len() - 1]).unwrap_err();
        assert!(short.found.contains("66 bytes long and ends in point 0"), "{short:?}");
        assert!(binary_points(&bytes[..7]).is_err());
        bytes[16..24].copy_from_slice(&1e300f64.to_le_bytes());
        let far = binary_points(&bytes).unwrap_err();
        assert_eq!((far.field.as_str(), far.found.as_str()), ("point 0: position", "[inf, -2.0, 0.25]"));
    }

    #[test]
    fn faults_of_points_are_named_by_line() {
        for (line, field, found) in [
            ("7 1.5 -2", "line 2", "\"7 1.5 -2\""),
            ("7 nan 0 0 1 2 3 0", "line 2: position", "nan 0 0"),
            ("7 1 1e300 0 1 2 3 0", "line 2: position", "1 1e300 0"),
            ("7 1 x 0 1 2 3 0", "line 2: position", "1 x 0"),
            ("7 0 0 0 nan 2 3 0", "line 2: colour", "nan 2 3"),
            ("7 0 0 0 1 256 3 0", "line 2: colour", "1 256 3"),
            ("7 0 0 0 1 2 -1 0", "line 2: colour", "1 2 -1"),
        ] {
            let error = text_points(format!("# points\n{line}\n").as_bytes()).unwrap_err();
            assert_eq!((error.field.as_str(), error.found.as_str()), (field, found), "{line}");
        }
        assert_eq!(text_points(b"# none\r\n\n"), Ok(Vec::new()));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points3D.txt");
        std::fs::write(&path, "7 0 0 0 1 2 999\n").unwrap();
        let error = points(&path, Format::Text).unwrap_err().to_string();
        let said = "points3D.txt: line 1: colour is 1 2 999; 3 numbers of 0 to 255 are needed";
        assert!(error.ends_with(said), "{error}");
        std::fs::write(&path, "# none\n").unwrap();
        let error = points(&path, Format::Text).unwrap_err().to_string();
        assert!(error.contains("points3D.txt: list of points is empty; one point"), "{error}");
    }
}
