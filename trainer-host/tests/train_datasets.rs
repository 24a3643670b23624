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
    assert!(text.contains("transforms_train.json: frame 1's file_path is ./train/r_1"), "{text}");
    assert!(text.contains(".jpeg"), "{text}");

    fs::write(fresh.path().join("train/r_1.png"), b"not an image").unwrap();
    assert!(refusal(fresh.path()).contains("r_1.png: image codec"));

    write_png(&fresh.path().join("train/r_1.png"), 16, 16);
    let text = refusal(fresh.path());
    assert!(text.contains("r_1: image of 16 x 16 pixels, camera of 16 x 12"), "{text}");

    let fresh = folder();
    let times = [frame("./train/r_1", 0.5, MATRIX), frame("./train/r_0", 1.5, MATRIX)];
    write_split(fresh.path(), "train", &times);
    let text = refusal(fresh.path());
    let named = "transforms_train.json: time of frame 1, ./train/r_0, is 1.5; 0 to 1 is allowed";
    assert!(text.ends_with(named), "{text}");

    write_split(
        fresh.path(),
        "train",
        &[frame("./train/r_0", 0.5, &MATRIX.replace("[1,0,0,0]", "[1.4,0,0,0]"))],
    );
    let text = refusal(fresh.path());
    assert!(text.contains("transforms_train.json") && text.contains("r_0"), "{text}");

    fs::write(fresh.path().join("transforms_train.json"), b"{\"frames\": 3}").unwrap();
    assert!(refusal(fresh.path()).contains("transforms_train.json"));

    write_split(fresh.path(), "train", &[]);
    let text = refusal(fresh.path());
    assert!(text.contains("transforms_train.json: frames is empty; at least 1 to train on"), "{text}");

    let nameless = format!("{{\"time\": 0.5, \"transform_matrix\": {MATRIX}}}");
    write_split(fresh.path(), "train", &[frame("./train/r_0", 0.5, MATRIX), nameless]);
    let text = refusal(fresh.path());
    assert!(text.contains("transforms_train.json: frame 1's file_path is absent; "), "{text}");

    // Views without times beside those with would all be of the first instant.
    let fresh = folder();
    let untimed = format!("{{\"file_path\": \"./train/r_0\", \"transform_matrix\": {MATRIX}}}");
    write_split(fresh.path(), "test", std::slice::from_ref(&untimed));
    let text = refusal(fresh.path());
    assert!(
        text.ends_with(
            "transforms_test.json: time is absent; given of all frames, as in \
                            transforms_train.json, is allowed"
        ),
        "{text}"
    );
    write_split(fresh.path(), "train", &[untimed]);
    write_split(fresh.path(), "test", &[frame("./train/r_0", 0.5, MATRIX)]);
    let text = refusal(fresh.path());
    assert!(text.contains("transforms_test.json: time is given; absent, as in"), "{text}");

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

/// A file of transforms of Nerfstudio with four frames, `more` before them, and `of_frame` in the second.
fn nerfstudio(more: &str, of_frame: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frames: Vec<String> = (0..4)
        .map(|k| {
            image::RgbImage::new(16, 12).save(folder.path().join(format!("r_{k}.png"))).unwrap();
            let text = frame(&format!("./r_{k}.png"), f64::from(k) / 3.0, MATRIX);
            if k == 1 { text.replacen('{', &format!("{{{of_frame}"), 1) } else { text }
        })
        .collect();
    let text = format!("{{\"fl_x\": 20, \"w\": 16, \"h\": 12, {more} \"frames\": [{}]}}", frames.join(","));
    fs::write(folder.path().join("transforms.json"), text).unwrap();
    folder
}

