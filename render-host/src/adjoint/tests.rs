use codec_core::{Gaussian, ShDegree};

use super::{
    loss::{Dissimilarity, Distortion, Linear, Mse},
    term::{CHOICES, DAMAGED, Damage, Term},
    *,
};
use crate::{Image, reference};

struct TestRng(u64);

impl TestRng {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 40) as f32 / (1u64 << 24) as f32)
    }
}

#[derive(Clone)]
struct Scene {
    gaussians: Vec<Gaussian>,
    rest: Vec<f32>,
    degree: ShDegree,
}

impl Scene {
    fn random(n: usize, degree: u8, [small, large]: [f32; 2], seed: u64) -> Self {
        let mut r = TestRng(seed);
        let degree = ShDegree::new(degree).unwrap();
        let gaussians = (0..n)
            .map(|i| Gaussian {
                position: [0; 3].map(|_| r.between(-1.0, 1.0)),
                scale: [0; 3].map(|_| r.between(small.ln(), large.ln()).exp()),
                rotation: [0; 4].map(|_| r.between(-1.5, 1.5)),
                opacity: r.between(0.1, 0.95),
                // Every fifth has a red clamped at 0, far from the clamp; no other colour is near it.
                sh0: [if i % 5 == 4 { -4.0 } else { r.between(0.5, 1.5) }, 0.9, r.between(0.5, 1.5)],
            })
            .collect();
        let rest = (0..n * degree.rest_len()).map(|_| r.between(-0.15, 0.15)).collect();
        Self { gaussians, rest, degree }
    }

    fn splats(&self) -> Splats<'_> {
        Splats::new(&self.gaussians, &self.rest, self.degree).unwrap()
    }
}

fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at([1.9, -2.1, 1.45], [0.1, 0.0, -0.05], [0.0, 0.0, 1.0], 0.95, width, height).unwrap()
}

fn noise(width: u32, height: u32, seed: u64) -> Image {
    let mut r = TestRng(seed);
    Image::new(width, height, (0..3 * width * height).map(|_| r.between(0.0, 1.0)).collect()).unwrap()
}

fn smooth() -> Settings {
    Settings { background: [0.3, 0.6, 0.1], parallel: false, ..Settings::exact() }
}

/// The scenes on which every class is checked and every term must be missed.
fn cases() -> Vec<(&'static str, Scene, Settings)> {
    // Two that are clamped in every pixel and a third that is in none.
    let mut clamped = Scene::random(3, 0, [6.0, 8.0], 5);
    clamped.gaussians.iter_mut().for_each(|g| g.opacity = 0.9);
    clamped.gaussians[2] = Gaussian { scale: [0.2, 0.3, 0.4], opacity: 0.3, ..clamped.gaussians[2] };
    let beside = {
        let mut scene = Scene::random(4, 1, [0.5, 0.9], 8);
        scene.gaussians[0].position = [1.0, 2.1, 0.2];
        scene.gaussians[1].position = [-2.0, 0.4, -1.9];
        scene
    };
    let speck = Settings { antialiased: true, ..smooth() };
    let low = Settings { alpha_max: 0.5, ..smooth() };
    let mut all: Vec<_> =
        (0..=3).map(|d| ("degree", Scene::random(8, d, [0.1, 0.5], 40 + u64::from(d)), smooth())).collect();
    all.push(("needles", Scene::random(8, 0, [0.004, 1.0], 3), smooth()));
    all.push(("specks", Scene::random(8, 1, [0.03, 0.1], 4), speck));
    all.push(("clamped alpha", clamped, low));
    all.push(("beside the image", beside, smooth()));
    all
}

const WORST: f64 = 1e-3;
const L2: f64 = 2e-5;

#[test]
fn every_class_agrees_with_differences_of_the_reference() {
    let camera = camera(24, 18);
    for (name, scene, settings) in cases() {
        let losses: [(&str, Box<dyn Loss>); 4] = [
            ("linear", Box::new(Linear(noise(24, 18, 7)))),
            ("mse", Box::new(Mse::new(noise(24, 18, 9)))),
            ("1 - ssim", Box::new(Dissimilarity::new(noise(24, 18, 9)))),
            ("distortion", Box::new(Distortion::new(noise(24, 18, 9)))),
        ];
        for (which, loss) in losses {
            let check = check(&scene.splats(), &camera, &settings, &*loss).unwrap();
            println!("{name}, degree {}, {which}\n{check}", scene.degree.get());
            for class in &check.classes {
                assert!(class.worst < WORST && class.l2 < L2, "{name}, {which}: {class:?}");
                assert!(class.rough * 10 <= class.compared, "{name}, {which}: {class:?}");
            }
        }
    }
}

