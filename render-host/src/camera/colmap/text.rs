//! Reads `cameras.txt` and `images.txt`.
//!
//! A line of cameras is id, model, width, height and the model's parameters. An image is two lines: id,
//! quaternion (wxyz), translation, camera id and name; then its points, which we step over and which may be
//! none. Lines that start with `#` are comments.

use std::collections::BTreeMap;

use super::model::{MAX_PARAMETERS, MODELS, MODELS_ALLOWED, view};
use crate::camera::{CameraError, Intrinsics, View};

/// The cameras by id.
pub(super) fn read_cameras(bytes: &[u8]) -> Result<BTreeMap<u32, Intrinsics>, CameraError> {
    let mut cameras = BTreeMap::new();
    for (line, text) in lines(bytes) {
        let mut words = Words { line, text: text? };
        if words.is_nothing() {
            continue;
        }
        let id = words.number("camera id", "a number")?;
        let name = words.word("camera model", MODELS_ALLOWED)?;
        let Some(model) = MODELS.iter().find(|model| model.name == name) else {
            return Err(words.refused("camera model", name, MODELS_ALLOWED));
        };
        let size = (words.side("camera width")?, words.side("camera height")?);
        let (_, count) = model.counts(id)?;
        let mut parameters = [0.0; MAX_PARAMETERS];
        for parameter in &mut parameters[..count] {
            *parameter = words.number("camera parameter", "a number")?;
        }
        if !words.is_nothing() {
            return Err(words.refused("end of line", words.text, "no further parameter"));
        }
        let intrinsics = model.intrinsics(id, size, &parameters)?;
        if cameras.insert(id, intrinsics).is_some() {
            return Err(words.refused("camera id", &id.to_string(), "an id that no camera above has"));
        }
    }
    Ok(cameras)
}

/// The images in order of the file.
pub(super) fn read_images(
    bytes: &[u8],
    cameras: &BTreeMap<u32, Intrinsics>,
) -> Result<Vec<View>, CameraError> {
    let mut views = Vec::new();
    let mut lines = lines(bytes);
    while let Some((line, text)) = lines.next() {
        let mut words = Words { line, text: text? };
        if words.is_nothing() {
            continue;
        }
        words.number::<u32>("image id", "a number")?;
        let mut pose = [0.0; 7];
        for v in &mut pose {
            *v = words.number("image pose", "a number")?;
        }
        let id: u32 = words.number("image's camera id", "a number")?;
        let name = words.text.trim();
        if name.is_empty() {
            return Err(words.refused("image name", name, "the name of a file"));
        }
        let Some(intrinsics) = cameras.get(&id) else {
            let error = words.refused("image's camera id", &id.to_string(), "an id from cameras.txt");
            return Err(error.of(name));
        };
        views.push(view(name.to_owned(), pose, *intrinsics)?);
        if let Some((line, text)) = lines.next() {
            step_over_points(&Words { line, text: text? })?;
        }
    }
    Ok(views)
}

/// Steps over the points of an image: x, y and an id of each, or nothing. A line of anything else is the next
/// image, whose turn it is not yet.
fn step_over_points(words: &Words<'_>) -> Result<(), CameraError> {
    let numbers = words.text.split_whitespace().take_while(|word| word.parse::<f64>().is_ok()).count();
    let all = words.text.split_whitespace().count();
    if numbers == all && all.is_multiple_of(3) {
        return Ok(());
    }
    let allowed = "x, y and id of each point that the image of the line before sees, or an empty line,";
    Err(words.refused("points of an image", words.text.trim(), allowed))
}

/// The lines of a text, each with its number from 1.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Result<&str, CameraError>)> {
    bytes.split(|&byte| byte == b'\n').enumerate().map(|(index, line)| {
        let text = std::str::from_utf8(line).map_err(|_| CameraError::Line {
            line: index + 1,
            field: "text",
            found: String::from_utf8_lossy(line).chars().take(40).collect(),
            allowed: "UTF-8",
        });
        (index + 1, text)
    })
}

/// What is left of a line.
struct Words<'t> {
    line: usize,
    text: &'t str,
}

impl<'t> Words<'t> {
    /// Whether the line is empty or a comment.
    fn is_nothing(&self) -> bool {
        let text = self.text.trim();
        text.is_empty() || text.starts_with('#')
    }

