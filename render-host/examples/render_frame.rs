//! Renders a helix of Gaussians: `cargo run -p render-host --example render_frame` writes frame.png.

use render_host::{Camera, Gaussian, Settings, Splats, render};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let place = |i: u8| -> Gaussian {
        let (y, (sin, cos)) = (f32::from(i) / 100.0 - 1.0, (0.1 * f32::from(i)).sin_cos());
        Gaussian {
            position: [sin, y, cos],
            scale: [0.06; 3],
            opacity: 0.8,
            sh0: [sin, cos, y],
            ..Gaussian::ABSENT
        }
    };
    let scene: Vec<Gaussian> = (0..200).map(place).collect();
    let camera = Camera::look_at([0.0, 1.0, -4.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 320, 240)?;
    let frame = render(&Splats::plain(&scene), &camera, &Settings::default())?;
    Ok(std::fs::write("frame.png", frame.image.to_png()?)?)
}