#[test]
fn no_term_of_the_chain_rule_can_be_left_out_or_turned() {
    let camera = camera(24, 18);
    let loss = Linear(noise(24, 18, 7));
    for term in Term::ALL {
        for damage in [Damage::Drop, Damage::Flip] {
            if damage == Damage::Flip && CHOICES.contains(&term) {
                continue;
            }
            let mut worst = Vec::new();
            for (name, scene, settings) in cases() {
                DAMAGED.set(Some((term, damage)));
                let check = check(&scene.splats(), &camera, &settings, &loss).unwrap();
                DAMAGED.set(None);
                worst.push((name, check.worst()));
                // One case that misses it is enough.
                if check.worst() > 10.0 * WORST {
                    break;
                }
            }
            assert!(
                worst.iter().any(|(_, w)| *w > 10.0 * WORST),
                "{damage:?} {term:?} is not missed: {worst:?}"
            );
        }
    }
}

fn bits(g: &Gradients) -> Vec<u64> {
    let splat = |s: &SplatGradient| {
        let SplatGradient { position, log_scale, rotation, opacity_logit, sh0, image_mean } = *s;
        let all = position.into_iter().chain(log_scale).chain(rotation).chain([opacity_logit]);
        all.chain(sh0).chain(image_mean).map(|v| u64::from(v.to_bits())).collect::<Vec<_>>()
    };
    let wide = g.background.iter().chain(&g.pose.translation).chain(&g.pose.rotation).chain([&g.loss]);
    let rest = g.sh_rest.iter().map(|v| u64::from(v.to_bits()));
    g.splats.iter().flat_map(splat).chain(rest).chain(wide.map(|v| v.to_bits())).collect()
}

#[test]
fn threads_and_a_used_workspace_do_not_show() {
    let scene = Scene::random(6000, 2, [0.01, 0.1], 1);
    let (camera, loss) = (camera(173, 91), Distortion::new(noise(173, 91, 2)));
    let settings = Settings { background: [0.1, 0.2, 0.3], ..Settings::default() };
    let serial = Settings { parallel: false, ..settings.clone() };
    let mut workspace = Workspace::new();
    let expected = render_and_gradients(&mut workspace, &scene.splats(), &camera, &serial, &loss).unwrap();
    assert!(expected.rendered.counters.pixels_stopped > 0 && expected.loss > 0.0);
    assert_eq!(expected.rendered, crate::render(&scene.splats(), &camera, &settings).unwrap());
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let work = || render_and_gradients(&mut workspace, &scene.splats(), &camera, &settings, &loss);
        let got = pool.install(work).unwrap();
        assert_eq!(bits(&got), bits(&expected), "{threads} threads");
    }
}

/// Against differences of the reference with all opacities of a group scaled.
#[test]
fn presence_is_the_derivative_of_a_factor_before_alpha() {
    let scene = Scene::random(12, 1, [0.1, 0.5], 12);
    let groups: Vec<u32> = (0..12).map(|i| i % 4).collect();
    let (camera, settings) = (camera(24, 18), smooth());
    let loss = Distortion::new(noise(24, 18, 9));
    let mut workspace = Workspace::new();
    render_and_gradients(&mut workspace, &scene.splats(), &camera, &settings, &loss).unwrap();
    let got = workspace.presence(&groups, 4).unwrap();
    for (group, got) in got.iter().enumerate() {
        let at = |h: f32| {
            let mut scene = scene.clone();
            let of_group = scene.gaussians.iter_mut().zip(&groups).filter(|(_, g)| **g as usize == group);
            of_group.for_each(|(gaussian, _)| gaussian.opacity *= 1.0 + h);
            loss.exact(&reference::render(&scene.splats(), &camera, &settings).unwrap().rgb)
        };
        let h = 1.0 / 1024.0;
        let expected = (at(h) - at(-h)) / f64::from(2.0 * h);
        assert!((got - expected).abs() < 1e-4 * expected.abs().max(1e-3), "{group}: {got} {expected}");
    }
    assert!(got.iter().all(|v| v.abs() > 1e-4), "{got:?}");
    assert!(workspace.presence(&groups[1..], 4).unwrap_err().to_string().contains("11 ids for 12"));
    assert_eq!(workspace.presence(&groups, 3).unwrap_err(), AdjointError::Group { group: 3, count: 3 });
}

