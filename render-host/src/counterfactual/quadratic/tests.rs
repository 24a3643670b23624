use super::*;
use crate::{Renderer, reference};
use codec_core::ShDegree;

struct Case {
    gaussians: Vec<Gaussian>,
    rest: Vec<f32>,
    changes: Vec<Change>,
    more: Vec<f32>,
    groups: usize,
    camera: Camera,
    against: Image,
}

/// `n` Gaussians of degree 1 in nine cells of space; three levels of each are groups. `light` is the
/// least colour of the base.
fn case(n: usize, light: f32, size: (u32, u32)) -> Case {
    let mut state = 5u64;
    let mut between = |low: f32, high: f32| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((state >> 40) as f32 / (1u64 << 24) as f32)
    };
    let dc = |colour: f32| (colour - 0.5) / C0 as f32;
    let (mut gaussians, mut changes) = (Vec::new(), Vec::new());
    for i in 0..n {
        let position: [f32; 3] = [0; 3].map(|_| between(-1.0, 1.0));
        let cell = position.map(|p| ((p + 1.0) * 1.5) as u32).into_iter().fold(0, |a, c| 3 * a + c) % 9;
        gaussians.push(Gaussian {
            position,
            scale: [0; 3].map(|_| between(0.02, 0.2)),
            opacity: between(0.1, 1.0),
            sh0: [0; 3].map(|_| dc(between(light, light + 0.4))),
            ..Gaussian::ABSENT
        });
        for level in 0..3 {
            let sh0 = [0; 3].map(|_| between(-0.1, 0.15) / C0 as f32);
            changes.push(Change { gaussian: i as u32, group: 3 * cell + level, sh0 });
        }
    }
    let rest = (0..9 * n).map(|_| between(-0.02, 0.02)).collect();
    let more = (0..9 * changes.len()).map(|_| between(-0.02, 0.02)).collect();
    let camera = Camera::look_at([1.9, -2.1, 1.45], [0.0; 3], [0.0, 0.0, 1.0], 0.9, size.0, size.1).unwrap();
    let rgb = (0..3 * size.0 * size.1).map(|_| between(0.3, 0.9)).collect();
    Case {
        gaussians,
        rest,
        changes,
        more,
        groups: 27,
        camera,
        against: Image::new(size.0, size.1, rgb).unwrap(),
    }
}

impl Case {
    fn repaints(&self) -> Repaints<'_> {
        let splats = Splats::new(&self.gaussians, &self.rest, ShDegree::new(1).unwrap()).unwrap();
        Repaints::new(splats, &self.changes, &self.more, self.groups).unwrap()
    }

    fn form(&self, settings: &Settings) -> Quadratic {
        Quadratic::new(&self.repaints(), &self.camera, &self.against, settings).unwrap()
    }

    /// Squared error of a world rendered alone, by the fast renderer and by the reference.
    fn alone(&self, states: &States, world: usize, settings: &Settings) -> [f64; 2] {
        let (gaussians, rest) = self.repaints().world(states, world);
        let splats = Splats::new(&gaussians, &rest, ShDegree::new(1).unwrap()).unwrap();
        let fast = Renderer::new().render(&splats, &self.camera, settings).unwrap().image;
        let slow = reference::render(&splats, &self.camera, settings).unwrap().rgb;
        let square = |a: f64, b: f32| (a - f64::from(b)).powi(2);
        let against = self.against.rgb();
        [
            fast.rgb().iter().zip(against).map(|(&a, &b)| square(f64::from(a), b)).sum(),
            slow.iter().zip(against).map(|(&a, &b)| square(a, b)).sum(),
        ]
    }
}

fn random(groups: usize, worlds: usize) -> States {
    let mut states = States::new(groups);
    for world in 0..worlds {
        states.push(|group| (world * 31 + group * 17 + world * group) % 7 < world % 5 + 1);
    }
    states.push(|_| false);
    states.push(|_| true);
    states
}

fn settings() -> Settings {
    Settings { background: [0.2, 0.4, 0.1], ..Settings::default() }
}

