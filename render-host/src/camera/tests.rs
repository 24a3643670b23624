use super::*;

fn close(a: [f64; 3], b: [f64; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
}

fn identity4() -> [[f64; 4]; 4] {
    std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))))
}

#[test]
fn look_at_puts_up_up_and_right_right() {
    let camera = Camera::look_at([0.0, -3.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 1.0, 100, 50).unwrap();
    assert!(close(camera.to_camera([0.0; 3]), [0.0, 0.0, 3.0]));
    assert!(close(camera.to_camera([1.0, 0.0, 0.0]), [1.0, 0.0, 3.0]), "world x is on the right");
    assert!(close(camera.to_camera([0.0, 0.0, 1.0]), [0.0, -1.0, 3.0]), "world z is up, so y < 0");
    assert!(close(camera.centre(), [0.0, -3.0, 0.0]));
}

#[test]
fn every_convention_names_the_same_camera() {
    let (w, h, fov_x) = (64, 48, 0.9);
    let eye = [1.0, 2.0, 3.0];
    // Blender: camera at `eye`, axes of the world; it looks along -z with y up.
    let mut c2w = identity4();
    (0..3).for_each(|i| c2w[i][3] = eye[i]);
    let blender = Camera::from_blender(c2w, fov_x, w, h).unwrap();
    let fov_y = 2.0 * ((0.5 * fov_x).tan() * f64::from(h) / f64::from(w)).atan();
    let target = [1.0, 2.0, -5.0];
    let look = Camera::look_at(eye, target, [0.0, 1.0, 0.0], fov_y, w, h).unwrap();
    // COLMAP: half a turn about x takes y up / z back to y down / z forward.
    let i = blender.intrinsics();
    let colmap = Camera::from_colmap([0.0, 2.0, 0.0, 0.0], [-1.0, 2.0, 3.0], i).unwrap();
    let k = [[i.fx, 0.0, i.cx], [0.0, i.fy, i.cy], [0.0, 0.0, 1.0]];
    let mut w2c = identity4();
    for (i, row) in w2c[..3].iter_mut().enumerate() {
        row[..3].copy_from_slice(&blender.rotation()[i]);
        row[3] = blender.translation()[i];
    }
    let opencv = Camera::from_opencv(k, w2c, w, h).unwrap();
    assert_eq!(opencv, blender);
    for other in [look, colmap] {
        for p in [[0.0; 3], [4.0, -1.0, 0.5]] {
            assert!(close(other.to_camera(p), blender.to_camera(p)), "{other:?}");
        }
        assert!((other.intrinsics().fx - i.fx).abs() < 1e-9);
    }
}

#[test]
fn fields_of_view_reach_the_ends_of_their_range_and_no_further() {
    let (low, high) = FIELD_OF_VIEW;
    for (width, height) in [(1, 1), (64, 48), (MAX_SIDE, MAX_SIDE)] {
        for fov in [low, high] {
            let look = Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], fov, width, height);
            let blender = Camera::from_blender(identity4(), fov, width, height);
            // `look_at` takes a vertical field of view, Blender a horizontal one.
            for (camera, side) in [(look.unwrap(), height), (blender.unwrap(), width)] {
                let f = camera.intrinsics().fy;
                assert!((f * (0.5 * fov).tan() / (0.5 * f64::from(side)) - 1.0).abs() < 1e-9, "{fov}");
            }
        }
    }
    for fov in [0.0, 0.9 * low, high + 1e-9, std::f64::consts::PI, -1.0, f64::INFINITY, f64::NAN] {
        for made in [Intrinsics::from_fov_x(fov, 64, 48), Intrinsics::from_fov_y(fov, 64, 48)] {
            let error = made.unwrap_err().to_string();
            assert!(error.starts_with("fov_") && error.contains("is"), "{error}");
        }
        assert!(Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], fov, 64, 48).is_err());
    }
}

#[test]
fn resizing_scales_the_image_and_nothing_else() {
    let camera = Camera::look_at([0.0, 0.0, -2.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 200, 100).unwrap();
    let small = camera.with_near(0.5).unwrap().scaled(0.25).unwrap();
    assert_eq!((small.width(), small.height(), small.near()), (50, 25, 0.5));
    assert_eq!(small.intrinsics().cx, 25.0);
    let error = small.resized(0, 10).unwrap_err().to_string();
    assert!(error.contains("width is 0") && error.contains("16384"), "{error}");
}

#[test]
fn bad_numbers_are_named() {
    let intrinsics = Intrinsics { width: 8, height: 8, fx: 8.0, fy: f64::NAN, cx: 4.0, cy: 4.0 };
    let (r, t) = split("identity", &identity4()).unwrap();
    let error = Camera::new(intrinsics, r, t).unwrap_err().to_string();
    assert!(error.starts_with("fy is NaN"), "{error}");
    let mut mirrored = r;
    mirrored[0][0] = -1.0;
    let good = Intrinsics { fy: 8.0, ..intrinsics };
    assert!(matches!(Camera::new(good, mirrored, t), Err(CameraError::Rotation { .. })));
    assert!(matches!(Camera::new(good, [[f64::NAN; 3]; 3], t), Err(CameraError::Rotation { .. })));
    let skew = [[8.0, 0.1, 4.0], [0.0, 8.0, 4.0], [0.0, 0.0, 1.0]];
    let error = Camera::from_opencv(skew, identity4(), 8, 8).unwrap_err().to_string();
    assert!(error.starts_with("K[0][1] is 0.1"), "{error}");
    let up = [0.0, 0.0, 2.0];
    assert!(Camera::look_at([0.0; 3], [0.0, 0.0, 1.0], up, 1.0, 8, 8).is_err());
    for (field, eye, target) in [("eye", 1e200, 0.0), ("target", 0.0, f64::NAN), ("eye", -1e16, 1.0)] {
        let error = Camera::look_at([eye, 0.0, 0.0], [target, 0.0, 0.0], [0.0, 1.0, 0.0], 1.0, 8, 8);
        assert!(matches!(error, Err(CameraError::Range { field: found, .. }) if found == field), "{error:?}");
        let said = error.unwrap_err().to_string();
        assert!(said.len() < 60, "{said}");
    }
    let far = Camera::look_at([1e200, 0.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0], 1.0, 8, 8).unwrap_err();
    assert!(far.to_string().starts_with("eye is 1e200; -"), "{far}");
    assert!(Camera::from_colmap([0.0; 4], [0.0; 3], good).is_err());
}

#[test]
fn a_rotation_with_few_digits_is_made_orthonormal() {
    let (s, c) = 0.3f64.sin_cos();
    let r = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]].map(|r| r.map(|v| (v * 1e5).round() / 1e5));
    let intrinsics = Intrinsics::from_fov_y(1.0, 8, 8).unwrap();
    let camera = Camera::new(intrinsics, r, [0.0; 3]).unwrap();
    let again = Camera::new(intrinsics, camera.rotation(), [0.0; 3]).unwrap();
    assert_eq!(camera, again, "what is stored is stable");
}