/// Statistics against what each pixel alone gives: a loss of one pixel's values at a time.
#[test]
fn statistics_are_sums_over_pixels() {
    let scene = Scene::random(9, 1, [0.1, 0.5], 12);
    let (width, height) = (21u32, 18u32);
    let camera = camera(width, height);
    let settings = Settings { background: [0.3, 0.6, 0.1], ..Settings::default() };
    let pull = noise(width, height, 7);
    let (mut workspace, mut out, mut got) = (Workspace::new(), Gradients::default(), Vec::new());
    let mut of = |weights: Image, got: &mut Vec<DensityStatistics>| {
        let (splats, loss) = (scene.splats(), Linear(weights));
        let (workspace, out) = (&mut workspace, &mut out);
        render_and_gradients_with_statistics(workspace, &splats, &camera, &settings, &loss, out, got)
            .unwrap();
        out.clone()
    };
    let whole = of(pull.clone(), &mut got);
    let plain = render_and_gradients(
        &mut Workspace::new(),
        &scene.splats(),
        &camera,
        &settings,
        &Linear(pull.clone()),
    );
    assert_eq!(bits(&whole), bits(&plain.unwrap()), "statistics change no gradient");
    let (mut lengths, mut weights, mut signed) = (vec![0.0f64; 9], vec![0.0f64; 9], vec![[0.0f64; 2]; 9]);
    for pixel in 0..(width * height) as usize {
        for (value, sums) in [(pull.rgb(), true), ([1.0; 3].repeat(378).as_slice(), false)] {
            let mut alone = Image::filled(width, height, [0.0; 3]).unwrap();
            alone.rgb_mut()[3 * pixel..3 * pixel + 3].copy_from_slice(&value[3 * pixel..3 * pixel + 3]);
            if !sums {
                // A pull of 1 on red alone: the gradient of band 0 is the blend weight.
                alone.rgb_mut()[3 * pixel + 1..3 * pixel + 3].fill(0.0);
            }
            let found = of(alone, &mut Vec::new());
            for (i, splat) in found.splats.iter().enumerate() {
                let [x, y] = splat.image_mean.map(f64::from);
                if sums {
                    lengths[i] += x.hypot(y);
                    (signed[i][0], signed[i][1]) = (signed[i][0] + x, signed[i][1] + y);
                } else {
                    weights[i] += f64::from(splat.sh0[0]) / crate::harmonics::C0;
                }
            }
        }
    }
    let mut cancelled = 0;
    for (i, found) in got.iter().enumerate() {
        let length = f64::from(found.gradient);
        assert!((length - lengths[i]).abs() < 1e-4 * lengths[i], "{i}: {length} {}", lengths[i]);
        cancelled += usize::from(signed[i][0].hypot(signed[i][1]) < 0.9 * length);
        // Every fifth has a red clamped at 0, which hides its weight.
        if i % 5 != 4 {
            assert!((f64::from(found.weight) - weights[i]).abs() < 1e-4 * weights[i], "{i}: {found:?}");
        }
        assert!(found.pixels > 0 && found.pixels <= width * height && found.weight <= found.pixels as f32);
    }
    assert!(cancelled > 0, "the signed sums would do");
}

/// Tiles reach beyond the picture; its own pixels alone count.
#[test]
fn statistics_are_of_pixels_of_the_picture() {
    let gaussian = Gaussian { scale: [3.0; 3], opacity: 0.01, sh0: [0.3; 3], ..Gaussian::ABSENT };
    let scene = Scene { gaussians: vec![gaussian], rest: vec![], degree: ShDegree::ZERO };
    let (settings, loss) =
        (Settings { alpha_cutoff: 0.0, ..Settings::default() }, Mse::new(noise(21, 18, 2)));
    let (mut out, mut found) = (Gradients::default(), Vec::new());
    let (splats, camera, mut workspace) = (scene.splats(), camera(21, 18), Workspace::new());
    render_and_gradients_with_statistics(
        &mut workspace,
        &splats,
        &camera,
        &settings,
        &loss,
        &mut out,
        &mut found,
    )
    .unwrap();
    assert_eq!(found[0].pixels, 21 * 18);
    let covered: f64 = out.rendered.transmittance.iter().map(|&t| 1.0 - f64::from(t)).sum();
    assert!((f64::from(found[0].weight) - covered).abs() < 1e-4 * covered, "{covered}");
}

