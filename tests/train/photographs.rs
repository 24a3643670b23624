//! `dgs train` on photographs that are larger than what is trained on.

use std::{fs, process::Command};

use render_host::Image;

/// Photographs of 24 MB each once they are decoded, 24 of them.
#[test]
fn large_photographs_are_not_all_in_memory_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let picture = Image::filled(3000, 2000, [0.4, 0.5, 0.1]).unwrap();
    fs::write(at.join("r.png"), picture.to_png().unwrap()).unwrap();
    let frame = |k: u32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 24.0).sin_cos();
        let (x, z) = (4.0 * sin, 4.0 * cos);
        format!(
            r#"{{"file_path": "r.png", "transform_matrix":
            [[{cos}, 0, {sin}, {x}], [0, 1, 0, 0], [{}, 0, {cos}, {z}], [0, 0, 0, 1]]}}"#,
            -sin
        )
    };
    let frames: Vec<String> = (0..24).map(frame).collect();
    let text = format!(r#"{{"camera_angle_x": 0.7, "frames": [{}]}}"#, frames.join(","));
    fs::write(at.join("transforms.json"), text).unwrap();
    // Most of it is for the program itself and its threads.
    let script = format!(
        "ulimit -v 400000; RAYON_NUM_THREADS=1 exec '{}' train . -o out --steps 2 --evaluations 0 \
         --gaussians 100 --max-side 150 --pictures 0",
        env!("CARGO_BIN_EXE_dgs")
    );
    let output = Command::new("sh").current_dir(at).args(["-c", &script]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("at twice the size") && text.contains("300 x "), "{text}");
}
