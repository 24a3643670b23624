//! Measures states per second of the counterfactual engine against rendering every state alone, with the
//! errors beside the speeds.

mod table;

use anyhow::Result;
use render_host::{
    Renderer, Settings,
    counterfactual::{Engine, States, Variants, WorldGradients, brute},
    reference,
};

use super::{
    clock::seconds_of,
    cloud::{CloudShape, LATTICE},
    partial::{Partial, STATES_ALONE, deliveries, spread},
};
use crate::{
    figures::{Bench, Figure, median},
    setup::Setup,
};

/// Worlds that brute force differentiates per round; its time is scaled to all.
const ALONE_GRADIENTS: usize = 4;

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (n, worlds, runs, sides) =
        if setup.quick { (6000, 32, 3, vec![160]) } else { (84_000, 128, 7, vec![400, 800]) };
    let groups = LATTICE.groups();
    let mut bench = Bench::new(
        "counterfactual",
        format!(
            "{n} Gaussians in {groups} groups (64 clusters of 2 additive levels), W = {worlds} states of \
             which each lacks a tenth of the clusters, one camera; A: uniform volume in cells, B: \
             overlapping shells; medians of {runs} interleaved runs, set-up (project, sort, bin) included; \
             brute force renders {STATES_ALONE} states with the tile renderer (early stop on), its time \
             scaled to W; table: all utilities of 32 clusters of 4 levels in 32 contexts at 4 frames"
        ),
    );
    for &side in &sides {
        for kind in CloudShape::ALL {
            measure(&mut bench, kind, n, side, worlds, runs)?;
        }
        table::run(&mut bench, n, side, runs)?;
    }
    Ok(bench)
}

fn measure(
    bench: &mut Bench,
    (kind, letter): (CloudShape, char),
    n: usize,
    side: u32,
    worlds: usize,
    runs: usize,
) -> Result<()> {
    let settings = Settings::default();
    let no_stop = Settings { early_stop: false, ..settings.clone() };
    let scene = Partial::new(kind, n, side, &settings)?;
    let (variants, camera, against) = (scene.variants()?, &scene.camera, &scene.against);
    let (states, groups) = (deliveries(worlds), LATTICE.groups());
    let full = States::full(groups);
    let (few, fewer) = (spread(&states, STATES_ALONE), spread(&states, ALONE_GRADIENTS));
    let contexts = states.range(0..32);
    let weights = vec![1.0 / worlds as f64; worlds];

    let engine = || Engine::new(&variants, camera, against, &settings);
    let mut renderer = Renderer::new();
    let mut times: [Vec<f64>; 9] = Default::default();
    for _ in 0..runs {
        let [single, alone, set_up, fast, strict, leave, all, gradients, alone_gradients] = &mut times;
        seconds_of(single, || renderer.render(&scene.splats(), camera, &settings))?;
        seconds_of(fast, || engine()?.fast(&states))?;
        seconds_of(leave, || engine()?.utilities(&full))?;
        seconds_of(gradients, || engine()?.gradients(&variants, &states, &weights))?;
        seconds_of(alone, || brute::sse(&variants, &few, camera, against, &settings))?;
        seconds_of(set_up, engine)?;
        seconds_of(strict, || engine()?.strict(&states))?;
        seconds_of(all, || engine()?.utilities(&contexts))?;
        let unit = vec![1.0; fewer.len()];
        seconds_of(alone_gradients, || {
            brute::gradients(&variants, &fewer, &unit, camera, against, &settings)
        })?;
    }
    let [single, alone, set_up, fast, strict, leave, all, gradients, alone_gradients] =
        times.map(|t| median(&t));
    let alone = few.len() as f64 / alone;
    let alone_gradients = fewer.len() as f64 / alone_gradients;

    let engine = engine()?;
    let errors = Errors::new(&scene, &variants, &engine, &states, &no_stop)?;
    let strict_differs = {
        let (got, expected) =
            (engine.strict(&few)?, brute::sse(&variants, &few, camera, against, &settings)?);
        got.iter().zip(&expected).filter(|(a, b)| a.to_bits() != b.to_bits()).count()
    };

    let key = |name: &str| format!("{letter}{side}.{name}");
    let w = worlds as f64;
    let f64_error = "relative SSE against f64 without early stop";
    let mut push = |figure: Figure| bench.push(figure.runs(runs));
    push(
        Figure::new(key("single_render"), 1e3 * single, "ms")
            .error(errors.picture, "max abs against f64, away from thresholds"),
    );
    push(
        Figure::new(key("set_up"), 1e3 * set_up, "ms")
            .error(strict_differs as f64, "states differ from brute force in a bit"),
    );
    push(Figure::new(key("brute"), alone, "states/s").error(errors.brute, f64_error));
    push(Figure::new(key("fast"), w / fast, "states/s").error(errors.fast, f64_error).peer(
        "brute force",
        alone,
        false,
    ));
    push(
        Figure::new(key("strict"), w / strict, "states/s")
            .error(
                strict_differs as f64,
                &format!("of {} states differ from brute force in a bit", few.len()),
            )
            .peer("brute force", alone, false),
    );
    let of_largest = "of the largest, against brute force without early stop";
    push(
        Figure::new(key("leave_one_out"), leave / single, "single renders for all groups")
            .error(errors.leave_one_out, of_largest),
    );
    push(
        Figure::new(key("utilities"), (contexts.len() * groups) as f64 / all, "utilities/s")
            .error(errors.utilities, of_largest)
            .peer("brute force", alone, false),
    );
    push(
        Figure::new(key("forward_backward"), w / gradients, "world-frames/s")
            .error(
                errors.gradients,
                "relative length of the worst class, against brute force without early stop",
            )
            .peer("brute force", alone_gradients, false),
    );
    Ok(())
}