/// Where the picture has no gradient nothing is walked, and statistics still are.
#[test]
fn tiles_without_a_gradient_are_skipped() {
    let scene = Scene::random(40, 0, [0.05, 0.2], 3);
    let camera = camera(96, 64);
    let mut pull = Image::filled(96, 64, [0.0; 3]).unwrap();
    pull.rgb_mut()[3 * (30 * 96 + 50)] = 1.0;
    let (settings, loss) = (Settings { background: [0.5; 3], ..Settings::default() }, Linear(pull));
    let some =
        render_and_gradients(&mut Workspace::new(), &scene.splats(), &camera, &settings, &loss).unwrap();
    let (mut all, mut statistics) = (Gradients::default(), Vec::new());
    let mut workspace = Workspace::new();
    render_and_gradients_with_statistics(
        &mut workspace,
        &scene.splats(),
        &camera,
        &settings,
        &loss,
        &mut all,
        &mut statistics,
    )
    .unwrap();
    assert_eq!(bits(&some), bits(&all));
    assert!(some.splats.iter().filter(|s| **s != SplatGradient::default()).count() < 40);
    let shown = statistics.iter().filter(|s| s.pixels > 0).count();
    assert!(shown > 35 && statistics.iter().any(|s| s.gradient > 0.0), "{shown}");
    assert!(statistics.iter().all(|s| s.pixels == 0 || s.weight > 0.0));
}

/// Skips leave out nothing that has a gradient.
#[test]
fn skips_change_no_gradient() {
    let scene = Scene::random(500, 1, [0.01, 0.4], 21);
    let (camera, loss) = (camera(80, 60), Mse::new(noise(80, 60, 2)));
    let with = Settings::default();
    let without = Settings { cull_frustum: false, exact_tiles: false, ..Settings::default() };
    let of = |s| render_and_gradients(&mut Workspace::new(), &scene.splats(), &camera, s, &loss).unwrap();
    assert_eq!(of(&with).splats, of(&without).splats);
}

/// Several bands of tile rows: lists are made again for each.
#[test]
fn bands_add_up() {
    let gaussian = Gaussian { scale: [3.0; 3], opacity: 0.01, sh0: [0.3; 3], ..Gaussian::ABSENT };
    let scene = Scene { gaussians: vec![gaussian; 3], rest: vec![], degree: ShDegree::ZERO };
    // Over 2²² pixels, so more than one band; every pixel pulls alike.
    let camera = camera(16, 16).resized(16, 16384).unwrap().resized(320, 16384).unwrap();
    let loss = Linear(Image::filled(320, 16384, [1.0, 0.0, 0.0]).unwrap());
    let settings = Settings { alpha_cutoff: 0.0, ..Settings::default() };
    let got =
        render_and_gradients(&mut Workspace::new(), &scene.splats(), &camera, &settings, &loss).unwrap();
    // dL/d sh0 = C0 · Σ alpha·T, and the transmittance tells Σ alpha·T over the three.
    let covered: f64 = got.rendered.transmittance.iter().map(|&t| 1.0 - f64::from(t)).sum();
    let pulled: f64 = got.splats.iter().map(|s| f64::from(s.sh0[0])).sum();
    let expected = covered * crate::harmonics::C0;
    assert!((pulled / expected - 1.0).abs() < 1e-4, "{pulled} {expected}");
}

mod near_thresholds;

