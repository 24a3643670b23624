//! Lists the cases, family by family.

use codec_core::{Gaussian, ShDegree};
use render_host::{Camera, Intrinsics, Settings};
use trainer_host::activation::sigmoid;

use super::{
    StressCase,
    parts::{BOUND, IDENTITY, ball, camera, fallback, neighbours},
    poison,
};

/// Every case. `million` Gaussians in the cases of a million, on smaller images where it is below 100,000.
pub fn cases(million: usize) -> Vec<StressCase> {
    let mut out = Vec::new();
    quaternions(&mut out);
    scales(&mut out);
    opacities(&mut out);
    near_plane(&mut out);
    inside(&mut out);
    far(&mut out);
    ties(&mut out);
    harmonics(&mut out);
    out.extend(poison::cases());
    image_sizes(&mut out);
    settings(&mut out);
    crowds(&mut out, million);
    out
}

/// 4,000 discs of `opacity` one behind the other, and nothing that ends a pixel early.
pub fn discs(opacity: f32) -> StressCase {
    let disc = |i: usize| Gaussian {
        position: [0.0, 0.0, 1e-4 * i as f32],
        scale: [0.5, 0.5, 0.01],
        opacity,
        ..ball()
    };
    let settings = Settings { early_stop: false, ..Settings::default() };
    let name = format!("opacity {opacity}");
    StressCase { settings, ..plain("discs", name, (0..4000).map(disc).collect(), camera(96, 72)) }
}

/// Numbers from a seed (a 64-bit linear congruence; top bits), uniform in 0..1.
struct TestRng(u64);

impl TestRng {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 40) as f32 / (1u64 << 24) as f32)
    }

    /// `n` Gaussians about the origin with scales around `scale`.
    fn cloud(&mut self, n: usize, scale: f32) -> Vec<Gaussian> {
        let mut one = || Gaussian {
            position: [0; 3].map(|_| self.between(-1.0, 1.0)),
            scale: [0; 3].map(|_| scale * self.between(0.3, 1.0)),
            rotation: [0; 4].map(|_| self.between(-1.0, 1.0)),
            opacity: self.between(0.05, 1.0),
            sh0: [0; 3].map(|_| self.between(-1.5, 1.5)),
        };
        (0..n).map(|_| one()).collect()
    }
}

fn plain(
    family: &'static str,
    name: impl Into<String>,
    gaussians: Vec<Gaussian>,
    camera: Camera,
) -> StressCase {
    StressCase {
        family,
        name: name.into(),
        gaussians,
        rest: Vec::new(),
        degree: ShDegree::ZERO,
        camera,
        settings: Settings::default(),
        bound: Some(BOUND),
        skipped: None,
    }
}

/// One Gaussian between its neighbours on a small image.
fn small(family: &'static str, name: impl Into<String>, g: Gaussian) -> StressCase {
    plain(family, name, neighbours(g), camera(48, 32))
}

fn quaternions(out: &mut Vec<StressCase>) {
    let family = "quaternion";
    let turned = |rotation: [f32; 4]| Gaussian { rotation, ..ball() };
    let skipped = |case: StressCase, n| StressCase { skipped: Some(n), ..case };
    out.push(skipped(small(family, "zero", turned([0.0; 4])), 1));
    out.push(skipped(small(family, "denormal", turned([1e-45, 0.0, 1e-44, 0.0])), 1));
    out.push(skipped(small(family, "length 1e-7, no direction", turned([1e-7, 0.0, 0.0, 0.0])), 1));
    for (name, factor) in
        [("length 1e-5", 1e-5f32), ("length 100", 100.0), ("length 1e18", 1e18), ("length 3e38", 3e38)]
    {
        out.push(skipped(small(family, name, turned(ball().rotation.map(|v| v * factor))), 0));
    }
    out.push(skipped(small(family, "negated", turned(ball().rotation.map(|v| -v))), 0));
}