#[test]
fn json_keeps_every_bit_and_refuses_nonsense() {
    let camera =
        Camera::look_at([0.1, -3.7, 0.3], [0.01, 0.02, 0.03], [0.0, 0.0, 1.0], 0.7, 123, 77).unwrap();
    let text = serde_json::to_string(&camera).unwrap();
    assert_eq!(serde_json::from_str::<Camera>(&text).unwrap(), camera);
    let bad = text.replace("\"width\":123", "\"width\":0");
    let error = serde_json::from_str::<Camera>(&bad).unwrap_err().to_string();
    assert!(error.contains("width is 0"), "{error}");
}

/// A crop sees what the whole sees there: the same rays, pixel by pixel.
#[test]
fn a_crop_has_the_rays_of_its_pixels() {
    let camera = Camera::look_at([0.0, -3.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 1.0, 100, 50).unwrap();
    let camera = camera.with_near(0.5).unwrap();
    let crop = camera.cropped(30, 20, 40, 25).unwrap();
    let (whole, part) = (camera.intrinsics(), crop.intrinsics());
    assert_eq!((part.width, part.height, crop.near()), (40, 25, 0.5));
    assert_eq!((part.fx, part.fy, part.cx, part.cy), (whole.fx, whole.fy, whole.cx - 30.0, whole.cy - 20.0));
    assert_eq!(camera.cropped(0, 0, 100, 50).unwrap(), camera);
    for (left, top, width, height, field) in
        [(61, 0, 40, 1, "left"), (0, 26, 1, 25, "top"), (0, 0, 101, 1, "width"), (0, 0, 1, 0, "height")]
    {
        let error = camera.cropped(left, top, width, height).unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    }
}

#[test]
fn a_pose_says_the_same_as_the_camera() {
    // Quaternions of COLMAP turn world to camera: the conjugates of a pose's. Half turns are the hard ones.
    for q in [
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.5, -0.5, 0.5, 0.5],
        [0.1, 0.7, -0.7, 0.1],
        [0.0, 0.6, 0.0, -0.8],
        [-0.3, 0.2, 0.9, 0.25],
    ] {
        let length = q.iter().map(|v: &f64| v * v).sum::<f64>().sqrt();
        let [w, x, y, z] = q.map(|v| v / length);
        let intrinsics = Intrinsics::from_fov_y(0.8, 64, 48).unwrap();
        let camera = Camera::from_colmap([w, x, y, z], [1.0, -2.0, 3.0], intrinsics).unwrap();
        let pose = camera.pose();
        let found = pose.rotation.map(f64::from);
        let product: f64 = found.iter().zip([w, -x, -y, -z]).map(|(a, b)| a * b).sum();
        assert!((product.abs() - 1.0).abs() < 1e-6, "{q:?} became {found:?}");
        assert!(camera.to_camera(pose.position).iter().all(|v| v.abs() < 1e-5));
    }
}

#[test]
fn a_transposed_matrix_is_refused() {
    let camera = Camera::look_at([1.0, 2.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 1.0, 8, 8).unwrap();
    let i = camera.intrinsics();
    let k = [[i.fx, 0.0, i.cx], [0.0, i.fy, i.cy], [0.0, 0.0, 1.0]];
    let mut matrix = identity4();
    for (i, row) in matrix[..3].iter_mut().enumerate() {
        row[..3].copy_from_slice(&camera.rotation()[i]);
        row[3] = camera.translation()[i];
    }
    assert_eq!(Camera::from_opencv(k, matrix, 8, 8).unwrap(), camera);
    let transposed = std::array::from_fn(|i| std::array::from_fn(|j| matrix[j][i]));
    for (made, name) in [
        (Camera::from_opencv(k, transposed, 8, 8), "world_to_camera[3]["),
        (Camera::from_opengl(transposed, i), "camera_to_world[3]["),
        (Camera::from_blender(transposed, 1.0, 8, 8), "camera_to_world[3]["),
    ] {
        let error = made.unwrap_err().to_string();
        assert!(error.starts_with(name) && error.ends_with("may be transposed"), "{error}");
    }
    // Digits that a file has lost are no reason to refuse it.
    for (off, is_refused) in [(9e-7, false), (2e-6, true), (f64::NAN, true)] {
        let mut near = matrix;
        near[3][3] = 1.0 + off;
        assert_eq!(Camera::from_opencv(k, near, 8, 8).is_err(), is_refused, "{off}");
    }
}
