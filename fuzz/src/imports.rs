//! Importers: any bytes give a scene that can be drawn or an error that names a field.

use codec_core::Gaussian;
use trainer_host::{
    Epoch, Scene,
    export::ply as ply_writer,
    import::{self, ErrorKind, Format, ImportError, Limits, Snapshot},
};

use crate::{input::Choices, seal};

/// Small enough that a lie about a size costs nothing.
fn limits(keep_readable: bool) -> Limits {
    Limits { max_gaussians: 50_000, max_bytes: 4 << 20, keep_readable }
}

fn assert_explained(error: &ImportError) {
    assert!(!error.field.is_empty() && !error.allowed.is_empty(), "{error}");
    assert!(error.to_string().contains(&*error.field), "{error}");
}

fn assert_drawable(gaussians: &[Gaussian]) {
    for g in gaussians {
        assert!(g.position.iter().chain(&g.scale).chain(&g.sh0).all(|v| v.is_finite()), "{g:?}");
        let length2: f32 = g.rotation.iter().map(|v| v * v).sum();
        assert!((length2 - 1.0).abs() < 1e-4, "{g:?}");
        assert!((0.0..=1.0).contains(&g.opacity), "{g:?}");
        assert!(g.scale.iter().all(|&s| s > 0.0), "{g:?}");
    }
}

fn assert_epoch(epoch: &Epoch) {
    assert!((1..=limits(false).max_gaussians).contains(&epoch.count()));
    assert_drawable(&epoch.instant(0).gaussians);
    assert_drawable(&epoch.instant(epoch.frames() - 1).gaussians);
}

fn still(data: &[u8], parse: fn(&[u8], &Limits) -> Result<Snapshot, ImportError>) -> Option<Epoch> {
    let strict = parse(data, &limits(false));
    let lenient = parse(data, &limits(true));
    for result in [&strict, &lenient] {
        match result {
            Ok(snapshot) => assert_epoch(&snapshot.epoch),
            Err(error) => assert_explained(error),
        }
    }
    if let (Ok(strict), Ok(lenient)) = (&strict, &lenient) {
        assert_eq!(strict.epoch, lenient.epoch, "keeping what is readable keeps everything of a whole file");
    }
    assert!(strict.is_err() || lenient.is_ok());
    strict.ok().map(|s| s.epoch)
}

fn moving(result: Result<Scene, ImportError>) {
    match result {
        Ok(scene) => scene.epochs().iter().for_each(assert_epoch),
        Err(error) => assert_explained(&error),
    }
}

fn nothing_beside(name: &str) -> Result<Vec<u8>, ImportError> {
    Err(ImportError {
        path: None,
        format: Format::Gltf,
        kind: ErrorKind::Io,
        field: name.into(),
        offset: None,
        found: "nothing".into(),
        allowed: "a file".into(),
    })
}

/// 3DGS PLY; what is read is written and read again.
pub fn ply(data: &[u8]) {
    let Some(epoch) = still(data, import::ply::parse) else { return };
    if epoch.count() > 1000 {
        return;
    }
    let written = ply_writer::encode(&epoch, 0);
    let again = import::ply::parse(&written, &limits(false)).map(|s| s.epoch);
    let Ok(again) = again else {
        assert!(again.is_ok(), "{again:?}");
        return;
    };
    let (a, b) = (epoch.attributes(), again.attributes());
    let n = epoch.count();
    assert_eq!(a.positions.frame(0, n), b.positions.frame(0, n));
    assert_eq!(a.log_scales.frame(0, n), b.log_scales.frame(0, n));
    assert_eq!(a.opacity_logits.frame(0, n), b.opacity_logits.frame(0, n));
    assert_eq!((a.sh_degree, &a.sh_rest), (b.sh_degree, &b.sh_rest));
}

/// Compressed PLY.
pub fn compressed_ply(data: &[u8]) {
    still(data, import::compressed_ply::parse);
}

/// SPZ: a file, or what is in one that is compressed whole (versions 1 to 3).
pub fn spz(data: &[u8]) {
    still(data, import::spz::parse);
    if data.starts_with(b"NGSP") && data.get(4).is_some_and(|&version| version < 4) {
        still(&seal::gzip(data), import::spz::parse);
    }
}

/// Headerless records.
pub fn splat(data: &[u8]) {
    still(data, import::splat::parse);
}

/// SOG archives, and the description of an unpacked one.
pub fn sog(data: &[u8]) {
    if data.starts_with(b"{") {
        match import::sog::parse_files(data, nothing_beside, &limits(false)) {
            Ok(snapshot) => assert_epoch(&snapshot.epoch),
            Err(error) => assert_explained(&error),
        }
        return;
    }
    still(data, import::sog::parse);
    let sealed = seal::zip(data);
    if sealed != data {
        still(&sealed, import::sog::parse);
    }
}

/// NPZ points.
pub fn points_npz(data: &[u8]) {
    moving(import::points_npz::parse(data, 30.0, &limits(false)));
    let sealed = seal::zip(data);
    if sealed != data {
        moving(import::points_npz::parse(&sealed, 30.0, &limits(false)));
    }
}

