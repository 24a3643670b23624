//! Lists inputs that are not rendered at all, who refuses them and the words that must be in the error.

use codec_core::{Gaussian, ShDegree};
use render_host::{
    Camera, Image, Intrinsics, Settings, Splats, Workspace,
    adjoint::loss::Mse,
    counterfactual::{Engine, States, Variants},
    metric, render, render_and_gradients,
};

use super::parts::{IDENTITY, camera};

/// An input that must be refused.
#[derive(Clone, Debug)]
pub struct Refusal {
    /// Who has to refuse it.
    pub api: &'static str,
    /// What is wrong with it.
    pub what: &'static str,
    /// The error; `None` when it was taken.
    pub error: Option<String>,
    /// Words the error must hold: culprit, value found, what is allowed.
    pub words: &'static [&'static str],
}

impl Refusal {
    /// True when it was refused, and in the right words.
    pub fn holds(&self) -> bool {
        self.error.as_ref().is_some_and(|error| self.words.iter().all(|word| error.contains(word)))
    }
}

fn refusal<T, E: std::fmt::Display>(
    api: &'static str,
    what: &'static str,
    words: &'static [&'static str],
    result: Result<T, E>,
) -> Refusal {
    Refusal { api, what, error: result.err().map(|e| e.to_string()), words }
}

/// Tries every input that must be refused.
pub fn refusals() -> Vec<Refusal> {
    let mut out = of_camera();
    out.extend(of_settings());
    out.extend(of_data());
    out.extend(of_counterfactual());
    out
}

fn of_camera() -> Vec<Refusal> {
    let plane = Intrinsics { width: 8, height: 8, fx: 9.0, fy: 9.0, cx: 4.0, cy: 4.0 };
    let with = |plane: Intrinsics| Camera::new(plane, IDENTITY, [0.0; 3]);
    let placed = |t: [f64; 3]| Camera::new(plane, IDENTITY, t);
    let mirrored = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let near = |near: f64| camera(8, 8).with_near(near);
    let up = [0.0, 1.0, 0.0];
    let look = |eye: [f64; 3], fov: f64| Camera::look_at(eye, [0.0; 3], up, fov, 8, 8);
    let (new, near_of, look_at) = ("Camera::new", "Camera::with_near", "Camera::look_at");
    vec![
        refusal(new, "width 0", &["width is 0", "1 to 16384"], with(Intrinsics { width: 0, ..plane })),
        refusal(
            new,
            "height 16385",
            &["height is 16385", "1 to 16384"],
            with(Intrinsics { height: 16_385, ..plane }),
        ),
        refusal(new, "focal length 0", &["fx is 0", "is allowed"], with(Intrinsics { fx: 0.0, ..plane })),
        refusal(
            new,
            "focal length NaN",
            &["fy is NaN", "is allowed"],
            with(Intrinsics { fy: f64::NAN, ..plane }),
        ),
        refusal(
            new,
            "principal point infinite",
            &["cx is inf", "is allowed"],
            with(Intrinsics { cx: f64::INFINITY, ..plane }),
        ),
        refusal(new, "translation NaN", &["translation is NaN", "is allowed"], placed([0.0, f64::NAN, 0.0])),
        refusal(new, "translation 1e16", &["translation is 1", "is allowed"], placed([1e16, 0.0, 0.0])),
        refusal(new, "mirror", &["rotation", "1e-3 is allowed"], Camera::new(plane, mirrored, [0.0; 3])),
        refusal(new, "rotation NaN", &["rotation", "NaN"], Camera::new(plane, [[f64::NAN; 3]; 3], [0.0; 3])),
        refusal(near_of, "near plane 0", &["near is 0", "is allowed"], near(0.0)),
        refusal(near_of, "near plane NaN", &["near is NaN", "is allowed"], near(f64::NAN)),
        refusal(look_at, "eye at target", &["target - eye", "no direction"], look([0.0; 3], 0.8)),
        refusal(
            look_at,
            "up along the view",
            &["up across the view", "no direction"],
            look([0.0, 3.0, 0.0], 0.8),
        ),
        refusal(look_at, "field of view 0", &["fov_y is 0", "is allowed"], look([0.0, 0.0, 3.0], 0.0)),
    ]
}

