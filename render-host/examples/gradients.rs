//! Moves a Gaussian towards a picture by the gradients of its render.

use render_host::{
    Camera, Gaussian, Settings, Splats, Workspace, adjoint::loss::Mse, render, render_and_gradients,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let at = |x: f32| Gaussian { position: [x, 0.0, 0.0], scale: [0.3; 3], opacity: 0.8, ..Gaussian::ABSENT };
    let (camera, settings) =
        (Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 160, 120)?, Settings::default());
    let target = render(&Splats::plain(&[at(0.0)]), &camera, &settings)?.image;
    let loss = Mse::new(target);

    let (mut workspace, mut moving) = (Workspace::new(), at(0.25));
    for step in 0..40 {
        let splats = [moving];
        let found = render_and_gradients(&mut workspace, &Splats::plain(&splats), &camera, &settings, &loss)?;
        if step % 10 == 0 {
            println!("step {step}: loss {:.6}, x = {:+.4}", found.loss, moving.position[0]);
        }
        // Gradients of scale and opacity are of the logarithm and of the logit; a position's is its own.
        for (value, slope) in moving.position.iter_mut().zip(found.splats[0].position) {
            *value -= 5.0 * slope;
        }
    }
    Ok(())
}
