//! The tile renderer makes a picture: project → sort → bin → blend.

use std::ops::Range;

use rayon::prelude::*;

use crate::{
    Camera, Counters, Splats,
    image::{Image, ImageError},
    settings::{Settings, SettingsError},
    stage::{bin, blend, project, sort},
};

/// A render that could not start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The image could not be made.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// A picture and what it took to make it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rendered {
    /// Colour over the settings' background.
    pub image: Image,
    /// Share of the background that shows, a value in 0..=1 per pixel, row by row.
    pub transmittance: Vec<f32>,
    /// What was drawn and what was left out.
    pub counters: Counters,
}

/// A renderer that keeps its buffers: frames of the same size and count allocate nothing large.
///
/// Same splats, camera and settings give the same bits, whatever was rendered before, with any number of
/// threads, with `parallel` on or off, on any machine.
///
/// ```
/// use render_host::{Camera, Gaussian, Renderer, Settings, Splats};
///
/// let ball = [Gaussian { scale: [0.3; 3], opacity: 0.9, ..Gaussian::ABSENT }];
/// let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 64, 48)?;
/// let rendered = Renderer::new().render(&Splats::plain(&ball), &camera, &Settings::default())?;
/// assert_eq!(rendered.counters.drawn, 1);
/// assert!(rendered.transmittance[24 * 64 + 32] < 0.2, "the ball hides the background");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Default)]
pub struct Renderer {
    pub(crate) projected: project::Projected,
    pub(crate) order: sort::Order,
    pub(crate) bands: Vec<Range<usize>>,
    pub(crate) bins: bin::Bins,
    pub(crate) tiles: blend::Tiles,
}

impl Renderer {
    /// A renderer with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Renders `splats` as `camera` sees them.
    ///
    /// # Errors
    /// A setting out of range.
    pub fn render(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Rendered, RenderError> {
        let mut out = Rendered::default();
        self.render_into(splats, camera, settings, &mut out)?;
        Ok(out)
    }

    /// As [`Renderer::render`], into a picture whose memory is used again.
    ///
    /// # Errors
    /// A setting out of range; `out` is then unchanged.
    pub fn render_into(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
        out: &mut Rendered,
    ) -> Result<(), RenderError> {
        settings.validate()?;
        let size = [camera.width() as usize, camera.height() as usize];
        out.image.reset(camera.width(), camera.height())?;
        out.transmittance.resize(size[0] * size[1], 1.0);

        let Self { projected, order, bands, .. } = self;
        let mut counters = project::project(splats, camera, settings, projected);
        sort::sort(&projected.keys, settings.parallel, order);
        bin::bands(projected, order, size, settings, bands);
        self.compose(size, settings, out, &mut counters);
        out.counters = counters;
        Ok(())
    }

    /// Bins and blends what is projected, sorted and split into bands, into a picture of `size` (width and
    /// height in pixels), and counts it.
    pub(crate) fn compose(
        &mut self,
        size: [usize; 2],
        settings: &Settings,
        out: &mut Rendered,
        counters: &mut Counters,
    ) {
        let Self { projected, order, bands, bins, tiles } = self;
        let side = settings.tile.pixels();
        let [columns, rows] = size.map(|pixels| settings.tile.tiles(pixels));
        for band in bands.iter() {
            bin::bin(projected, order, band, columns, settings, bins);
            blend::blend(&projected.splats, bins, band, size, settings, tiles);
            let pixels = band.start * side * size[0]..(band.end * side).min(size[1]) * size[0];
            let rgb = &mut out.image.rgb_mut()[3 * pixels.start..3 * pixels.end];
            blend::resolve(tiles, size[0], settings, rgb, &mut out.transmittance[pixels]);

            let (entries, touched) = bins.totals();
            counters.intersections += entries;
            counters.tiles_touched += touched;
            counters.boxed += bins.boxed();
            tiles.count(counters);
        }
        counters.tiles = (columns * rows) as u64;
        counters.pixels = (size[0] * size[1]) as u64;
    }
}

/// Renders once. To render many frames, keep a [`Renderer`].
///
/// # Errors
/// A setting out of range.
pub fn render(splats: &Splats, camera: &Camera, settings: &Settings) -> Result<Rendered, RenderError> {
    Renderer::new().render(splats, camera, settings)
}

/// Renders W worlds: states of one scene under one camera and one set of settings. Picture `w` equals
/// `render(worlds[w], …)` bit for bit.
///
/// # Errors
/// A setting out of range.
pub fn render_many(
    worlds: &[Splats],
    camera: &Camera,
    settings: &Settings,
) -> Result<Vec<Rendered>, RenderError> {
    settings.validate()?;
    if !settings.parallel || worlds.len() < rayon::current_num_threads() {
        let mut renderer = Renderer::new();
        return worlds.iter().map(|splats| renderer.render(splats, camera, settings)).collect();
    }
    // Enough worlds to keep every thread busy: one world per thread, each serial inside.
    let serial = Settings { parallel: false, ..settings.clone() };
    let world = |renderer: &mut Renderer, splats: &Splats| renderer.render(splats, camera, &serial);
    worlds.par_iter().map_init(Renderer::new, world).collect()
}