fn of_settings() -> Vec<Refusal> {
    let good = Settings::default();
    let cases: [(&'static str, &'static [&'static str], Settings); 10] = [
        ("background NaN", &["background is NaN", "is allowed"], Settings::over([0.0, f32::NAN, 0.0])),
        ("background 1e7", &["background is 10000000", "is allowed"], Settings::over([1e7, 0.0, 0.0])),
        ("low pass -1", &["low_pass is -1", "is allowed"], Settings { low_pass: -1.0, ..good.clone() }),
        (
            "cut-off NaN",
            &["alpha_cutoff is NaN", "0 to 0.5"],
            Settings { alpha_cutoff: f32::NAN, ..good.clone() },
        ),
        ("largest alpha 2", &["alpha_max is 2", "0.5 to 1"], Settings { alpha_max: 2.0, ..good.clone() }),
        (
            "stop 1",
            &["transmittance_stop is 1", "0 to 0.5"],
            Settings { transmittance_stop: 1.0, ..good.clone() },
        ),
        ("degree 4", &["max_sh_degree is 4", "0 to 3"], Settings { max_sh_degree: 4, ..good.clone() }),
        ("15 depth bits", &["depth_bits is 15", "16 to 32"], Settings { depth_bits: 15, ..good.clone() }),
        ("33 depth bits", &["depth_bits is 33", "16 to 32"], Settings { depth_bits: 33, ..good.clone() }),
        ("low pass infinite", &["low_pass is inf", "0 to 100"], Settings { low_pass: f64::INFINITY, ..good }),
    ];
    let by_render = cases.iter().map(|(what, words, settings)| {
        refusal("render", what, words, render(&Splats::plain(&[]), &camera(8, 8), settings))
    });
    let by_reference = cases.iter().map(|(what, words, settings)| {
        refusal(
            "reference::render",
            what,
            words,
            render_host::reference::render(&Splats::plain(&[]), &camera(8, 8), settings),
        )
    });
    by_render.chain(by_reference).collect()
}

fn of_data() -> Vec<Refusal> {
    let two = [Gaussian::ABSENT; 2];
    let degree = ShDegree::new(1).unwrap_or_default();
    let small = Image::filled(3, 3, [0.0; 3]).unwrap_or_default();
    let wide = Image::filled(9, 1, [0.0; 3]).unwrap_or_default();
    let loss = Mse::new(small.clone());
    let settings = Settings::default();
    let gradients =
        render_and_gradients(&mut Workspace::new(), &Splats::plain(&two), &camera(8, 8), &settings, &loss);
    vec![
        refusal(
            "Splats::new",
            "17 harmonics for 18",
            &["sh_rest", "found 17", "need 18"],
            Splats::new(&two, &[0.0; 17], degree),
        ),
        refusal("Image::new", "width 0", &["0 x 5", "1 to 16384"], Image::new(0, 5, Vec::new())),
        refusal("Image::new", "width 16385", &["16385 x 1", "1 to 16384"], Image::new(16_385, 1, Vec::new())),
        refusal(
            "Image::new",
            "values missing",
            &["2 x 2", "found 11", "need 12"],
            Image::new(2, 2, vec![0.0; 11]),
        ),
        refusal("metric::psnr", "two sizes", &["3 x 3", "9 x 1"], metric::psnr(&small, &wide)),
        refusal("render_and_gradients", "target of another size", &["loss", "8 x 8", "3 x 3"], gradients),
    ]
}

fn of_counterfactual() -> Vec<Refusal> {
    let two = [Gaussian::ABSENT; 2];
    let splats = Splats::plain(&two);
    let reference = Image::filled(8, 8, [0.0; 3]).unwrap_or_default();
    let small = Image::filled(3, 3, [0.0; 3]).unwrap_or_default();
    let (view, settings) = (camera(8, 8), Settings::default());
    let mut out = vec![
        refusal(
            "Variants::new",
            "an id missing",
            &["groups", "found 1", "2 Gaussians"],
            Variants::new(splats, &[0], 2),
        ),
        refusal(
            "Variants::new",
            "an id too large",
            &["group 2", "below 2"],
            Variants::new(splats, &[0, 2], 2),
        ),
    ];
    let Ok(variants) = Variants::new(splats, &[0, 1], 2) else { return out };
    let bad = Settings { alpha_max: 2.0, ..settings.clone() };
    let new = |image, settings| Engine::new(&variants, &view, image, settings);
    out.push(refusal(
        "Engine::new",
        "reference of another size",
        &["8 x 8", "3 x 3"],
        new(&small, &settings),
    ));
    out.push(refusal("Engine::new", "a setting", &["alpha_max is 2"], new(&reference, &bad)));
    let Ok(engine) = new(&reference, &settings) else { return out };
    let other = States::full(3);
    out.push(refusal("Engine::strict", "states of 3 groups", &["3 groups", "of 2"], engine.strict(&other)));
    out.push(refusal("Engine::fast", "states of 3 groups", &["3 groups", "of 2"], engine.fast(&other)));
    out
}
