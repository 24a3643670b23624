//! Writes frames side by side, as images inside the page.

use std::fmt::Write as _;

use render_host::Image;

use crate::report::{
    Page, Picture, Strip,
    plot::{Hue, escape, number},
};

/// Frames side by side.
pub(super) fn strips(out: &mut String, page: &Page) {
    out.push_str("<h2>Frames side by side</h2>\n");
    if page.strips.is_empty() {
        out.push_str("<p class=\"note\">No frames were picked.</p>\n");
        return;
    }
    out.push_str(
        "<p class=\"note\">The source’s own render, then what each scheduler showed at that frame’s \
            deadline; PSNR \
         against the source, the best of each row highlighted. <span class=\"hint\">Click an image to \
         enlarge it, \
         then flip along its row with ← and →.</span></p>\n<div class=\"strips\"><p class=\"toggle\"><label>\
         <input type=\"checkbox\" id=\"maps\" checked>Error maps</label><span class=\"scale\">no error \
         <i></i> full \
         scale or more; mean absolute difference of r, g, b</span></p>\n",
    );
    for strip in &page.strips {
        let texts = strip.shown.iter().filter_map(|p| p.psnr_db).filter(|v| v.is_finite());
        let best = texts.reduce(f64::max).map(|v| number(v, 2));
        let columns = 1 + strip.shown.len();
        let _ = write!(
            out,
            "<div class=\"scroll\"><div class=\"strip\" style=\"--n:{columns}\"><h3>Frame {}</h3>",
            strip.frame
        );
        picture(out, strip, &strip.reference, None, None);
        for (i, shown) in strip.shown.iter().enumerate() {
            picture(out, strip, shown, Some(i), best.as_deref());
        }
        out.push_str("</div></div>\n");
    }
    out.push_str("</div>\n");
}

/// An image under its caption, its error map below it.
fn picture(out: &mut String, strip: &Strip, picture: &Picture, run: Option<usize>, best: Option<&str>) {
    let caption = escape(&picture.caption);
    let psnr = picture.psnr_db.map_or("—".to_owned(), |v| number(v, 2));
    let swatch =
        run.map_or(String::new(), |i| format!(r#"<i class="swatch {}"></i>"#, Hue::Scheduler(i).class()));
    let score = match run {
        None if picture.psnr_db.is_none() => "reference".to_owned(),
        _ if best == Some(&psnr) => format!("<b>{psnr} dB</b>"),
        _ => format!("{psnr} dB"),
    };
    let _ = write!(out, "<figure><figcaption>{swatch}{caption}<span>{score}</span></figcaption>");
    let about = format!("frame {}, {caption}, {psnr} dB", strip.frame);
    embed(out, &picture.image, "frame", &about);
    if let Some(error) = &picture.error {
        embed(out, error, "map", &format!("error map of {about}"));
    }
    out.push_str("</figure>");
}

/// The image itself, or a dash where there is none.
fn embed(out: &mut String, image: &Image, class: &str, about: &str) {
    let Ok(png) = image.to_png() else {
        let _ = write!(out, r#"<div class="none {class}">—</div>"#);
        return;
    };
    let (width, height, data) = (image.width(), image.height(), base64(&png));
    let _ = write!(
        out,
        r#"<img class="{class}" width="{width}" height="{height}" alt="{about}" loading="lazy" decoding="async" src="data:image/png;base64,{data}">"#
    );
}

/// RFC 4648, padded.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let at = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let letter = char::from(LETTERS[(bits >> (18 - 6 * i) & 63) as usize]);
            out.push(if i > three.len() { '=' } else { letter });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::base64;

    #[test]
    fn base64_pads() {
        let texts = ["", "TQ==", "TWE=", "TWFu", "TWFu/w=="];
        let bytes: [&[u8]; 5] = [b"", b"M", b"Ma", b"Man", b"Man\xff"];
        for (text, bytes) in texts.iter().zip(bytes) {
            assert_eq!(base64(bytes), *text);
        }
    }
}