fn scales(out: &mut Vec<StressCase>) {
    for exponent in -12..=6 {
        let scale = 10f32.powi(exponent);
        out.push(small(
            "scale 1e-12 to 1e6",
            format!("scale {scale:e}"),
            Gaussian { scale: [scale; 3], ..ball() },
        ));
        let wide = Gaussian { scale: [scale, 0.1, 0.1], ..ball() };
        out.push(small("scale 1e-12 to 1e6", format!("one axis of {scale:e}"), wide));
    }
    let shapes: [(&str, [f32; 3]); 6] = [
        ("needle 1e4 by 1e-4", [1e4, 1e-4, 1e-4]),
        ("disc 1e4 by 1e-4", [1e4, 1e4, 1e-4]),
        ("needle 1 by 1e-8", [1.0, 1e-8, 1e-8]),
        ("needle 1e6 by 1e-2", [1e6, 1e-2, 1e-2]),
        ("all axes 0", [0.0; 3]),
        ("one axis 0", [0.3, 0.3, 0.0]),
    ];
    for (name, scale) in shapes {
        for (k, rotation) in
            [[1.0, 0.0, 0.0, 0.0], [0.9, 0.1, 0.3, 0.4], [0.7, 0.0, 0.7, 0.0]].into_iter().enumerate()
        {
            let g = Gaussian { scale, rotation, ..ball() };
            out.push(small("anisotropy 1e8", format!("{name}, turn {k}"), g));
        }
    }
    for low_pass in [0.0, 100.0] {
        for scale in [0.0, 1e-12, 1e-3, 0.3, 1e6] {
            let case = small(
                "low pass 0 and 100",
                format!("low pass {low_pass}, scale {scale:e}"),
                Gaussian { scale: [scale; 3], ..ball() },
            );
            out.push(StressCase { settings: Settings { low_pass, ..Settings::default() }, ..case });
        }
    }
}

fn opacities(out: &mut Vec<StressCase>) {
    let family = "opacity";
    let of = |name: &'static str, opacity: f32, skipped: u64| StressCase {
        skipped: Some(skipped),
        ..small(family, name, Gaussian { opacity, ..ball() })
    };
    out.push(of("0", 0.0, 1));
    out.push(of("-0", -0.0, 1));
    out.push(of("1", 1.0, 0));
    out.push(of("logit -infinity", sigmoid(f32::NEG_INFINITY), 1));
    out.push(of("logit +infinity", sigmoid(f32::INFINITY), 0));
    out.push(of("logit -88", sigmoid(-88.0), 1));
    out.push(of("logit 88", sigmoid(88.0), 0));
    out.push(of("above 1", 7.0, 0));
    out.push(of("below 0", -1.0, 1));
    out.push(of("next below 1", 1.0 - f32::EPSILON / 2.0, 0));
    out.push(of("at the cut-off", 1.0 / 255.0, 0));
    out.push(of("below the cut-off", 0.0039, 1));
    let settings = Settings { alpha_max: 1.0, ..Settings::default() };
    out.push(StressCase { settings, ..of("1, alpha not clamped", 1.0, 0) });
    let settings = Settings { alpha_cutoff: 0.0, ..Settings::default() };
    out.push(StressCase { settings, ..of("denormal, no cut-off", 1e-45, 0) });
}

fn near_plane(out: &mut Vec<StressCase>) {
    let family = "near plane";
    // The camera is at z = -4, its near plane 0.01 before it.
    let at = |z: f32, scale: f32| Gaussian { position: [0.0, 0.0, z], scale: [scale; 3], ..ball() };
    let next = |z: f32, ulps: i32| f32::from_bits((z.to_bits() as i32 + ulps) as u32);
    for (name, z, scale) in [
        ("at it", -3.99f32, 0.001),
        ("one ulp before it", next(-3.99, -1), 0.001),
        ("one ulp behind it", next(-3.99, 1), 0.001),
        ("across it", -3.985, 0.5),
        ("across it, centre behind", -3.995, 0.5),
        ("at the camera", -4.0, 0.5),
        ("behind the camera", -4.5, 0.1),
        ("behind the camera, reaching before it", -4.5, 3.0),
        ("far behind", -1e6, 1.0),
        ("just before it, tiny", -3.98, 1e-9),
        ("just before it, huge", -3.98, 1e6),
    ] {
        out.push(small(family, name, at(z, scale)));
    }
    let beside = Gaussian { position: [3.0, 0.0, -3.98], scale: [1.0; 3], ..ball() };
    out.push(small(family, "beside the camera, reaching in", beside));
    for (name, near, z) in [("near plane 1e-9, Gaussian at it", 1e-9, 1e-6f32), ("near plane 1e9", 1e9, 5.0)]
    {
        let eye =
            Camera::new(camera(48, 32).intrinsics(), IDENTITY, [0.0; 3]).and_then(|c| c.with_near(near));
        let g = Gaussian { position: [0.0, 0.0, z], ..ball() };
        out.push(plain(family, name, neighbours(g), fallback(eye)));
    }
}

