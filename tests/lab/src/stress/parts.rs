//! Puts cases together: one camera, one plain Gaussian, its neighbours.

use codec_core::Gaussian;
use render_host::{Camera, CameraError, Intrinsics};

/// Error allowed where no decision is close: the renderer's promise.
pub(super) const BOUND: f64 = 1e-4;
/// No rotation.
pub(super) const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Four units before the origin, looking at it; the widest image shows the same height as a small one.
pub(super) fn camera(width: u32, height: u32) -> Camera {
    let f = 1.2 * f64::from(height);
    let (cx, cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
    fallback(Camera::new(Intrinsics { width, height, fx: f, fy: f, cx, cy }, IDENTITY, [0.0, 0.0, 4.0]))
}

/// Cases hold only cameras that exist; a test says so.
pub(super) fn fallback(camera: Result<Camera, CameraError>) -> Camera {
    match camera {
        Ok(camera) => camera,
        Err(_) => camera_of_one_pixel(),
    }
}

fn camera_of_one_pixel() -> Camera {
    camera(1, 1)
}

/// A Gaussian without anything special.
pub(super) fn ball() -> Gaussian {
    Gaussian {
        scale: [0.3, 0.2, 0.25],
        rotation: [0.8, 0.2, -0.4, 0.4],
        opacity: 0.7,
        sh0: [0.9, -0.3, 0.2],
        ..Gaussian::ABSENT
    }
}

/// `g` between two others, one nearer and one farther.
pub(super) fn neighbours(g: Gaussian) -> Vec<Gaussian> {
    let farther = Gaussian { position: [-0.4, 0.1, 0.5], sh0: [-0.8, 1.1, 0.4], ..ball() };
    let nearer = Gaussian { position: [0.3, -0.2, -0.6], opacity: 0.4, ..ball() };
    vec![farther, g, nearer]
}
