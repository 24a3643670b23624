//! Makes the page of a training: curves of loss and PSNR, figures, pictures beside photographs.

use std::fmt::Write as _;

use anyhow::Result;
use render_host::Image;
use trainer_host::train::{self, Dataset};

use super::{figures::Figure, log::Log, trained::Trained};
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
}

impl Page<'_> {
    /// Photographs, pictures and errors of some views, row by row: of the test split, or of the training
    /// split where there is none.
    pub(super) fn preview(&self) -> Result<Image> {
        let (trained, dataset) = (self.trained, self.dataset);
        let (reduced, background) = (trained.reduced, trained.options.background);
        let exact = trained.exact();
        let count = |views: usize| (0..COLUMNS.min(views)).map(move |k| k * views / COLUMNS.min(views));
        let mut compared = Vec::new();
        if dataset.test.is_empty() {
            for index in count(dataset.train.photographs().len()) {
                compared.push(train::compare(&exact, &dataset.train, index, reduced, background)?);
            }
        } else {
            for index in count(dataset.test.photographs().len()) {
                compared.push(train::compare(
                    &exact,
                    &dataset.test,
                    index,
                    reduced * dataset.test_scale,
                    background,
                )?);
            }
        }
        let mut rows: [Vec<Image>; 3] = Default::default();
        for pair in &compared {
            let errors = pair.rendered.rgb().iter().zip(pair.photograph.rgb());
            let errors = errors.map(|(a, b)| ((a - b).abs() * BRIGHTER).min(1.0)).collect();
            let (width, height) = pair.rendered.size();
            let errors = Image::new(width, height, errors)?;
            for (row, image) in rows.iter_mut().zip([&pair.photograph, &pair.rendered, &errors]) {
                let by = (width.min(height) / PREVIEW).max(1);
                row.push(image.resized_box(width / by, height / by)?);
            }
        }
        let all: Vec<&Image> = rows.iter().flatten().collect();
        Ok(Image::strip(&all, compared.len().max(1), 4)?)
    }

    /// The document; it needs nothing else.
    pub(super) fn html(&self) -> Result<String> {
        let title = escape(&format!("Training of {}", self.dataset.name));
        let mut out = format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
             content=\"width=device-width, initial-scale=1\"><title>{title} · dgs</title>\n\
             <style>{STYLE}</style></head>\n<body><main>\n<header><h1>{title}</h1>\n\
             <p class=\"lead\">{} steps \
             in {:.1} minutes gave {} Gaussians moved by {} control nodes, {} bytes as scene.dgs.</p>\n\
             </header>\n",
            self.trained.steps,
            self.ended.seconds / 60.0,
            self.trained.gaussians,
            self.trained.nodes,
            self.bytes
        );
        out += &self.curves();
        out += "<h2>Quality</h2>\n<table><tr><th>views</th><th>size</th><th>background</th><th>PSNR, dB</th>\
                <th>worst view</th><th>foreground</th><th>SSIM</th><th>FLIP</th><th>LPIPS</th></tr>\n";
        for Figure { what, found, seen } in self.figures {
            let flip = seen.map_or("–".to_owned(), |seen| format!("{:.4}", seen.flip));
            let lpips = seen.and_then(|seen| seen.lpips);
            let lpips = lpips.map_or("–".to_owned(), |lpips| format!("{lpips:.4}"));
            let _ = writeln!(
                out,
                "<tr><td>{}</td><td>{} × {}</td><td>{:?}</td><td>{:.2}</td><td>{:.2}</td><td>{:.2}</td>\
                 <td>{:.4}</td><td>{flip}</td><td>{lpips}</td></tr>",
                escape(what),
                found.size.0,
                found.size.1,
                found.background,
                found.psnr_db,
                found.worst_psnr_db,
                found.foreground_psnr_db,
                found.ssim
            );
        }
        out += "</table>\n<h2>Photographs, pictures, errors</h2>\n";
        let _ = writeln!(
            out,
            "<img alt=\"photographs above, pictures below, errors at the bottom\" style=\"max-width:100%\" \
             src=\"{}\">\n<p class=\"note\">Errors are {BRIGHTER} times as bright as they are.</p>",
            data_of_png(&self.preview()?.to_png()?)
        );
        for note in &self.log.notes {
            let _ = writeln!(out, "<p class=\"note\">{}</p>", escape(note));
        }
        let options = serde_json::to_string_pretty(&self.trained.options)?;
        let _ = writeln!(out, "<h2>Options</h2>\n<pre>{}</pre>\n</main></body></html>", escape(&options));
        Ok(out)
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