fn inside(out: &mut Vec<StressCase>) {
    let family = "camera inside a Gaussian";
    for (name, distance, scale) in [
        ("deep inside", 0.02f32, 1.0),
        ("at its surface", 1.0, 1.0),
        ("inside a huge one", 0.5, 1e6),
        ("off its centre", 0.1, 10.0),
    ] {
        let g = Gaussian { position: [0.01, -0.02, distance - 4.0], scale: [scale; 3], ..ball() };
        out.push(small(family, name, g));
    }
    let mut cloud = TestRng(5).cloud(60, 3.0);
    cloud.iter_mut().for_each(|g| g.position[2] -= 4.0);
    out.push(plain(family, "inside sixty", cloud, camera(48, 32)));
}

fn far(out: &mut Vec<StressCase>) {
    let family = "coordinates at 1e6";
    for (name, offset) in
        [("x", [1e6, 0.0, 0.0]), ("all axes", [1e6f32; 3]), ("negative", [-1e6; 3]), ("1e9", [1e9; 3])]
    {
        let mut cloud = TestRng(7).cloud(60, 0.4);
        cloud.iter_mut().for_each(|g| g.position = std::array::from_fn(|k| g.position[k] + offset[k]));
        let eye = std::array::from_fn(|k| f64::from(-offset[k]) + if k == 2 { 4.0 } else { 0.0 });
        let moved = Camera::new(camera(48, 32).intrinsics(), IDENTITY, eye);
        out.push(plain(family, format!("scene and camera at {name}"), cloud, fallback(moved)));
    }
    let mut cloud = TestRng(8).cloud(40, 3e5);
    cloud.iter_mut().for_each(|g| g.position = g.position.map(|p| 1e6 * p));
    let distant = Camera::new(camera(48, 32).intrinsics(), IDENTITY, [0.0, 0.0, 4e6]);
    out.push(plain(family, "scene a million wide", cloud, fallback(distant)));
    let telescope = Intrinsics { fx: 1e9, fy: 1e9, ..camera(48, 32).intrinsics() };
    let camera = Camera::new(telescope, IDENTITY, [0.0, 0.0, 4.0]);
    out.push(plain(
        family,
        "focal length 1e9",
        neighbours(Gaussian { scale: [1e-8; 3], ..ball() }),
        fallback(camera),
    ));
}

fn ties(out: &mut Vec<StressCase>) {
    let family = "coincident depths, duplicates";
    let mut plane = TestRng(9).cloud(200, 0.3);
    plane.iter_mut().for_each(|g| g.position[2] = 0.25);
    out.push(plain(family, "200 at one depth", plane, camera(48, 32)));
    out.push(plain(family, "50 equal ones", vec![ball(); 50], camera(48, 32)));
    let mut twice = TestRng(10).cloud(60, 0.3);
    twice.extend_from_within(..);
    out.push(plain(family, "60 twice", twice, camera(48, 32)));
    let mut close = TestRng(11).cloud(200, 0.3);
    close
        .iter_mut()
        .enumerate()
        .for_each(|(i, g)| g.position[2] = f32::from_bits(0.25f32.to_bits() + (i as u32 * 37) % 200));
    out.push(plain(family, "200 one ulp apart", close, camera(48, 32)));
}

