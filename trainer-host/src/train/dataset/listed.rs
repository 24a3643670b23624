//! Photographs that are listed and not read yet: what their headers say decides how all of them are reduced.
//!
//! Each is reduced as soon as it is decoded, so that at most as many as there are threads are in memory in
//! full size.

use std::{
    fs::File,
    io::BufReader,
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use render_host::{Camera, ImageError, image_file::claimed_size};

use super::{
    error::DatasetError,
    files::{read_mask, read_photograph},
};
use crate::train::{
    pixel_mask::PixelMask,
    reduction::{Reduction, ReductionReport},
    views::{PosedPhotograph, Test, Training, Validation, Views},
};

/// A photograph in its file.
#[derive(Clone)]
pub(super) struct ListedPhotograph {
    /// Name in its source.
    pub(super) name: String,
    /// Of the size of the photograph in its file.
    pub(super) camera: Camera,
    pub(super) time: f32,
    pub(super) image: PathBuf,
    /// Width and height, pixels, as the header of `image` claims.
    pub(super) size: (u32, u32),
    /// The file of [`PosedPhotograph::foreground`].
    pub(super) foreground: Option<PathBuf>,
    /// The file of [`PosedPhotograph::counted`].
    pub(super) counted: Option<PathBuf>,
}

/// The photographs of a dataset.
pub(super) struct Listed {
    /// Where they are listed.
    pub(super) folder: PathBuf,
    pub(super) train: Vec<ListedPhotograph>,
    pub(super) validation: Vec<ListedPhotograph>,
    pub(super) test: Vec<ListedPhotograph>,
}

/// The same, read.
pub(super) struct Photographs {
    pub(super) train: Views<Training>,
    pub(super) validation: Views<Validation>,
    pub(super) test: Views<Test>,
    pub(super) test_scale: u32,
    /// Whether some photographs to train on are transparent somewhere.
    pub(super) has_alpha: bool,
    /// How they were reduced.
    pub(super) report: ReductionReport,
}

impl Listed {
    /// Reads all; with a `max_side` (pixels) sides that are longer are reduced, those of test photographs to
    /// twice as much where that divides them.
    pub(super) fn read(&self, max_side: Option<u32>) -> Result<Photographs, DatasetError> {
        let splits = [&self.train, &self.validation, &self.test];
        let sizes: Vec<(u32, u32)> = splits.into_iter().flatten().map(|listed| listed.size).collect();
        let whole = (Reduction::NONE, ReductionReport::default());
        let (reduction, report) = max_side.map_or(whole, |max_side| Reduction::of(&sizes, max_side));
        let (of_test, test_scale) = reduction.doubled();
        let (train, has_alpha) = self.views(&self.train, reduction)?;
        self.check_counted(&train)?;
        let (validation, _) = self.views(&self.validation, reduction)?;
        let (test, _) = self.views(&self.test, of_test)?;
        Ok(Photographs { train, validation, test, test_scale, has_alpha, report })
    }

    /// Refuses photographs to train on whose masks together leave no pixel that counts.
    fn check_counted(&self, train: &Views<Training>) -> Result<(), DatasetError> {
        let counts =
            |view: &PosedPhotograph| view.counted.as_ref().is_none_or(|mask| mask.values().contains(&255));
        let photographs = train.photographs();
        let Some(first) = photographs.first().filter(|_| !photographs.iter().any(counts)) else {
            return Ok(());
        };
        let mask = self.train.iter().find_map(|listed| listed.counted.clone());
        let (width, height) = (first.photograph.width(), first.photograph.height());
        Err(DatasetError::Field {
            path: mask.unwrap_or_else(|| self.folder.clone()),
            field: format!("mask, as those of all {} photographs to train on,", photographs.len()),
            found: format!("without a pixel that counts at {width} x {height}"),
            allowed: "at least 1 is needed: white in all that it covers",
        })
    }

    /// One split, and whether something is transparent.
    fn views<S>(
        &self,
        listed: &[ListedPhotograph],
        reduction: Reduction,
    ) -> Result<(Views<S>, bool), DatasetError> {
        let read = in_order(listed, |listed| {
            let (view, has_alpha) = listed.read()?;
            Ok((reduction.of_view(view), has_alpha))
        })?;
        let has_alpha = read.iter().any(|(_, has_alpha)| *has_alpha);
        let views = Views::new(read.into_iter().map(|(view, _)| view).collect());
        let views = views.map_err(|source| DatasetError::Views { path: self.folder.clone(), source })?;
        Ok((views, has_alpha))
    }
}

impl ListedPhotograph {
    /// In full size; and whether some of it is transparent.
    fn read(&self) -> Result<(PosedPhotograph, bool), DatasetError> {
        let (photograph, has_alpha) = read_photograph(&self.image)?;
        let size = (photograph.width(), photograph.height());
        let mask = |path: &Option<PathBuf>| path.as_deref().map(|path| mask_of(path, size)).transpose();
        let (foreground, counted) = (mask(&self.foreground)?, mask(&self.counted)?);
        let (name, camera) = (self.name.clone(), self.camera.clone());
        Ok((PosedPhotograph { name, camera, time: self.time, photograph, foreground, counted }, has_alpha))
    }
}

/// The mask at `path`, of a photograph of `size`.
fn mask_of(path: &Path, size: (u32, u32)) -> Result<PixelMask, DatasetError> {
    let mask = read_mask(path)?;
    let (width, height) = mask.size();
    if (width, height) == size {
        return Ok(mask);
    }
    Err(DatasetError::Field {
        path: path.to_owned(),
        field: "size".to_owned(),
        found: format!("{width} x {height}"),
        allowed: "that of its image is needed",
    })
}

/// Widths and heights that the headers of image files claim.
pub(super) fn claimed_sizes(paths: &[PathBuf]) -> Result<Vec<(u32, u32)>, DatasetError> {
    in_order(paths, |path| {
        let file = File::open(path).map_err(|source| DatasetError::File { path: path.clone(), source })?;
        claimed_size(BufReader::new(file)).map_err(|error| {
            let source = ImageError::Codec(error.to_string());
            DatasetError::Image { path: path.clone(), source }
        })
    })
}

/// What `of` makes of each on all threads, or the error of the first of them: which of several comes first by
/// the clock differs.
fn in_order<T: Sync, U: Send>(
    all: &[T],
    of: impl Fn(&T) -> Result<U, DatasetError> + Sync + Send,
) -> Result<Vec<U>, DatasetError> {
    all.par_iter().map(of).collect::<Vec<_>>().into_iter().collect()
}