#[test]
fn every_state_is_its_render() {
    let case = case(400, 0.6, (75, 41));
    let form = case.form(&settings());
    assert_eq!(form.clamp(), 0.0);
    assert!(form.groups() == 27 && form.pairs() > 27);
    let states = random(27, 12);
    let got = form.sse(&states).unwrap();
    for (world, got) in got.iter().enumerate() {
        let [fast, slow] = case.alone(&states, world, &settings());
        assert!((got / fast - 1.0).abs() < 1e-6, "{world}: {got} {fast}");
        // The reference may take a threshold otherwise in a pixel or two.
        assert!((got / slow - 1.0).abs() < 1e-4, "{world}: {got} {slow}");
    }
    let spread = got.iter().fold(0.0f64, |a, v| a.max((v / got[0] - 1.0).abs()));
    assert!(spread > 0.01, "states must differ for this to say anything: {spread}");
    let exact = Settings { transmittance_stop: 1e-4, ..Settings::exact() };
    let form = case.form(&exact);
    for (world, got) in form.sse(&states).unwrap().iter().enumerate() {
        let slow = case.alone(&states, world, &exact)[1];
        assert!((got / slow - 1.0).abs() < 2e-6, "{world}: {got} {slow}");
    }
}

#[test]
fn utilities_are_differences_of_errors() {
    let case = case(200, 0.6, (48, 32));
    let form = case.form(&settings());
    let states = random(27, 3);
    let utilities = form.utilities(&states).unwrap();
    assert_eq!(utilities.sse, form.sse(&states).unwrap());
    let mut largest = 0.0f64;
    for context in 0..states.len() {
        for group in 0..27 {
            let mut pair = States::new(27);
            pair.push(|g| g != group && states.has(context, g));
            pair.push(|g| g == group || states.has(context, g));
            let sse = form.sse(&pair).unwrap();
            let delta = utilities.of(context, group);
            largest = largest.max(delta.abs());
            assert!((delta - (sse[0] - sse[1])).abs() < 1e-9 * utilities.sse[0], "{context} {group}");
        }
    }
    assert!(largest > 1e-3 * utilities.sse[0], "{largest}");
}

/// Dark colours are clamped in some states: the form is off, and by no more than it says.
#[test]
fn the_clamp_is_bounded() {
    for light in [0.1, 0.0, -0.3] {
        let case = case(300, light, (48, 32));
        let form = case.form(&settings());
        assert!(form.clamp() > 0.0);
        let (states, mut worst) = (random(27, 8), 0.0f64);
        for (world, got) in form.sse(&states).unwrap().iter().enumerate() {
            let [fast, _] = case.alone(&states, world, &settings());
            let off = (fast.sqrt() - got.sqrt()).abs();
            assert!(off <= form.clamp() + 1e-5, "{light}, {world}: {off} above {}", form.clamp());
            worst = worst.max(off);
        }
        assert!(light > 0.05 || worst > 1e-4, "{light}: the clamp shows nowhere, {worst}");
    }
}

#[test]
fn threads_do_not_show() {
    let case = case(500, 0.2, (90, 60));
    let serial = case.form(&Settings { parallel: false, ..settings() });
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| case.form(&settings())), serial);
    }
}

#[test]
fn bad_input_is_named() {
    let gaussians = [Gaussian::ABSENT; 2];
    let splats = Splats::plain(&gaussians);
    let good = Change { gaussian: 1, group: 0, sh0: [0.1; 3] };
    let refused = |change: Change, rest: &[f32]| {
        Repaints::new(splats, &[good, change], rest, 1).map(|_| ()).unwrap_err().to_string()
    };
    assert!(refused(Change { gaussian: 2, ..good }, &[]).contains("change 1: Gaussian 2"));
    assert!(refused(Change { group: 1, ..good }, &[]).contains("group 1"));
    assert!(refused(Change { sh0: [0.0, f32::NAN, 0.0], ..good }, &[]).contains("change 1"));
    assert!(refused(good, &[0.0]).contains("found 1"));
    let case = case(5, 0.5, (16, 16));
    let form = case.form(&settings());
    assert!(form.sse(&States::full(3)).is_err() && form.utilities(&States::full(3)).is_err());
    let small = Image::filled(3, 3, [0.0; 3]).unwrap();
    assert!(Quadratic::new(&case.repaints(), &case.camera, &small, &settings()).is_err());
}