/// Errors of the modes, each against its twin.
struct Errors {
    picture: f64,
    brute: f64,
    fast: f64,
    leave_one_out: f64,
    utilities: f64,
    gradients: f64,
}

impl Errors {
    fn new(
        scene: &Partial,
        variants: &Variants<'_>,
        engine: &Engine,
        states: &States,
        no_stop: &Settings,
    ) -> Result<Self> {
        let (camera, against, groups) = (&scene.camera, &scene.against, LATTICE.groups());
        let sse = |states: &States| brute::sse(variants, states, camera, against, no_stop);
        let stop = Settings::default();
        let picture = render_host::render(&scene.splats(), camera, &stop)?.image;
        let exact = reference::render(&scene.splats(), camera, &stop)?.difference(picture.rgb());
        let (mut of_brute, mut of_fast) = (0.0f64, 0.0f64);
        let two = spread(states, 2);
        let stopped = brute::sse(variants, &two, camera, against, &stop)?;
        for (world, fast) in engine.fast(&two)?.iter().enumerate() {
            let (gaussians, _) = brute::world(variants, &two, world);
            let exact = reference::render(&render_host::Splats::plain(&gaussians), camera, no_stop)?;
            let square = |(a, &b): (&f64, &f32)| (a - f64::from(b)).powi(2);
            let exact: f64 = exact.rgb.iter().zip(against.rgb()).map(square).sum();
            of_fast = of_fast.max((fast / exact - 1.0).abs());
            of_brute = of_brute.max((stopped[world] / exact - 1.0).abs());
        }
        // Every sixteenth group toggled in the full world and in a partial one.
        let toggled = |base: &States| -> Result<f64> {
            let mut tries = base.one(0);
            (0..8).for_each(|k| tries.push(|g| base.has(0, g) != (g == 16 * k)));
            let (alone, found) = (sse(&tries)?, engine.utilities(&base.one(0))?);
            let largest = found.delta.iter().fold(0.0f64, |m, d| m.max(d.abs()));
            let error = |k: usize| {
                let rise = alone[k + 1] - alone[0];
                let rise = if base.has(0, 16 * k) { rise } else { -rise };
                (rise - found.of(0, 16 * k)).abs() / largest
            };
            Ok((0..8).map(error).fold(0.0, f64::max))
        };
        let full = States::full(groups);
        let weights = vec![1.0; two.len()];
        let gradients = distance(
            &engine.gradients(variants, &two, &weights)?,
            &brute::gradients(variants, &two, &weights, camera, against, no_stop)?,
        );
        Ok(Self {
            picture: exact.map_or(f64::NAN, |d| d.max_clear),
            brute: of_brute,
            fast: of_fast,
            leave_one_out: toggled(&full)?,
            utilities: toggled(states)?,
            gradients,
        })
    }
}

/// Length of the difference over the length of the expected, for the class of parameters where it is most.
pub(super) fn distance(got: &WorldGradients, expected: &WorldGradients) -> f64 {
    type Class = fn(&render_host::adjoint::SplatGradient) -> Vec<f32>;
    let classes: [Class; 5] = [
        |g| g.position.to_vec(),
        |g| g.log_scale.to_vec(),
        |g| g.rotation.to_vec(),
        |g| vec![g.opacity_logit],
        |g| g.sh0.to_vec(),
    ];
    let of = |class: Class| {
        let (mut difference, mut length) = (0.0, 0.0);
        for (a, b) in got.splats.iter().zip(&expected.splats) {
            for (a, b) in class(a).into_iter().zip(class(b)) {
                difference += (f64::from(a) - f64::from(b)).powi(2);
                length += f64::from(b).powi(2);
            }
        }
        (difference / length).sqrt()
    };
    classes.map(of).into_iter().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use render_host::adjoint::SplatGradient;

    use super::*;

    #[test]
    fn a_wrong_gradient_shows() {
        let of = |position, opacity_logit| WorldGradients {
            splats: vec![SplatGradient {
                position: [position, 0.0, 0.0],
                log_scale: [1.0; 3],
                rotation: [1.0; 4],
                opacity_logit,
                sh0: [1.0; 3],
                ..SplatGradient::default()
            }],
            ..WorldGradients::default()
        };
        let right = of(2.0, 4.0);
        assert_eq!(distance(&right, &right), 0.0);
        assert_eq!(distance(&of(3.0, 4.0), &right), 0.5);
        assert_eq!(distance(&of(3.0, 1.0), &right), 0.75, "the worst class counts");
    }
}
