//! Compares with what the programs that train such networks make of them: see `tests/deformation/make.py`.

use safetensors::{SafeTensors, tensor::TensorView};

use super::*;
use crate::scene::import::{ErrorKind, ImportOptions, import, ply::tests::sample};

macro_rules! file {
    ($name:literal) => {
        include_bytes!(concat!("../../../../tests/deformation/", $name)).as_slice()
    };
}

pub const PLANES: &[u8] = file!("planes.npz");
const ALL: &[u8] = file!("planes-all.safetensors");
const ALL_OPTIONS: &[u8] = file!("planes-all-cfg_args");

/// Frames of the files.
const FRAMES: usize = 5;

fn parsed(bytes: &[u8], options: Option<&[u8]>) -> Result<Scene, ImportError> {
    parse(bytes, SidecarFiles { gaussians: None, options }, FRAMES, 30.0, &Limits::default())
}

/// The largest difference of any value of `scene` from what is expected.
fn difference(scene: &Scene, expected: &[u8]) -> f32 {
    let limits = Limits::default();
    let mut expected = Tensors::open(expected, &limits, FORMAT).unwrap();
    let epoch = &scene.epochs()[0];
    let (n, a) = (epoch.count(), epoch.attributes());
    let mut get = |name: &str, width: usize| {
        expected.get(name).unwrap().expect(FORMAT, name, &[FRAMES, n, width]).unwrap().values
    };
    let mut worst = 0f32;
    let mut compare = |ours: &[f32], theirs: &[f32]| {
        assert_eq!(ours.len(), theirs.len());
        let far = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs());
        worst = far.fold(worst, |worst, far| if far <= worst { worst } else { far });
    };
    let (positions, log_scales) = (get("positions", 3), get("log_scales", 3));
    let (rotations, opacities) = (get("rotations", 4), get("opacity_logits", 1));
    let harmonics = get("harmonics", 48);
    let mut mean_rest = vec![0f32; n * 45];
    for t in 0..FRAMES {
        let of_frame = |values: &[f32], width: usize| values[t * n * width..(t + 1) * n * width].to_vec();
        compare(a.positions.frame(t, n).as_flattened(), &of_frame(&positions, 3));
        compare(a.log_scales.frame(t, n).as_flattened(), &of_frame(&log_scales, 3));
        compare(a.opacity_logits.frame(t, n), &of_frame(&opacities, 1));
        // A quaternion and its negative are the same turn.
        for (ours, theirs) in a.rotations.frame(t, n).iter().zip(of_frame(&rotations, 4).as_chunks::<4>().0) {
            let dot: f32 = ours.iter().zip(theirs).map(|(a, b)| a * b).sum();
            compare(ours, &theirs.map(|v| v * dot.signum()));
        }
        for (i, theirs) in of_frame(&harmonics, 48).as_chunks::<48>().0.iter().enumerate() {
            compare(&a.sh0.frame(t, n)[i], &theirs[..3]);
            let mean = mean_rest[45 * i..].iter_mut().zip(&theirs[3..]);
            mean.for_each(|(mean, value)| *mean += value / FRAMES as f32);
        }
    }
    compare(&a.sh_rest, &mean_rest);
    worst
}

#[test]
fn networks_move_gaussians_as_their_trainers_do() {
    for (name, bytes, options, expected) in [
        ("planes", PLANES, None, file!("planes-expected.npz")),
        ("planes-all", ALL, Some(ALL_OPTIONS), file!("planes-all-expected.npz")),
        (
            "planes-still",
            file!("planes-still.npz"),
            Some(file!("planes-still-cfg_args")),
            file!("planes-still-expected.npz"),
        ),
        ("warp", file!("warp.npz"), None, file!("warp-expected.npz")),
        ("warp-screw", file!("warp-screw.npz"), None, file!("warp-screw-expected.npz")),
    ] {
        let scene = parsed(bytes, options).unwrap();
        let worst = difference(&scene, expected);
        println!("{name}: {worst:e}");
        assert!(worst < 5e-5, "{name}: a value is off by {worst}");
        assert!(!scene.epochs()[0].attributes().opacity_logits.is_constant() || name != "planes-still");
    }
}

#[test]
fn what_does_not_move_is_seen_in_the_comparison() {
    let still = parsed(PLANES, Some(b"{\"no_dx\": true}")).unwrap();
    assert!(still.epochs()[0].attributes().positions.is_constant());
    assert!(difference(&still, file!("planes-expected.npz")) > 0.1);
}

