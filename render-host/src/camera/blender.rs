//! Reads the cameras of a Blender/NeRF `transforms_*.json`.
//!
//! The file has `camera_angle_x` (radians) or `fl_x`/`fl_y`/`cx`/`cy` (pixels), optionally `w` and `h`, and a
//! list of `frames`, each with `file_path`, `transform_matrix` (camera-to-world, OpenGL axes) and, in dynamic
//! sets, `time`. A frame may override any of the image's numbers, angles and focal lengths together. A lens
//! that distorts (`k1` to `k4`, `p1`, `p2`, or a `camera_model` that is not a pinhole) is refused. Fields
//! we do not know are skipped. Memory is bounded by the length of the text.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{DeserializeSeed, Error, IgnoredAny, MapAccess, SeqAccess, Visitor},
};

use super::{Camera, CameraError, FIELD_OF_VIEW, Intrinsics, MAX_SIDE, View, in_range};

/// What the file or one of its frames says of the image plane and the lens.
#[derive(Clone, Default)]
struct Optics {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_model: Option<String>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// Models without distortion, or whose parameters say how much there is.
const MODELS: [&str; 5] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "RADIAL", "SIMPLE_RADIAL"];

struct Frame {
    /// Empty where there is none.
    file_path: String,
    transform_matrix: [[f64; 4]; 4],
    time: Option<f64>,
    optics: Optics,
}

struct Transforms {
    frames: Vec<Frame>,
    optics: Optics,
}

// Errors are to name the field and the frame, and to stand where it does: what serde derives for fields that
// two objects share does neither.

impl<'de> Deserialize<'de> for Transforms {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;
        impl<'de> Visitor<'de> for Fields {
            type Value = Transforms;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object with frames")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut object: A) -> Result<Transforms, A::Error> {
                let (mut frames, mut optics) = (None, Optics::default());
                while let Some(key) = object.next_key::<String>()? {
                    if key == "frames" {
                        set::<_, A::Error>(&mut frames, &key, object.next_value_seed(Frames)?)?;
                    } else if !optics.take(&key, &mut object)? {
                        object.next_value::<IgnoredAny>()?;
                    }
                }
                let frames = frames.ok_or_else(|| A::Error::missing_field("frames"))?;
                Ok(Transforms { frames, optics })
            }
        }
        deserializer.deserialize_map(Fields)
    }
}

/// The list of frames.
struct Frames;

impl<'de> DeserializeSeed<'de> for Frames {
    type Value = Vec<Frame>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Vec<Frame>, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Frames {
    type Value = Vec<Frame>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of frames")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<Frame>, A::Error> {
        let mut frames = Vec::new();
        loop {
            let number = frames.len();
            let next = list.next_element::<Frame>();
            match next.map_err(|error| A::Error::custom(format_args!("frame {number}: {error}")))? {
                Some(frame) => frames.push(frame),
                None => return Ok(frames),
            }
        }
    }
}

impl<'de> Deserialize<'de> for Frame {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fields;
        impl<'de> Visitor<'de> for Fields {
            type Value = Frame;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object with file_path and transform_matrix")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut object: A) -> Result<Frame, A::Error> {
                let (mut path, mut matrix, mut time, mut optics) = (None, None, None, Optics::default());
                while let Some(key) = object.next_key::<String>()? {
                    match key.as_str() {
                        "file_path" => set::<_, A::Error>(&mut path, &key, named(&mut object, &key)?)?,
                        "transform_matrix" => {
                            set::<_, A::Error>(&mut matrix, &key, named(&mut object, &key)?)?;
                        }
                        "time" => set_number(&mut time, &key, &mut object)?,
                        _ if optics.take(&key, &mut object)? => {}
                        _ => {
                            object.next_value::<IgnoredAny>()?;
                        }
                    }
                }
                let transform_matrix = matrix.ok_or_else(|| A::Error::missing_field("transform_matrix"))?;
                Ok(Frame { file_path: path.unwrap_or_default(), transform_matrix, time, optics })
            }
        }
        deserializer.deserialize_map(Fields)
    }
}

/// Fills the field called `key`, which is to be there once.
fn set<T, E: Error>(field: &mut Option<T>, key: &str, value: T) -> Result<(), E> {
    match field.replace(value) {
        None => Ok(()),
        Some(_) => Err(E::custom(format_args!("{key} is there twice; once is allowed"))),
    }
}

/// The same with the number that comes next in `object`; null is none.
fn set_number<'de, A: MapAccess<'de>>(
    field: &mut Option<f64>,
    key: &str,
    object: &mut A,
) -> Result<(), A::Error> {
    match object.next_value_seed(Number(key))? {
        Some(number) => set(field, key, number),
        None => Ok(()),
    }
}