    /// The next word.
    fn word(&mut self, field: &'static str, allowed: &'static str) -> Result<&'t str, CameraError> {
        let text = self.text.trim_start();
        let end = text.find(char::is_whitespace).unwrap_or(text.len());
        let (word, rest) = text.split_at(end);
        self.text = rest;
        if word.is_empty() { Err(self.refused(field, word, allowed)) } else { Ok(word) }
    }

    fn number<T: std::str::FromStr>(
        &mut self,
        field: &'static str,
        allowed: &'static str,
    ) -> Result<T, CameraError> {
        let word = self.word(field, allowed)?;
        word.parse().map_err(|_| self.refused(field, word, allowed))
    }

    fn side(&mut self, field: &'static str) -> Result<u32, CameraError> {
        let allowed = "1 to 16384";
        let word = self.word(field, allowed)?;
        match word.parse() {
            Ok(side) if (1..=super::super::MAX_SIDE).contains(&side) => Ok(side),
            _ => Err(self.refused(field, word, allowed)),
        }
    }

    fn refused(&self, field: &'static str, found: &str, allowed: &'static str) -> CameraError {
        let found = found.chars().take(40).collect();
        CameraError::Line { line: self.line, field, found, allowed }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{super::Format, *};

    const CAMERAS: &str =
        "# Camera list\n7 PINHOLE 640 480 500 510 320 240\r\n\n9 SIMPLE_RADIAL 64 48 50 32 24 0\n";
    const IMAGES: &str = "# Image list\n\
        1 1 0 0 0 0.1 0.2 3.0 7 b folder/two words.png\n1.0 2.0 -1 3.0 4.0 5\n\
        2 0.5 0.5 0.5 0.5 0 0 1 9 a.png\n\n\
        3 1 0 0 0 0 0 2 9 c.png";

    fn read(cameras: &str, images: &str) -> Result<Vec<View>, CameraError> {
        super::super::read(cameras.as_bytes(), images.as_bytes(), Format::Text)
    }

    #[test]
    fn text_holds_what_binary_holds() {
        let views = read(CAMERAS, IMAGES).unwrap();
        let names: Vec<_> = views.iter().map(|v| v.name.as_str()).collect();
        assert_eq!(names, ["a.png", "b folder/two words.png", "c.png"]);
        let i = views[1].camera.intrinsics();
        assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (640, 480, 500.0, 510.0, 320.0, 240.0));
        assert_eq!(views[1].camera.translation(), [0.1, 0.2, 3.0]);
        assert_eq!(views[2].camera.translation(), [0.0, 0.0, 2.0], "points of none are a line too");
        // Half a turn and a third: x becomes y, y becomes z.
        assert_eq!(views[0].camera.to_camera([1.0, 0.0, 0.0]), [0.0, 1.0, 1.0]);
    }

    #[test]
    fn errors_say_which_line() {
        for (cameras, images, says) in [
            ("7 FISHEYE 64 48 1", "", "line 1: camera model is \"FISHEYE\""),
            ("\n7 FOV 64 48 1 1 1 1 1", "", "camera 7 has model FOV;"),
            ("7 SIMPLE_RADIAL 64 48 50 32 24 0.5", "", "SIMPLE_RADIAL with distortion [0.5]"),
            ("7 PINHOLE 64 0 1 1 1 1", "", "line 1: camera height is \"0\"; 1 to 16384"),
            ("7 PINHOLE 64 48 1 1 1", "", "line 1: camera parameter is \"\""),
            ("7 PINHOLE 64 48 1 1 1 1 9", "", "line 1: end of line is \" 9\""),
            (CAMERAS, "1 1 0 0 0 0 0 1 8 x.png", "x.png: line 1: image's camera id is \"8\""),
            (CAMERAS, "1 1 0 0 zero 0 0 1 7 x.png", "line 1: image pose is \"zero\""),
            (CAMERAS, "#\n1 1 0 0 0 0 0 1 7", "line 2: image name is \"\""),
            (CAMERAS, "1 0 0 0 0 0 0 1 7 x.png", "x.png: length of qvec is 0"),
            (CAMERAS, "1 1 0 0 0 0 0 1 7 x.png\n2 1 0 0 0 0 0 1 7 y.png", "images.txt: line 2: points of an"),
            (CAMERAS, "1 1 0 0 0 0 0 1 7 x.png\n1.5 2.5", "line 2: points of an image is \"1.5 2.5\""),
            (
                "7 PINHOLE 64 48 1 1 1 1\n7 PINHOLE 64 48 2 2 1 1",
                "",
                "cameras.txt: line 2: camera id is \"7\"",
            ),
        ] {
            let error = read(cameras, images).unwrap_err().to_string();
            assert!(error.contains(says), "{error}, not {says}");
        }
        let error = super::super::read(b"\xff\xfe", b"", Format::Text).unwrap_err().to_string();
        assert!(error.contains("line 1: text is"), "{error}");
    }

    proptest! {
        #[test]
        fn no_bytes_panic(at in 0usize..200, with in any::<u8>(), end in 0usize..300) {
            let (mut cameras, mut images) = (CAMERAS.as_bytes().to_vec(), IMAGES.as_bytes().to_vec());
            let n = images.len();
            images[at % n] = with;
            images.truncate(end);
            let _ = super::super::read(&cameras, &images, Format::Text);
            let n = cameras.len();
            cameras[at % n] = with;
            cameras.truncate(end);
            let _ = super::super::read(&cameras, IMAGES.as_bytes(), Format::Text);
        }
    }
}
