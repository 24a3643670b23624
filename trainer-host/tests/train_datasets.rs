//! Datasets are read as they are, and refused by file and field where they are not right.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::{fs, path::Path};

use trainer_host::train::dataset;

const MATRIX: &str = "[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]";

/// A PNG of `width` x `height` with transparent corners.
fn write_png(path: &Path, width: u32, height: u32) {
    let mut image = image::RgbaImage::new(width, height);
    image.put_pixel(width / 2, height / 2, image::Rgba([200, 100, 50, 128]));
    image.save(path).unwrap();
}

fn frame(name: &str, time: f64, matrix: &str) -> String {
    format!("{{\"file_path\": \"{name}\", \"time\": {time}, \"transform_matrix\": {matrix}}}")
}

fn write_split(folder: &Path, split: &str, frames: &[String]) {
    let text = format!("{{\"camera_angle_x\": 0.7, \"frames\": [{}]}}", frames.join(","));
    fs::write(folder.join(format!("transforms_{split}.json")), text).unwrap();
}

/// A small dataset that is right.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("train")).unwrap();
    for k in 0..3 {
        write_png(&folder.path().join(format!("train/r_{k}.png")), 16, 12);
    }
    let frames: Vec<String> =
        (0..3).map(|k| frame(&format!("./train/r_{k}"), f64::from(k) / 2.0, MATRIX)).collect();
    write_split(folder.path(), "train", &frames);
    folder
}

fn refusal(folder: &Path) -> String {
    dataset::read(folder).unwrap_err().to_string()
}

#[test]
fn a_blender_dataset_is_premultiplied_and_has_its_splits_apart() {
    let folder = folder();
    let read = dataset::read(folder.path()).unwrap();
    assert_eq!((read.train.photographs().len(), read.frames, read.has_alpha), (3, 3, true));
    assert!(read.test.is_empty() && read.validation.is_empty());
    let view = &read.train.photographs()[1];
    assert_eq!((view.time, view.camera.width(), view.camera.height()), (0.5, 16, 12));
    let at = 4 * (6 * 16 + 8);
    assert_eq!(view.photograph.rgba()[at..at + 4], [100, 50, 25, 128]);
}

#[test]
fn faults_are_named_by_file_and_field() {
    let fresh = folder();
    fs::remove_file(fresh.path().join("train/r_1.png")).unwrap();
    let text = refusal(fresh.path());
    assert!(text.contains("file_path is ./train/r_1") && text.contains(".jpeg"), "{text}");

    fs::write(fresh.path().join("train/r_1.png"), b"not an image").unwrap();
    assert!(refusal(fresh.path()).contains("r_1.png: image codec"));

    write_png(&fresh.path().join("train/r_1.png"), 16, 16);
    let text = refusal(fresh.path());
    assert!(text.contains("r_1: image of 16 x 16 pixels, camera of 16 x 12"), "{text}");

    let fresh = folder();
    write_split(fresh.path(), "train", &[frame("./train/r_0", 1.5, MATRIX)]);
    let text = refusal(fresh.path());
    assert!(text.contains("r_0: time is 1.5; 0 to 1 is allowed"), "{text}");

    write_split(
        fresh.path(),
        "train",
        &[frame("./train/r_0", 0.5, &MATRIX.replace("[1,0,0,0]", "[1.4,0,0,0]"))],
    );
    let text = refusal(fresh.path());
    assert!(text.contains("transforms_train.json") && text.contains("r_0"), "{text}");

    fs::write(fresh.path().join("transforms_train.json"), b"{\"frames\": 3}").unwrap();
    assert!(refusal(fresh.path()).contains("transforms_train.json"));

    let empty = tempfile::tempdir().unwrap();
    let text = refusal(empty.path());
    assert!(text.contains("transforms_train.json") && text.contains("sparse/0"), "{text}");
}

/// What Nerfstudio writes: one file, a mark at its start, JPEG images, here twice as large as their
/// cameras.
#[test]
fn one_file_of_transforms_is_parted_and_images_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let frames: Vec<String> = (0..9).map(|k| frame(&format!("r_{k}"), f64::from(k) / 8.0, MATRIX)).collect();
    for k in 0..9 {
        image::RgbImage::new(32, 24).save(folder.path().join(format!("r_{k}.jpg"))).unwrap();
    }
    let path = folder.path().join("transforms.json");
    let text = |frames: &[String]| {
        format!("\u{feff}{{\"fl_x\": 20, \"w\": 16, \"h\": 12, \"frames\": [{}]}}", frames.join(","))
    };
    fs::write(&path, text(&frames)).unwrap();
    let read = dataset::read(folder.path()).unwrap();
    assert_eq!((read.train.photographs().len(), read.test.photographs().len()), (8, 1));
    assert_eq!(read.test.photographs()[0].name, "r_7");
    let lens = read.train.photographs()[0].camera.intrinsics();
    assert_eq!((lens.width, lens.height, lens.fx), (32, 24, 40.0));
    let untimed = format!("{{\"file_path\": \"r_0\", \"transform_matrix\": {MATRIX}}}");
    fs::write(&path, text(&[frames[1].clone(), untimed])).unwrap();
    assert!(refusal(folder.path()).contains("time is given of 1 frames of 2"), "{}", refusal(folder.path()));
    fs::write(&path, text(&frames).replace("\"fl_x\": 20,", "")).unwrap();
    assert!(refusal(folder.path()).contains("no focal length"), "{}", refusal(folder.path()));
}

#[test]
fn a_panoptic_dataset_is_read_camera_by_camera_and_refused_by_frame() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("ims/4")).unwrap();
    let write = |k: &str| {
        let text = format!(
            "{{\"w\":16,\"h\":12,\"k\":[{k},{k}],\"w2c\":[[[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]],\
             [[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]]],\"fn\":[[\"4/0.png\"],[\"4/1.png\"]],\
             \"cam_id\":[[4],[4]]}}"
        );
        fs::write(folder.path().join("train_meta.json"), text).unwrap();
    };
    write("[[[20,0,8],[0,20,6],[0,0,1]]]");
    for k in 0..2 {
        write_png(&folder.path().join(format!("ims/4/{k}.png")), 16, 12);
    }
    let read = dataset::read(folder.path()).unwrap();
    assert_eq!((read.train.photographs().len(), read.frames, read.has_alpha), (2, 2, false));
    assert_eq!(read.train.photographs()[1].time, 1.0);
    write("[]");
    let text = refusal(folder.path());
    assert!(text.contains("k and w2c of frame 0 is 0 and 1 cameras"), "{text}");
}

/// The real ones, where they are.
#[test]
fn real_datasets_are_read() {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/scenes");
    if !scenes.is_dir() {
        assert!(std::env::var_os("DGS_REQUIRE_DATA").is_none(), "{}: real data are needed", scenes.display());
        return;
    }
    let read = |name: &str| dataset::read(&scenes.join(name)).unwrap();
    let lego = read("dnerf-lego-400");
    assert_eq!(
        (lego.train.photographs().len(), lego.validation.photographs().len(), lego.test.photographs().len()),
        (50, 11, 20)
    );
    let steak = read("n3dv-flame-steak-frame0");
    assert_eq!((steak.train.photographs().len(), steak.test.photographs().len(), steak.frames), (18, 3, 1));
    let basketball = read("panoptic-basketball");
    assert_eq!((basketball.train.photographs().len(), basketball.test.photographs().len()), (540, 80));
}