/// The value that comes next in `object`, that of `key`.
fn named<'de, T: Deserialize<'de>, A: MapAccess<'de>>(object: &mut A, key: &str) -> Result<T, A::Error> {
    object.next_value().map_err(|error| A::Error::custom(format_args!("{key}: {error}")))
}

/// A number or null, as the value of the field of this name.
struct Number<'k>(&'k str);

impl Number<'_> {
    fn refused<E: Error>(&self, found: impl fmt::Display) -> E {
        E::custom(format_args!("{} is {found}; a number is allowed", self.0))
    }
}

impl<'de> DeserializeSeed<'de> for Number<'_> {
    type Value = Option<f64>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Option<f64>, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Number<'_> {
    type Value = Option<f64>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a number as {}", self.0)
    }

    fn visit_unit<E: Error>(self) -> Result<Option<f64>, E> {
        Ok(None)
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<Option<f64>, E> {
        Ok(Some(number))
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Option<f64>, E> {
        Ok(Some(number as f64))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Option<f64>, E> {
        Ok(Some(number as f64))
    }

    fn visit_bool<E: Error>(self, found: bool) -> Result<Option<f64>, E> {
        Err(self.refused(found))
    }

    fn visit_str<E: Error>(self, found: &str) -> Result<Option<f64>, E> {
        Err(self.refused(format_args!("{found:?}")))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, _: A) -> Result<Option<f64>, A::Error> {
        Err(self.refused("a list"))
    }

    fn visit_map<A: MapAccess<'de>>(self, _: A) -> Result<Option<f64>, A::Error> {
        Err(self.refused("an object"))
    }
}

/// Reads a `transforms_*.json`: its frames in file order.
///
/// `size` is the width and height of the images in pixels, for files that do not say (`w`, `h`); where a
/// file does say, the file wins.
///
/// # Errors
/// Text that is not such JSON (with line and column), a size nobody gave, a lens that distorts, or a frame
/// whose camera is not one (with the frame's name).
pub fn read(bytes: &[u8], size: Option<(u32, u32)>) -> Result<Vec<View>, CameraError> {
    let file: Transforms = serde_json::from_slice(bytes).map_err(|error| {
        let (line, column, text) = (error.line(), error.column(), error.to_string());
        // It ends with the place, which is said before it.
        let message = text.strip_suffix(&format!(" at line {line} column {column}")).unwrap_or(&text);
        CameraError::Json { line, column, message: message.to_owned() }
    })?;
    let view = |(index, frame): (usize, Frame)| {
        let optics = frame.optics.or(&file.optics);
        let camera = optics
            .undistorted(&frame.file_path)
            .and_then(|()| optics.intrinsics(size))
            .and_then(|intrinsics| Camera::from_opengl(frame.transform_matrix, intrinsics))
            .map_err(|e| match frame.file_path.as_str() {
                "" => e.of(&format!("frame {index}, which has no file_path")),
                name => e.of(name),
            })?;
        Ok(View { name: frame.file_path, time: frame.time, camera })
    };
    file.frames.into_iter().enumerate().map(view).collect()
}

impl Optics {
    /// Reads the value that comes next in `object`, if `key` is that of a field; otherwise `false`.
    fn take<'de, A: MapAccess<'de>>(&mut self, key: &str, object: &mut A) -> Result<bool, A::Error> {
        let field = match key {
            "camera_angle_x" => &mut self.camera_angle_x,
            "camera_angle_y" => &mut self.camera_angle_y,
            "w" => &mut self.w,
            "h" => &mut self.h,
            "fl_x" => &mut self.fl_x,
            "fl_y" => &mut self.fl_y,
            "cx" => &mut self.cx,
            "cy" => &mut self.cy,
            "k1" => &mut self.k1,
            "k2" => &mut self.k2,
            "k3" => &mut self.k3,
            "k4" => &mut self.k4,
            "p1" => &mut self.p1,
            "p2" => &mut self.p2,
            "camera_model" => {
                if let Some(model) = named::<Option<String>, A>(object, key)? {
                    set::<_, A::Error>(&mut self.camera_model, key, model)?;
                }
                return Ok(true);
            }
            _ => return Ok(false),
        };
        set_number(field, key, object)?;
        Ok(true)
    }

    /// Own numbers first, then those of `other`. Angles and focal lengths say the same: where there is one of
    /// them, none is taken from `other`.
    fn or(self, other: &Self) -> Self {
        let own = [self.camera_angle_x, self.camera_angle_y, self.fl_x, self.fl_y];
        let [camera_angle_x, camera_angle_y, fl_x, fl_y] = if own == [None; 4] {
            [other.camera_angle_x, other.camera_angle_y, other.fl_x, other.fl_y]
        } else {
            own
        };
        Self {
            camera_angle_x,
            camera_angle_y,
            w: self.w.or(other.w),
            h: self.h.or(other.h),
            fl_x,
            fl_y,
            cx: self.cx.or(other.cx),
            cy: self.cy.or(other.cy),
            camera_model: self.camera_model.or_else(|| other.camera_model.clone()),
            k1: self.k1.or(other.k1),
            k2: self.k2.or(other.k2),
            k3: self.k3.or(other.k3),
            k4: self.k4.or(other.k4),
            p1: self.p1.or(other.p1),
            p2: self.p2.or(other.p2),
        }
    }

    /// Refuses a lens that distorts.
    fn undistorted(&self, name: &str) -> Result<(), CameraError> {
        let distortion = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2].map(|v| v.unwrap_or(0.0));
        let model = self.camera_model.as_deref().unwrap_or("PINHOLE");
        let known = MODELS.contains(&model);
        if known && distortion == [0.0; 6] {
            return Ok(());
        }
        Err(CameraError::Distorted {
            camera: name.to_owned(),
            model: model.to_owned(),
            values: if known { distortion.to_vec() } else { Vec::new() },
            allowed: "PINHOLE, or k1 to k4, p1 and p2 of 0",
        })
    }

    fn intrinsics(&self, size: Option<(u32, u32)>) -> Result<Intrinsics, CameraError> {
        let side = |field, own: Option<f64>, given: Option<u32>| match own {
            Some(own) => {
                in_range(field, own, (1.0, f64::from(MAX_SIDE)))?;
                Ok(own as u32)
            }
            None => given.ok_or(CameraError::SizeUnknown),
        };
        let width = side("w", self.w, size.map(|s| s.0))?;
        let height = side("h", self.h, size.map(|s| s.1))?;
        let focal = |own: Option<f64>, field, angle: Option<f64>, side: u32| match (own, angle) {
            (None, Some(angle)) => {
                in_range(field, angle, FIELD_OF_VIEW)?;
                Ok(Some(0.5 * f64::from(side) / (0.5 * angle).tan()))
            }
            (own, _) => Ok(own),
        };
        let fx = focal(self.fl_x, "camera_angle_x (radians)", self.camera_angle_x, width)?;
        let fy = focal(self.fl_y, "camera_angle_y (radians)", self.camera_angle_y, height)?;
        // Pixels are square unless the file says otherwise.
        let (Some(fx), Some(fy)) = (fx.or(fy), fy.or(fx)) else {
            return Err(CameraError::FocalLengthUnknown);
        };
        let cx = self.cx.unwrap_or(0.5 * f64::from(width));
        let cy = self.cy.unwrap_or(0.5 * f64::from(height));
        Ok(Intrinsics { width, height, fx, fy, cx, cy })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TEXT: &str = r#"{"camera_angle_x": 0.6911112070083618, "frames": [
        {"file_path": "./train/r_000", "rotation": 0.03, "time": 0.25, "transform_matrix":
          [[1,0,0,0.5],[0,0,-1,-4],[0,1,0,1],[0,0,0,1]]},
        {"file_path": "b", "w": 40, "h": 20, "fl_x": 30, "transform_matrix":
          [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;

    #[test]
    fn a_d_nerf_file_is_read() {
        let views = read(TEXT.as_bytes(), Some((800, 800))).unwrap();
        assert_eq!(views.len(), 2);
        assert_eq!((views[0].name.as_str(), views[0].time), ("./train/r_000", Some(0.25)));
        let camera = &views[0].camera;
        assert!((camera.intrinsics().fx - 1111.111).abs() < 0.01, "{:?}", camera.intrinsics());
        // Camera-to-world columns: x = (1,0,0), y up = (0,0,1), back = (0,-1,0): it looks along +y.
        let p = camera.to_camera([0.5, 0.0, 2.0]);
        assert_eq!(p, [0.0, -1.0, 4.0], "one above the axis, four ahead");
        let own = views[1].camera.intrinsics();
        assert_eq!((own.width, own.height, own.fx, own.fy), (40, 20, 30.0, 30.0));
    }

    #[test]
    fn errors_name_the_frame_or_the_line() {
        let error = read(TEXT.as_bytes(), None).unwrap_err().to_string();
        assert!(error.contains("./train/r_000") && error.contains("no w and h"), "{error}");
        let error = read(b"{\n \"frames\": 3}", None).unwrap_err().to_string();
        assert!(error.starts_with("line 2"), "{error}");
        let flat = TEXT.replace("[1,0,0,0.5]", "[2,0,0,0.5]");
        let error = read(flat.as_bytes(), Some((8, 8))).unwrap_err().to_string();
        assert!(error.contains("./train/r_000: rotation differs"), "{error}");
        let missing = r#"{"frames": [{"transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
        let error = read(missing.as_bytes(), Some((8, 8))).unwrap_err().to_string();
        assert!(
            error.starts_with("frame 0, which has no file_path: no focal length: camera_angle_x"),
            "{error}"
        );
        for angle in ["39.6", "90", "0", "-0.7"] {
            let text = TEXT.replace("0.6911112070083618", angle);
            let error = read(text.as_bytes(), Some((8, 8))).unwrap_err().to_string();
            assert!(error.contains(&format!("camera_angle_x (radians) is {angle}; ")), "{error}");
        }
    }

    #[test]
    fn values_of_another_kind_are_named_where_they_stand() {
        let refused = |from: &str, to: &str| {
            read(TEXT.replacen(from, to, 1).as_bytes(), Some((8, 8))).unwrap_err().to_string()
        };
        for (to, says) in [
            (r#"{"w": "64","#, r#": w is "64"; a number is allowed"#),
            (r#"{"cx": [1],"#, "cx is a list; a number is allowed"),
            (r#"{"k1": {},"#, "k1 is an object; a number is allowed"),
            (r#"{"h": true,"#, "h is true; a number is allowed"),
            (r#"{"w": 8, "w": 9,"#, "w is there twice; once is allowed"),
            (r#"{"camera_model": 3,"#, "camera_model: invalid type: integer `3`"),
            (r#"{"w": 1e9,"#, "./train/r_000: w is 1e9; 1 to 16384 is allowed"),
            (r#"{"h": 0,"#, "./train/r_000: h is 0; 1 to 16384 is allowed"),
        ] {
            let error = refused("{", to);
            assert!(error.contains(says) && !error.contains(" at line "), "{error}");
        }
        for (from, to, place, says) in [
            ("0.25", "[]", "line 2,", "frame 0: time is a list; a number is allowed"),
            ("\"w\": 40", "\"w\": \"40\"", "line 4,", "frame 1: w is \"40\"; a number is allowed"),
            (",[0,0,0,1]]", "]", "line 3,", "frame 0: transform_matrix: invalid length 3"),
            ("\"b\"", "3", "line 4,", "frame 1: file_path: invalid type: integer `3`"),
            ("transform_matrix", "matrix", "line 3,", "frame 0: missing field `transform_matrix`"),
        ] {
            let error = refused(from, to);
            assert!(error.starts_with(place) && error.contains(says), "{error}");
        }
        let nothing =
            TEXT.replacen('{', r#"{"w": null, "camera_model": null, "applied_transform": [[1]],"#, 1);
        assert_eq!(read(nothing.as_bytes(), Some((8, 8))).unwrap()[0].camera.width(), 8);
    }

    #[test]
    fn a_frame_may_have_a_lens_of_its_own() {
        let focal = |file: &str, frame: &str| {
            let text = format!(
                r#"{{{file}, "frames": [{{"file_path": "a", {frame}, "transform_matrix":
                [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}]}}"#
            );
            let own = read(text.as_bytes(), Some((200, 100))).unwrap()[0].camera.intrinsics();
            [own.fx, own.fy]
        };
        let half = 100.0 / 0.25f64.tan();
        for (file, frame, expected) in [
            (r#""fl_x": 100"#, r#""camera_angle_x": 0.5"#, [half; 2]),
            (r#""camera_angle_x": 0.5"#, r#""fl_x": 30, "fl_y": 40"#, [30.0, 40.0]),
            (r#""fl_x": 50, "fl_y": 60"#, r#""time": 0"#, [50.0, 60.0]),
            (r#""fl_x": 50, "camera_angle_x": 700"#, r#""time": 0"#, [50.0; 2]),
        ] {
            assert_eq!(focal(file, frame), expected, "{file} {frame}");
        }
    }

    #[test]
    fn lenses_that_distort_are_refused_by_name() {
        let with =
            |fields: &str| read(TEXT.replacen('{', &format!("{{{fields}, "), 1).as_bytes(), Some((8, 8)));
        for fields in [r#""k1": 0.0, "p2": 0"#, r#""camera_model": "OPENCV""#] {
            assert_eq!(with(fields).unwrap().len(), 2, "{fields}");
        }
        for (fields, says) in [
            (r#""k1": 0.1"#, "model PINHOLE with distortion [0.1,"),
            (r#""camera_model": "OPENCV", "p2": -0.2"#, "model OPENCV with distortion"),
            (r#""camera_model": "OPENCV_FISHEYE""#, "model OPENCV_FISHEYE; PINHOLE"),
        ] {
            let error = with(fields).unwrap_err().to_string();
            assert!(error.contains("./train/r_000") && error.contains(says), "{error}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_panic(at in 0usize..400, with in any::<u8>(), end in 0usize..500) {
            let mut bytes = TEXT.as_bytes().to_vec();
            let at = at % bytes.len();
            bytes[at] = with;
            bytes.truncate(end);
            let _ = read(&bytes, Some((16, 16)));
        }
    }
}
