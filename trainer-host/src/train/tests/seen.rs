//! A start must be of what photographs show.

use render_host::Camera;

use super::{super::*, dataset, options};
use crate::import::synth;

/// The photographs of a small scene, each by the camera that `placed` makes of its own.
fn by(placed: impl Fn(&Camera) -> Camera + Sync + Send) -> Dataset {
    let dataset = dataset(synth::SynthKind::Balls, 2, 6);
    let train = dataset.train.clone().map(|view| PosedPhotograph { camera: placed(&view.camera), ..view });
    Dataset { train, ..dataset }
}

fn refused(dataset: &Dataset) -> String {
    Trainer::new(dataset, &options()).map(|_| ()).unwrap_err().to_string()
}

/// The same camera, turned about its vertical where `turns`, and `away` scene units along x.
fn moved(camera: &Camera, turns: bool, away: f64) -> Camera {
    let [x, y, z] = camera.rotation();
    let sign = if turns { -1.0 } else { 1.0 };
    let rotation = [x.map(|v| sign * v), y, z.map(|v| sign * v)];
    let [cx, cy, cz] = camera.centre();
    let centre = [cx + away, cy, cz];
    let translation = rotation.map(|row| -row.iter().zip(centre).map(|(r, c)| r * c).sum::<f64>());
    Camera::new(camera.intrinsics(), rotation, translation).unwrap()
}

#[test]
fn a_start_that_no_photograph_shows_is_refused() {
    assert!(Trainer::new(&by(|camera| moved(camera, false, 0.0)), &options()).is_ok());
    // All look outward, and the place that is nearest to where they look is behind them.
    let error = refused(&by(|camera| moved(camera, true, 0.0)));
    assert!(error.contains("start is 600 Gaussians, 0 of them in front of a camera"), "{error}");
    assert!(error.contains("that photographs show"), "{error}");
}

#[test]
fn a_scene_far_from_the_origin_is_refused() {
    assert!(Trainer::new(&by(|camera| moved(camera, false, 100.0)), &options()).is_ok());
    let error = refused(&by(|camera| moved(camera, false, 4e6)));
    assert!(
        error.contains("the middle of the scene is (39999") && error.contains("up to 10000 times"),
        "{error}"
    );
}