#[test]
fn lists_of_a_file_of_transforms_say_what_frames_are_for() {
    let lists = |more: &str| nerfstudio(more, "");
    let read = |more: &str| dataset::read(lists(more).path()).unwrap();
    let found = read(
        r#""train_filenames": ["r_3.png", "./r_0.png"],
        "val_filenames": ["r_2.png"], "test_filenames": ["r_2.png"],"#,
    );
    let names = |views: &[trainer_host::train::PosedPhotograph]| -> Vec<String> {
        views.iter().map(|view| view.name.clone()).collect()
    };
    assert_eq!(names(found.train.photographs()), ["./r_0.png", "./r_3.png"]);
    assert_eq!(names(found.validation.photographs()), ["./r_2.png"]);
    assert_eq!(names(found.test.photographs()), ["./r_2.png"]);
    assert_eq!(read("").train.photographs().len(), 4, "without lists all but every eighth");
    for (more, named) in [
        (r#""train_filenames": ["r_9.png"],"#, "train_filenames is r_9.png"),
        (r#""test_filenames": ["r_1.png"],"#, "train_filenames is empty"),
        (r#""train_filenames": ["r_1.png"], "val_filenames": ["./r_1.png"],"#, "val_filenames is ./r_1.png"),
        (r#""train_filenames": "r_1.png","#, "JSON is"),
    ] {
        let text = refusal(lists(more).path());
        assert!(text.contains("transforms.json: ") && text.contains(named), "{more}: {text}");
    }
}

#[test]
fn masks_of_frames_say_which_pixels_count() {
    let folder = nerfstudio("", r#""mask_path": "mask.png", "#);
    let mask = folder.path().join("mask.png");
    let mut image = image::GrayImage::new(16, 12);
    image.put_pixel(3, 2, image::Luma([255]));
    image.save(&mask).unwrap();
    let read = dataset::read(folder.path()).unwrap();
    let masks: Vec<_> = read.train.photographs().iter().map(|view| view.counted.as_ref()).collect();
    assert!(masks[0].is_none() && masks[1].unwrap().at(3, 2) && !masks[1].unwrap().at(4, 2));
    image::GrayImage::new(8, 6).save(&mask).unwrap();
    let text = refusal(folder.path());
    assert!(text.contains("mask.png: size is 8 x 6; that of its image is needed"), "{text}");
    fs::remove_file(&mask).unwrap();
    assert!(refusal(folder.path()).contains("mask.png"), "{}", refusal(folder.path()));
}

/// One mask that leaves nothing is of a photograph; all of them are of the training.
#[test]
fn masks_that_leave_no_pixel_to_train_on_are_refused() {
    let folder = nerfstudio(
        r#""train_filenames": ["r_1.png"], "test_filenames": ["r_2.png"],"#,
        r#""mask_path": "mask.png", "#,
    );
    let mut image = image::GrayImage::new(16, 12);
    let mask = folder.path().join("mask.png");
    image.save(&mask).unwrap();
    let text = refusal(folder.path());
    let named = "mask.png: mask, as those of all 1 photographs to train on, is without a pixel that counts";
    assert!(text.contains(named) && text.contains(" at 16 x 12; at least 1 is needed"), "{text}");
    image.put_pixel(3, 2, image::Luma([255]));
    image.save(&mask).unwrap();
    assert!(dataset::read(folder.path()).is_ok());
    let error = dataset::read_reduced(folder.path(), 8).unwrap_err().to_string();
    assert!(error.contains("without a pixel that counts at 8 x 6"), "{error}");

    let others = nerfstudio("", r#""mask_path": "mask.png", "#);
    image::GrayImage::new(16, 12).save(others.path().join("mask.png")).unwrap();
    assert_eq!(dataset::read(others.path()).unwrap().train.photographs().len(), 4);
}

#[test]
fn a_jpeg_that_is_cut_off_is_refused_by_name() {
    let folder = nerfstudio("", "");
    let text = fs::read_to_string(folder.path().join("transforms.json")).unwrap();
    fs::write(folder.path().join("transforms.json"), text.replace("r_2.png", "r_2.jpg")).unwrap();
    let path = folder.path().join("r_2.jpg");
    image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([(x * y) as u8, 9, y as u8])).save(&path).unwrap();
    assert!(dataset::read(folder.path()).is_ok());
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
    let text = refusal(folder.path());
    assert!(text.contains("r_2.jpg: image codec: cut off: "), "{text}");
}

/// A reconstruction of COLMAP as text: images of these names, 32 x 24 pixels, of a camera of 64 x 48.
fn colmap(names: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("sparse/0")).unwrap();
    fs::create_dir(folder.path().join("images")).unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join("sparse/0").join(name), text).unwrap();
    write("cameras.txt", "1 PINHOLE 64 48 60 60 32 24\n");
    let image = |(index, name): (usize, &&str)| {
        image::RgbImage::new(32, 24).save(folder.path().join("images").join(name)).unwrap();
        format!("{index} 1 0 0 0 0 0 {} 1 {name}\n\n", index + 4)
    };
    write("images.txt", &names.iter().enumerate().map(image).collect::<String>());
    write("points3D.txt", "1 0 0 0 255 0 51 0.3\n");
    folder
}

#[test]
fn a_colmap_dataset_is_read_and_refused_by_file_and_name() {
    let folder = colmap(&["a.png", "b.png", "c.png"]);
    let read = dataset::read(folder.path()).unwrap();
    assert_eq!((read.train.photographs().len(), read.test.photographs().len()), (2, 1));
    assert_eq!(read.train.photographs()[0].camera.intrinsics().fx, 30.0);
    // One row less is no copy of what the camera saw.
    image::RgbImage::new(32, 23).save(folder.path().join("images/b.png")).unwrap();
    let text = refusal(folder.path());
    assert!(text.contains("b.png: size is 32 x 23, of a camera of 64 x 48; that of its camera"), "{text}");
    fs::write(folder.path().join("sparse/0/points3D.txt"), "# one\n1 0 0 nan 255 0 51 0.3\n").unwrap();
    image::RgbImage::new(32, 24).save(folder.path().join("images/b.png")).unwrap();
    let text = refusal(folder.path());
    assert!(text.contains("points3D.txt: line 2: position is 0 0 nan; "), "{text}");

    let text = refusal(colmap(&["a.png", "b.png", "a.png"]).path());
    assert!(text.contains("images.txt: name of two images is a.png; each name once"), "{text}");
}

/// Photographs that are reduced as they are read are those that are read and reduced, and test photographs
/// may be twice as large.
#[test]
fn large_photographs_are_reduced_as_they_are_read() {
    let folder =
        nerfstudio(r#""train_filenames": ["r_0.png", "r_1.png"], "test_filenames": ["r_2.png"],"#, "");
    let noise =
        image::RgbaImage::from_fn(96, 72, |x, y| image::Rgba([(x * y) as u8, (7 * x) as u8, y as u8, 255]));
    (0..4).for_each(|k| noise.save(folder.path().join(format!("r_{k}.png"))).unwrap());
    let (whole, (reduced, report)) =
        (dataset::read(folder.path()).unwrap(), dataset::read_reduced(folder.path(), 24).unwrap());
    assert_eq!((whole.test_scale, reduced.test_scale, report.trimmed), (1, 2, None));
    for (whole, reduced, size) in [
        (&whole.train.photographs()[1], &reduced.train.photographs()[1], (24, 18)),
        (&whole.test.photographs()[0], &reduced.test.photographs()[0], (48, 36)),
    ] {
        assert_eq!(reduced.photograph, whole.photograph.resized(size.0, size.1).unwrap());
        assert_eq!((reduced.camera.width(), reduced.camera.height()), size);
        assert!((reduced.camera.intrinsics().fx * 96.0 / f64::from(size.0) - 120.0).abs() < 1e-9);
    }
    let (cut, report) = dataset::read_reduced(folder.path(), 41).unwrap();
    assert_eq!(
        cut.train.photographs()[0].photograph,
        whole.train.photographs()[0].photograph.resized(32, 24).unwrap()
    );
    assert_eq!((cut.test_scale, report.trimmed), (1, None), "no whole number is half of three");
}

/// A header that claims what no file of its length holds is refused before memory is taken.
#[test]
fn absurd_sizes_are_refused_before_decoding() {
    let folder = nerfstudio("", "");
    let path = folder.path().join("r_2.png");
    let mut bytes = fs::read(&path).unwrap();
    bytes[16..20].copy_from_slice(&16_000u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&12_000u32.to_be_bytes());
    let sum = crc32fast::hash(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&sum.to_be_bytes());
    fs::write(&path, bytes).unwrap();
    let text = refusal(folder.path());
    assert!(
        text.contains("r_2.png: image codec: 16000 x 12000 pixels") && text.contains("holds at most"),
        "{text}"
    );
}

/// Units are any: cameras of a scene a thousand times smaller see it too.
#[test]
fn near_planes_follow_scenes_that_are_small_in_their_units() {
    let near = |distance: f64| {
        let folder = folder();
        let matrix = |x: f64, z: f64, turned: bool| {
            let rows = if turned { ["0,0,1", "0,1,0", "-1,0,0"] } else { ["1,0,0", "0,1,0", "0,0,1"] };
            format!("[[{},{x}],[{},0],[{},{z}],[0,0,0,1]]", rows[0], rows[1], rows[2])
        };
        let frames = [
            frame("./train/r_0", 0.0, &matrix(0.0, distance, false)),
            frame("./train/r_1", 1.0, &matrix(distance, 0.0, true)),
        ];
        write_split(folder.path(), "train", &frames);
        dataset::read(folder.path()).unwrap().train.photographs()[1].camera.near()
    };
    assert_eq!(near(4.0), 0.01, "as it is");
    assert!(near(0.004) < 0.0004, "{}", near(0.004));
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
    assert!(read.train.photographs()[0].foreground.is_none(), "no masks");
    fs::create_dir_all(folder.path().join("seg/4")).unwrap();
    let text = refusal(folder.path());
    assert!(text.contains("seg/4/0.png"), "a camera has masks of all its images: {text}");
    for k in 0..2 {
        let mut mask = image::GrayImage::new(16, 12);
        mask.put_pixel(3 + k, 2, image::Luma([255]));
        mask.save(folder.path().join(format!("seg/4/{k}.png"))).unwrap();
    }
    let read = dataset::read(folder.path()).unwrap();
    let mask = read.train.photographs()[1].foreground.as_ref().unwrap();
    assert!(mask.at(4, 2) && !mask.at(3, 2));
    image::GrayImage::new(8, 12).save(folder.path().join("seg/4/1.png")).unwrap();
    let text = refusal(folder.path());
    assert!(text.contains("seg/4/1.png: size is 8 x 12; that of its image"), "{text}");
    write("[]");
    let text = refusal(folder.path());
    assert!(text.contains("k and w2c of frame 0 is 0 and 1 cameras"), "{text}");
    let path = folder.path().join("train_meta.json");
    for none in ["[]", "[[],[]]"] {
        let text = format!(r#"{{"w":16,"h":12,"k":{none},"w2c":{none},"fn":{none}}}"#);
        fs::write(&path, text).unwrap();
        let text = refusal(folder.path());
        assert!(text.contains("train_meta.json: fn is empty; at least 1 photograph"), "{text}");
    }
}

/// A meta file of the Panoptic layout: so many frames of one camera, of images of this name.
fn meta(frames: usize, name: &dyn Fn(usize) -> String) -> String {
    let list = |of: &dyn Fn(usize) -> String| (0..frames).map(of).collect::<Vec<_>>().join(",");
    format!(
        r#"{{"w":16,"h":12,"k":[{}],"w2c":[{}],"fn":[{}]}}"#,
        list(&|_| "[[[20,0,8],[0,20,6],[0,0,1]]]".to_owned()),
        list(&|_| "[[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]]".to_owned()),
        list(&|frame| format!("[{:?}]", name(frame)))
    )
}

#[test]
fn frames_for_testing_are_at_the_times_of_those_for_training() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for camera in ["ims/0", "ims/1"] {
        fs::create_dir_all(at(camera)).unwrap();
        (0..6).for_each(|frame| write_png(&at(&format!("{camera}/{frame}.png")), 16, 12));
    }
    fs::write(at("train_meta.json"), meta(5, &|frame| format!("1/{frame}.png"))).unwrap();
    let test = |frames: usize| {
        fs::write(at("test_meta.json"), meta(frames, &|frame| format!("0/{frame}.png"))).unwrap();
    };
    test(3);
    let read = dataset::read(folder.path()).unwrap();
    let times = |views: &[trainer_host::train::PosedPhotograph]| -> Vec<f32> {
        views.iter().map(|view| view.time).collect()
    };
    assert_eq!(times(read.train.photographs()), [0.0, 0.25, 0.5, 0.75, 1.0]);
    assert_eq!(times(read.test.photographs()), [0.0, 0.25, 0.5]);
    // As cameras to render from, they are at the same times.
    let cameras = dataset::panoptic_cameras(&at("test_meta.json")).unwrap();
    assert_eq!(cameras.iter().map(|view| view.time).collect::<Vec<_>>(), [Some(0.0), Some(0.25), Some(0.5)]);
    test(6);
    let text = refusal(folder.path());
    let named = "test_meta.json: fn is 6 frames long, where train_meta.json has 5; at most as many";
    assert!(text.contains(named), "{text}");
    // Alone it is a clip of its own.
    fs::rename(at("train_meta.json"), at("other.json")).unwrap();
    let cameras = dataset::panoptic_cameras(&at("test_meta.json")).unwrap();
    assert_eq!((cameras.len(), cameras[1].time), (6, Some(0.2)));
}

/// Such a name would make a photograph its own mask.
#[test]
fn images_outside_of_their_folder_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for inside in ["ims/1", "seg/1"] {
        fs::create_dir_all(folder.path().join(inside)).unwrap();
        (0..2).for_each(|frame| write_png(&folder.path().join(format!("{inside}/{frame}.png")), 16, 12));
    }
    let write = |inside: &str| {
        let text = meta(2, &|frame| format!("{inside}1/{frame}.png"));
        fs::write(folder.path().join("train_meta.json"), text).unwrap();
    };
    write("./");
    assert!(dataset::read(folder.path()).is_ok());
    let absolute = format!("{}/ims/", folder.path().display());
    for outside in [absolute.as_str(), "../ims/"] {
        write(outside);
        let text = refusal(folder.path());
        let named = format!("train_meta.json: fn is {outside}1/0.png; the path of an image within ims");
        assert!(text.contains(&named), "{text}");
    }
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
    assert!(basketball.train.photographs().iter().all(|view| view.foreground.is_some()));
    assert!(basketball.test.photographs().iter().all(|view| view.foreground.is_none()), "it has none");
    assert_eq!(lego.train.photographs()[0].camera.near(), 0.01, "as it is");
}
