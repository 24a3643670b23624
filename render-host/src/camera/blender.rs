//! Reads the cameras of a Blender/NeRF `transforms_*.json`.
//!
//! The file has `camera_angle_x` (radians) or `fl_x`/`fl_y`/`cx`/`cy` (pixels), optionally `w` and `h`, and a
//! list of `frames`, each with `file_path`, `transform_matrix` (camera-to-world, OpenGL axes) and, in dynamic
//! sets, `time`. A frame may override any of the image's numbers, angles and focal lengths together. A lens
//! that distorts (`k1` to `k4`, `p1`, `p2`, or a `camera_model` that is not a pinhole) is refused. Fields
//! we do not know are skipped. Memory is bounded by the length of the text.

use serde::Deserialize;

use super::{Camera, CameraError, FIELD_OF_VIEW, Intrinsics, View, in_range};

/// What the file or one of its frames says of the image plane and the lens.
#[derive(Clone, Default, Deserialize)]
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

#[derive(Deserialize)]
struct Frame {
    #[serde(default)]
    file_path: String,
    transform_matrix: [[f64; 4]; 4],
    time: Option<f64>,
    #[serde(flatten)]
    optics: Optics,
}

#[derive(Deserialize)]
struct Transforms {
    frames: Vec<Frame>,
    #[serde(flatten)]
    optics: Optics,
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
    let file: Transforms = serde_json::from_slice(bytes).map_err(|e| CameraError::Json {
        line: e.line(),
        column: e.column(),
        message: e.to_string(),
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
        let side = |own: Option<f64>, given: Option<u32>| match own {
            // Anything else, NaN included, becomes a side the camera's constructor refuses by name.
            Some(v) if (1.0..=1e6).contains(&v) => Ok(v as u32),
            Some(_) => Ok(0),
            None => given.ok_or(CameraError::SizeUnknown),
        };
        let width = side(self.w, size.map(|s| s.0))?;
        let height = side(self.h, size.map(|s| s.1))?;
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