/// glTF and GLB.
pub fn gltf(data: &[u8]) {
    let clips = import::gltf::clips(data, nothing_beside, &limits(false));
    let options = import::gltf::GltfOptions { samples: 60, ..import::gltf::GltfOptions::default() };
    let parsed = import::gltf::parse(data, nothing_beside, &options, &limits(false));
    assert!(parsed.is_err() || clips.is_ok());
    moving(parsed);
}

/// glTF and GLB of Gaussians.
pub fn gltf_splats(data: &[u8]) {
    still(data, |data, limits| import::gltf_splats::parse(data, nothing_beside, limits));
}

/// Sections of splats.
pub fn ksplat(data: &[u8]) {
    still(data, import::ksplat::parse);
}

/// Splats that move by polynomials.
pub fn splatv(data: &[u8]) {
    moving(import::splatv::parse(data, 30.0, &limits(false)));
    moving(import::splatv::parse(data, 30.0, &limits(true)));
}

/// Gaussians that live and move, by the reader of their format.
pub fn fourdgs(data: &[u8]) {
    moving(import::fourdgs::parse(data, 30.0, &limits(false)));
    moving(import::fourdgs::parse(data, 30.0, &limits(true)));
}

/// A training of Dynamic 3D Gaussians.
pub fn dynamic_npz(data: &[u8]) {
    moving(import::dynamic_npz::parse(data, 30.0, &limits(false)));
    let sealed = seal::zip(data);
    if sealed != data {
        moving(import::dynamic_npz::parse(&sealed, 30.0, &limits(false)));
    }
}

/// A network that moves Gaussians, or the options of one.
pub fn deformation(data: &[u8]) {
    const GOOD: &[u8] = include_bytes!("../corpus/deformation/planes");
    let parse = |file: &[u8], options: Option<&[u8]>| {
        let beside = import::deformation::SidecarFiles { gaussians: None, options };
        import::deformation::parse(file, beside, 3, 30.0, &limits(false))
    };
    if data.starts_with(b"Namespace") || data.starts_with(b"{") {
        moving(parse(GOOD, Some(data)));
        return;
    }
    let everything = br#"{"no_do": false, "no_dshs": false, "apply_rotation": true, "grid_pe": 2}"#;
    for options in [None, Some(&everything[..])] {
        moving(parse(data, options));
        let sealed = seal::zip(data);
        if sealed != data {
            moving(parse(&sealed, options));
        }
    }
}

/// A Unity asset of `n` splats: the description and its five planes.
pub fn unity_planes(n: usize) -> (String, [Vec<u8>; 5]) {
    let description = format!(
        "%YAML 1.1\nMonoBehaviour:\n  m_FormatVersion: 20231020\n  m_SplatCount: {n}\n  m_PosFormat: 2\n  \
         m_ScaleFormat: 2\n  m_SHFormat: 3\n  m_ColorFormat: 2\n"
    );
    // Half-precision 0, 1, 0.25, 0.5, -1.
    let [zero, one, quarter, half, minus] = [0u16, 0x3c00, 0x3400, 0x3800, 0xbc00].map(u16::to_le_bytes);
    let mut chunk = [[zero, one]; 4].concat().concat();
    for v in [-1.0f32, 1.0, -2.0, 2.0, 0.0, 4.0] {
        chunk.extend(v.to_le_bytes());
    }
    chunk.extend([[quarter, half]; 3].concat().concat());
    chunk.extend([[minus, one]; 3].concat().concat());
    let others = (0..n as u32).flat_map(|i| [3 << 30 | 0x1ff << 20 | 0x1ff << 10 | 0x1ff, i % 2048]);
    let planes = [
        chunk.repeat(n.div_ceil(256)),
        (0..n as u32).flat_map(u32::to_le_bytes).collect(),
        others.flat_map(u32::to_le_bytes).collect(),
        (0..2048 * 16).flat_map(|i| [i as u8, 0, 255, 128]).collect(),
        vec![0xff; n * 32],
    ];
    (description, planes)
}

/// Unity assets: the first byte picks which file of a good asset the rest replaces.
pub fn unity(data: &[u8]) {
    let mut choices = Choices::new(data);
    let which = usize::from(choices.u8() % 6);
    let (mut description, mut planes) = (Vec::new(), <[Vec<u8>; 5]>::default());
    let (good, good_planes) = unity_planes(20);
    description.extend_from_slice(good.as_bytes());
    planes.clone_from(&good_planes);
    match which.checked_sub(1) {
        None => description = choices.rest().to_vec(),
        Some(plane) => planes[plane] = choices.rest().to_vec(),
    }
    let asset = import::unity::Asset {
        description: &description,
        chunks: &planes[0],
        positions: &planes[1],
        others: &planes[2],
        colours: &planes[3],
        harmonics: (!planes[4].is_empty()).then_some(&planes[4]),
    };
    match import::unity::parse(&asset, &limits(false)) {
        Ok(snapshot) => assert_epoch(&snapshot.epoch),
        Err(error) => assert_explained(&error),
    }
}
