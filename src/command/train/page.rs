//! Makes the page of a training: curves of loss and PSNR, figures, pictures beside photographs.

use std::fmt::Write as _;

use anyhow::Result;
use render_host::Image;
use trainer_host::train::{self, Dataset, DynamicScene};

use super::{
    figures::{Figure, decibels, share},
    log::Log,
    trained::Trained,
};
use crate::report::{
    html::{STYLE, data_of_png},
    plot::{Hue, Panel, Plot, Series, Shape, escape},
};

/// Columns of the preview.
const COLUMNS: usize = 5;
/// Shorter side of a picture in the preview, pixels, about.
const PREVIEW: u32 = 240;
/// Errors in the preview are shown so many times as bright.
const BRIGHTER: f32 = 5.0;

/// A document with a title, a sentence about it, and the HTML of its sections.
pub(super) fn document(title: &str, lead: &str, sections: &str) -> String {
    let (title, lead) = (escape(title), escape(lead));
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><title>{title} · dgs</title>\n\
         <style>{STYLE}</style></head>\n<body><main>\n<header><h1>{title}</h1>\n\
         <p class=\"lead\">{lead}</p>\n</header>\n{sections}</main></body></html>\n"
    )
}

/// `image` as a page shows it.
///
/// # Errors
/// Never for an image with pixels.
pub(super) fn small(image: &Image) -> Result<Image> {
    let (width, height) = image.size();
    let by = (width.min(height) / PREVIEW).max(1);
    Ok(image.resized_box(width / by, height / by)?)
}

/// How a training ended.
pub(super) struct Ended {
    pub(super) seconds: f64,
    pub(super) interrupted: bool,
}

/// What the page shows.
pub(super) struct Page<'a> {
    pub(super) dataset: &'a Dataset,
    pub(super) trained: &'a Trained,
    pub(super) log: &'a Log,
    pub(super) figures: &'a [Figure],
    pub(super) bytes: usize,
    pub(super) ended: &'a Ended,
    /// The section about fine-tuning for delivery, where there was one.
    pub(super) delivery: Option<&'a str>,
}

impl Page<'_> {
    /// Some views, row by row: photographs, pictures before the first step and after the last, errors of the
    /// latter; of the test split, or of the training split where there is none.
    pub(super) fn preview(&self) -> Result<Image> {
        let (begun, ended) = (self.compared(&self.trained.begun())?, self.compared(&self.trained.exact())?);
        let mut rows: [Vec<Image>; 4] = Default::default();
        for ([photograph, before], [_, after]) in begun.iter().zip(&ended) {
            let errors = after.rgb().iter().zip(photograph.rgb());
            let errors = errors.map(|(a, b)| ((a - b).abs() * BRIGHTER).min(1.0)).collect();
            let errors = Image::new(after.width(), after.height(), errors)?;
            let images = [photograph, before, after, &errors];
            for (row, image) in rows.iter_mut().zip(images) {
                row.push(small(image)?);
            }
        }
        let all: Vec<&Image> = rows.iter().flatten().collect();
        Ok(Image::strip(&all, ended.len().max(1), 4)?)
    }

    /// The photographs of the preview, each with its picture of `scene`.
    fn compared(&self, scene: &dyn DynamicScene) -> Result<Vec<[Image; 2]>> {
        let (trained, dataset) = (self.trained, self.dataset);
        let (reduced, background) = (trained.reduced, trained.options.background);
        let count = |views: usize| (0..COLUMNS.min(views)).map(move |k| k * views / COLUMNS.min(views));
        let found: Result<Vec<_>, _> = if dataset.test.is_empty() {
            count(dataset.train.photographs().len())
                .map(|index| train::compare(scene, &dataset.train, index, reduced, background))
                .collect()
        } else {
            let reduced = reduced * dataset.test_scale;
            count(dataset.test.photographs().len())
                .map(|index| train::compare(scene, &dataset.test, index, reduced, background))
                .collect()
        };
        Ok(found?.into_iter().map(|pair| [pair.photograph, pair.rendered]).collect())
    }

    /// The document; it needs nothing else.
    pub(super) fn html(&self) -> Result<String> {
        let lead = format!(
            "{} steps in {:.1} minutes gave {} Gaussians moved by {} control nodes, {} bytes as scene.dgs.",
            self.trained.steps,
            self.ended.seconds / 60.0,
            self.trained.gaussians,
            self.trained.nodes,
            self.bytes
        );
        let mut out = self.curves();
        out += "<h2>Quality</h2>\n<table><tr><th>views</th><th>size</th><th>background</th><th>PSNR, dB</th>\
                <th>worst view</th><th>foreground</th><th>SSIM</th><th>FLIP</th><th>LPIPS</th></tr>\n";
        for Figure { what, found, seen } in self.figures {
            let flip = share(seen.map_or(f64::NAN, |seen| seen.flip));
            let lpips = share(seen.and_then(|seen| seen.lpips).unwrap_or(f64::NAN));
            let _ = writeln!(
                out,
                "<tr><td>{}</td><td>{} × {}</td><td>{:?}</td><td>{}</td><td>{}</td><td>{}</td>\
                 <td>{}</td><td>{flip}</td><td>{lpips}</td></tr>",
                escape(what),
                found.size.0,
                found.size.1,
                found.background,
                decibels(found.psnr_db),
                decibels(found.worst_psnr_db),
                decibels(found.foreground_psnr_db),
                share(found.ssim)
            );
        }
        out += "</table>\n<h2>Photographs, pictures before and after, errors</h2>\n";
        let _ = writeln!(
            out,
            "<img alt=\"from above: photographs, pictures before training, after it, errors of these\" \
             style=\"max-width:100%\" src=\"{}\">\n<p class=\"note\">From above: photographs, pictures \
             before the first step and after the last, and errors of these, {BRIGHTER} times as bright as \
             they are.</p>",
            data_of_png(&self.preview()?.to_png()?)
        );
        out += self.delivery.unwrap_or_default();
        for note in &self.log.notes {
            let _ = writeln!(out, "<p class=\"note\">{}</p>", escape(note));
        }
        let options = serde_json::to_string_pretty(&self.trained.options)?;
        let _ = writeln!(out, "<h2>Options</h2>\n<pre>{}</pre>", escape(&options));
        Ok(document(&format!("Training of {}", self.dataset.name), &lead, &out))
    }

    /// Loss and PSNR over minutes.
    fn curves(&self) -> String {
        let samples = &self.log.samples;
        let minutes = |seconds: f64| seconds / 60.0;
        let loss = samples.iter().map(|s| (minutes(s.seconds), s.loss)).collect();
        let psnr = samples.iter().filter_map(|s| Some((minutes(s.seconds), s.psnr_db?))).collect();
        let line = |name, hue, points| Series { name, hue, shape: Shape::Line, points };
        let panel = |label, unit, decimals, series| Panel {
            label,
            unit,
            decimals,
            height: 170.0,
            covers: &[],
            series: vec![series],
        };
        let plot = Plot {
            title: "Loss and PSNR over minutes of training",
            x_label: "minutes",
            x: (0.0, minutes(self.log.seconds()).max(0.1)),
            panels: vec![
                panel("PSNR, dB", "dB", 2, line("PSNR of some held-out views", Hue::Scheduler(0), psnr)),
                panel("loss", "", 4, line("loss, mean of about 100 steps", Hue::Scheduler(1), loss)),
            ],
        };
        format!("<h2>Over time</h2>\n{}\n", plot.svg())
    }
}