fn harmonics(out: &mut Vec<StressCase>) {
    let family = "huge harmonics";
    for size in [1e6f32, 1e18, 1e30, 1e38] {
        out.push(small(
            family,
            format!("sh0 of {size:e}"),
            Gaussian { sh0: [size, -size, 0.1 * size], ..ball() },
        ));
        for degree in 1..=3 {
            let degree = ShDegree::new(degree).unwrap_or_default();
            let rest = (0..3 * degree.rest_len()).map(|i| size * ((i * i) as f32).sin()).collect();
            let case = small(family, format!("sh rest of {size:e}, degree {}", degree.get()), ball());
            out.push(StressCase { rest, degree, ..case });
        }
    }
    let degree = ShDegree::MAX;
    // All bands point at the camera and add up beyond f32.
    let rest = vec![f32::MAX; 3 * degree.rest_len()];
    out.push(StressCase { rest, degree, ..small(family, "sh rest of the largest f32", ball()) });
    let same = vec![Gaussian { sh0: [3e38; 3], opacity: 1.0, ..ball() }; 30];
    out.push(plain(family, "thirty of sh0 3e38", same, camera(48, 32)));
}

fn image_sizes(out: &mut Vec<StressCase>) {
    let family = "film sizes";
    for (w, h) in [(1, 1), (2, 1), (16, 16), (17, 15), (8192, 3), (3, 8192), (8192, 40), (16_384, 1)] {
        let mut cloud = TestRng(12).cloud(40, 0.4);
        // Spread over the wide images, which show more of the world.
        let aspect = f64::from(w) / f64::from(h);
        cloud.iter_mut().for_each(|g| g.position[0] *= aspect.clamp(1.0, 400.0) as f32);
        out.push(plain(family, format!("{w} x {h}"), cloud, camera(w, h)));
    }
    for (w, h) in [(1, 1), (48, 32), (8192, 3)] {
        let settings = Settings::over([0.25, 0.5, 0.75]);
        out.push(StressCase {
            settings,
            ..plain("zero Gaussians", format!("{w} x {h}"), Vec::new(), camera(w, h))
        });
    }
}

fn settings(out: &mut Vec<StressCase>) {
    let family = "precisions";
    for (name, settings) in [
        ("16 depth bits", Settings { depth_bits: 16, ..Settings::default() }),
        ("f16 attributes", Settings { half_attributes: true, ..Settings::default() }),
        (
            "f16 attributes, low pass 0",
            Settings { half_attributes: true, low_pass: 0.0, ..Settings::default() },
        ),
    ] {
        let mut cloud = TestRng(13).cloud(100, 0.3);
        for (i, exponent) in (-12..=6).enumerate() {
            cloud[i].scale = [10f32.powi(exponent), 0.1, 0.1];
            cloud[30 + i].scale = [10f32.powi(exponent); 3];
        }
        out.push(StressCase { settings, bound: None, ..plain(family, name, cloud, camera(48, 32)) });
    }
    let exact = "nothing cut, nothing stopped";
    let cloud = TestRng(14).cloud(500, 0.4);
    out.push(StressCase {
        settings: Settings::exact(),
        ..plain("exact settings", exact, cloud, camera(48, 32))
    });
    let bright = Settings::over([1e6, -1e6, 0.0]);
    out.push(StressCase {
        settings: bright,
        ..plain("exact settings", "background of 1e6", neighbours(ball()), camera(48, 32))
    });
}

fn crowds(out: &mut Vec<StressCase>, million: usize) {
    let family = "a million coincident";
    let dot = Gaussian { scale: [0.02; 3], ..ball() };
    let faint = Gaussian { opacity: 0.006, ..ball() };
    let cover = Gaussian { scale: [50.0; 3], opacity: 0.5, ..ball() };
    let veil = Gaussian { scale: [50.0; 3], opacity: 0.006, ..ball() };
    let few = million < 100_000;
    let (square, wide) = if few { ((80, 80), (820, 16)) } else { ((800, 800), (8192, 64)) };
    for (name, g, (w, h)) in [
        ("dots", dot, (48, 32)),
        ("faint balls", faint, (48, 32)),
        ("veils over everything", veil, (48, 32)),
        ("covers of a square image", cover, square),
        ("veils over a wide image", veil, wide),
    ] {
        let case = plain(family, format!("{million} {name}, {w} x {h}"), vec![g; million], camera(w, h));
        out.push(StressCase { skipped: Some(0), ..case });
    }
    let mut walls = TestRng(15).cloud(million / 50, 1e5);
    let side = if few { 104 } else { 1024 };
    walls.iter_mut().for_each(|g| g.opacity = 0.3);
    let case = plain(
        "many over everything",
        format!("{} over an image of {side} x {side}", walls.len()),
        walls,
        camera(side, side),
    );
    out.push(case);
}