#[test]
fn degenerate_gaussians_have_finite_gradients() {
    let ball = Gaussian { scale: [0.3; 3], opacity: 0.5, sh0: [0.5; 3], ..Gaussian::ABSENT };
    let at = |position| Gaussian { position, ..ball };
    // Name, Gaussian, and whether nothing of it is drawn, so that all must be 0.
    let cases = [
        ("zero quaternion", Gaussian { rotation: [0.0; 4], ..ball }, true),
        ("absent", Gaussian { opacity: 0.0, ..ball }, true),
        ("opacity NaN", Gaussian { opacity: f32::NAN, ..ball }, true),
        ("opacity infinite", Gaussian { opacity: f32::INFINITY, ..ball }, true),
        ("position NaN", at([f32::NAN, 0.0, 0.0]), true),
        ("scale NaN", Gaussian { scale: [0.1, f32::NAN, 0.1], ..ball }, true),
        ("behind the camera", at([5.7, -6.3, 4.35]), true),
        ("far outside", at([1870.0, 1731.0, -14.5]), true),
        ("opacity 1", Gaussian { opacity: 1.0, ..ball }, false),
        ("opacity 7", Gaussian { opacity: 7.0, ..ball }, false),
        ("tiny opacity", Gaussian { opacity: 1e-30, ..ball }, false),
        ("scale 0", Gaussian { scale: [0.0; 3], ..ball }, false),
        ("one scale 0", Gaussian { scale: [0.3, 0.0, 0.3], ..ball }, false),
        ("tiny scale", Gaussian { scale: [1e-12; 3], ..ball }, false),
        ("huge scale", Gaussian { scale: [1e6; 3], ..ball }, false),
        (
            "anisotropy 1e8",
            Gaussian { scale: [1e4, 1e-4, 1e-4], rotation: [0.8, 0.1, 0.5, 0.2], ..ball },
            false,
        ),
        ("small quaternion", Gaussian { rotation: [1e-5, 2e-5, -1e-5, 0.0], ..ball }, false),
        ("long quaternion", Gaussian { rotation: [1e18, 2e18, -1e18, 0.0], ..ball }, false),
        ("camera inside", at([1.88, -2.08, 1.44]), false),
        ("huge colour", Gaussian { sh0: [1e30; 3], ..ball }, false),
    ];
    let (camera, loss) = (camera(33, 25), Distortion::new(noise(33, 25, 3)));
    for (name, gaussian, nothing) in cases {
        for (antialiased, low_pass) in [(false, 0.3), (true, 0.3), (false, 0.0), (true, 0.0)] {
            let settings = Settings { antialiased, low_pass, ..smooth() };
            let other = at([0.1, 0.2, 0.3]);
            let gaussians = [gaussian, other];
            let rest: Vec<f32> = (0..90).map(|i| 0.01 * i as f32).collect();
            let splats = Splats::new(&gaussians, &rest, ShDegree::new(3).unwrap()).unwrap();
            let g = render_and_gradients(&mut Workspace::new(), &splats, &camera, &settings, &loss).unwrap();
            let finite = |bits: &u64| *bits as u32 & 0x7F80_0000 != 0x7F80_0000;
            let count = 2 * 16 + 90;
            assert!(bits(&g)[..count].iter().all(finite), "{name}: {g:?}");
            let wide = g.background.iter().chain(&g.pose.translation).chain(&g.pose.rotation);
            assert!(wide.into_iter().all(|v| v.is_finite()), "{name}");
            let nothing_moves = g.splats[0] == SplatGradient::default() && g.sh_rest[..45] == [0.0; 45];
            assert!(!nothing || nothing_moves, "{name}: {:?}", g.splats[0]);
            assert!(name == "huge colour" || g.splats[1] != SplatGradient::default(), "{name}");
        }
    }
}

#[test]
fn nothing_to_draw_moves_the_background_alone() {
    let camera = camera(20, 10);
    let loss = Linear(Image::filled(20, 10, [1.0, 2.0, 3.0]).unwrap());
    let settings = Settings::default();
    let g =
        render_and_gradients(&mut Workspace::new(), &Splats::plain(&[]), &camera, &settings, &loss).unwrap();
    assert_eq!((g.background, g.pose), ([200.0, 400.0, 600.0], Pose::default()));
    let small = Mse::new(Image::filled(3, 3, [0.0; 3]).unwrap());
    let error = render_and_gradients(&mut Workspace::new(), &Splats::plain(&[]), &camera, &settings, &small);
    assert!(error.unwrap_err().to_string().contains("20 x 10"));
}

#[test]
fn a_target_that_is_not_a_number_is_counted() {
    let camera = camera(20, 10);
    let ball = Gaussian { scale: [0.5; 3], opacity: 0.9, ..Gaussian::ABSENT };
    let mut target = Image::filled(20, 10, [0.4; 3]).unwrap();
    let gradients = |target: &Image| {
        let loss = Mse::new(target.clone());
        let splats = [ball];
        render_and_gradients(&mut Workspace::new(), &Splats::plain(&splats), &camera, &smooth(), &loss)
            .unwrap()
    };
    let good = gradients(&target);
    assert_eq!(good.non_finite, 0);
    target.rgb_mut()[3 * 105] = f32::NAN;
    target.rgb_mut()[3 * 12 + 1] = f32::INFINITY;
    let bad = gradients(&target);
    assert!(bad.loss.is_nan() && bad.non_finite == 2, "{} {}", bad.loss, bad.non_finite);
    // What is left is finite, and the other values still say something.
    assert!(bad.splats[0].position.iter().chain(&bad.splats[0].sh0).all(|v| v.is_finite()));
    assert!(bad.splats[0] != SplatGradient::default() && bad.splats[0] != good.splats[0]);
    assert!(bad.background.iter().all(|v| v.is_finite()));
}