#[test]
fn notes_say_what_is_taken_for_granted() {
    let scene = parsed(PLANES, None).unwrap();
    assert!(scene.notes.iter().any(|note| note.contains("no cfg_args")), "{:?}", scene.notes);
    let scene = parsed(ALL, Some(ALL_OPTIONS)).unwrap();
    assert!(!scene.notes.iter().any(|note| note.contains("no cfg_args")), "{:?}", scene.notes);
    assert!(scene.notes.iter().any(|note| note.contains("higher harmonics")), "{:?}", scene.notes);
}

/// The file with each tensor's shape as `edit` gives it, or without it.
fn edited(edit: impl Fn(&str, &[usize]) -> Option<Vec<usize>>) -> Vec<u8> {
    let file = SafeTensors::deserialize(ALL).unwrap();
    let remaining = file.iter().filter_map(|(name, view)| {
        let shape = edit(name, view.shape())?;
        Some((name.to_owned(), TensorView::new(view.dtype(), shape, view.data()).unwrap()))
    });
    safetensors::serialize(remaining.collect::<Vec<_>>(), None).unwrap()
}

#[test]
fn arrays_that_are_missing_or_misshapen_are_named() {
    let file = SafeTensors::deserialize(ALL).unwrap();
    let mut read = 0;
    for name in file.names() {
        let missing = edited(|other, shape| (other != name).then(|| shape.to_vec()));
        let deeper = edited(|other, shape| {
            let extra = (other == name).then_some(1);
            Some(shape.iter().copied().chain(extra).collect())
        });
        // The trainer writes some that nothing uses.
        let is_unused = name.starts_with("timenet") || name.ends_with("_poc");
        assert_eq!(parsed(&missing, Some(ALL_OPTIONS)).is_ok(), is_unused, "{name}");
        let deeper = parsed(&deeper, Some(ALL_OPTIONS));
        assert_eq!(deeper.is_ok(), is_unused, "{name}");
        if let Err(error) = deeper {
            assert!(error.to_string().contains(name), "{name}: {error}");
            read += 1;
        }
    }
    assert!(read > 30, "{read}");
}

#[test]
fn what_is_not_read_is_refused_by_name() {
    for (options, says) in [
        (&b"{\"no_grid\": true}"[..], "no_grid"),
        (b"{\"grid_pe\": 0}", "grid_pe"),
        (b"{\"grid_pe\": \"x\"}", "options"),
    ] {
        let error = parsed(ALL, Some(options)).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
    let limits = Limits { max_bytes: 30_000, ..Limits::default() };
    let error = parse(ALL, SidecarFiles::default(), 1000, 30.0, &limits).unwrap_err();
    assert_eq!(error.kind, ErrorKind::TooLarge, "{error}");
    let error = parse(
        ALL,
        SidecarFiles { gaussians: Some(&sample("ascii", 0, 3)), options: Some(ALL_OPTIONS) },
        2,
        30.0,
        &Limits::default(),
    )
    .unwrap_err();
    assert!(error.to_string().contains("harmonics of the Gaussians: found 0"), "{error}");
}

#[test]
fn a_training_is_found_by_its_folder() {
    let training = tempfile::tempdir().unwrap();
    let iteration = |kind: &str, number: u32| {
        let folder = training.path().join(format!("{kind}/iteration_{number}"));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    };
    let (early, last) = (iteration("point_cloud", 900), iteration("point_cloud", 3000));
    let ply = sample("binary_little_endian", 45, 4);
    for folder in [&early, &last] {
        std::fs::write(folder.join("point_cloud.ply"), &ply).unwrap();
    }
    std::fs::write(last.join("deformation.npz"), PLANES).unwrap();
    std::fs::write(training.path().join("cfg_args"), b"Namespace(no_dx=True, no_dr=True)").unwrap();
    let options = ImportOptions { deformation_frames: 3, ..ImportOptions::default() };
    for path in [training.path().to_owned(), last.clone(), last.join("deformation.npz")] {
        let scene = import(&path, &options).unwrap();
        assert_eq!((scene.frames(), scene.max_count()), (3, 4));
        let attributes = scene.epochs()[0].attributes();
        assert!(attributes.positions.is_constant() && !attributes.log_scales.is_constant());
    }
    std::fs::write(early.join("deformation.pth"), b"\x80\x02}q\x00.").unwrap();
    let error = import(&early, &options).unwrap_err().to_string();
    assert!(error.contains("numpy.savez") && error.contains("deformation.pth"), "{error}");
    // The other trainer has a folder of its own for networks.
    std::fs::write(iteration("deform", 3000).join("deform.npz"), file!("warp.npz")).unwrap();
    assert_eq!(import(training.path(), &options).unwrap().max_count(), 4);
    std::fs::remove_file(last.join("point_cloud.ply")).unwrap();
    std::fs::write(last.join("deformation.npz"), PLANES).unwrap();
    assert_eq!(import(&last, &options).unwrap().max_count(), 6, "its own Gaussians");
}
