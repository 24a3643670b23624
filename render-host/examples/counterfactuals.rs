//! Measures what each level of each cluster adds to a picture, in one call.

use render_host::{
    Camera, Gaussian, Settings, Splats,
    counterfactual::{Engine, Variants, Versions},
    render,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Four clusters of 25 Gaussians. Version 0 is absent, 1 coarse, 2 as it should be.
    let whole: Vec<Gaussian> = (0..100).map(ball).collect();
    let versions = Versions::new(&[3; 4])?;
    let (mut gaussians, mut groups) = (Vec::new(), Vec::new());
    for (i, fine) in whole.iter().enumerate() {
        let coarse = Gaussian { scale: [0.15; 3], sh0: [0.0; 3], ..*fine };
        for (version, gaussian) in [(1, coarse), (2, *fine)] {
            gaussians.push(gaussian);
            groups.push(versions.group(i % 4, version) as u32);
        }
    }
    let (settings, size) = (Settings::default(), (320, 240));
    let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, size.0, size.1)?;
    let reference = render(&Splats::plain(&whole), &camera, &settings)?.image;

    let variants = Variants::new(Splats::plain(&gaussians), &groups, versions.groups())?;
    let engine = Engine::new(&variants, &camera, &reference, &settings)?;
    // One context: clusters 0 and 1 have arrived in full, 2 as its base, 3 not at all.
    let found = engine.distortions(&versions, &[vec![2, 2, 1, 0]])?;
    for cluster in 0..4 {
        let distortion = |version| found.of(0, cluster, version);
        let (base, refinement) = (distortion(0) - distortion(1), distortion(1) - distortion(2));
        println!("cluster {cluster}: base {base:+.5}, refinement {refinement:+.5}");
    }
    Ok(())
}

fn ball(i: usize) -> Gaussian {
    let t = i as f32;
    Gaussian {
        position: [t.sin(), (1.7 * t).cos(), 0.3 * (0.9 * t).sin()],
        scale: [0.1; 3],
        opacity: 0.8,
        sh0: [(0.3 * t).sin(), (0.5 * t).cos(), 0.5],
        ..Gaussian::ABSENT
    }
}
