//! Times gradients with each setting that trades accuracy for time, beside how far that moves them.

use anyhow::Result;
use render_host::{
    Camera, Gradients, Settings, Splats, Workspace,
    adjoint::{
        loss::{Mse, photograph::Photograph},
        render_and_gradients_into,
    },
};

use super::measure::{WHITE, apart, ms};
use crate::figures::{Bench, Figure, median};

/// As the protocol of the bench says it.
pub(super) const PROTOCOL: &str = "switch.*: ms of picture, loss and gradients on one thread at the \
    smaller side, medians of 3 interleaved runs, beside the defaults; error against exact, in which nothing \
    is cut or stopped; of squared errors, as in all errors between gradients here: L1 has the other sign \
    where equal pixels differ by a rounding";
/// How often each is timed.
const RUNS: usize = 3;

/// A row per setting.
///
/// # Errors
/// What the renderer refuses.
pub(super) fn tolerances(
    bench: &mut Bench,
    splats: &Splats,
    photograph: &Photograph,
    camera: &Camera,
) -> Result<()> {
    let over = |settings: Settings| Settings { parallel: false, background: WHITE, ..settings };
    let rows = [
        ("exact", Settings::exact()),
        ("defaults", Settings::default()),
        ("no_early_stop", Settings { early_stop: false, ..Settings::default() }),
        ("no_cutoff", Settings { alpha_cutoff: 0.0, ..Settings::default() }),
        ("early_stop_at_0.01", Settings { transmittance_stop: 1e-2, ..Settings::default() }),
        ("half_attributes", Settings { half_attributes: true, ..Settings::default() }),
    ];
    let rows = rows.map(|(name, settings)| (name, over(settings)));
    let (mut workspace, loss) = (Workspace::new(), Mse::new(photograph.over(WHITE)));
    let mut found = rows.each_ref().map(|_| (Gradients::default(), Vec::new()));
    for _ in 0..RUNS {
        for ((_, settings), (out, times)) in rows.iter().zip(&mut found) {
            ms(times, || {
                Ok(render_and_gradients_into(&mut workspace, splats, camera, settings, &loss, out)?)
            })?;
        }
    }
    let (exact, defaults_ms) = (&found[0].0, median(&found[1].1));
    for ((name, _), (out, times)) in rows.iter().zip(&found) {
        let figure = Figure::new(format!("switch.{name}"), median(times), "ms").runs(RUNS);
        let error = "relative L2 distance of position gradients from those of exact";
        bench.push(figure.error(apart(out, exact), error).peer("defaults", defaults_ms, true));
    }
    Ok(())
}
