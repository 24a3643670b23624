//! An asset is a file that a page needs: the page, its style, its scripts, the player as WebAssembly.

/// A file's bytes and media type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asset {
    /// Its bytes.
    pub bytes: &'static [u8],
    /// Its media type.
    pub content_type: &'static str,
}

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The page, and where its server lists streams: on a server of plain files it asks for no list in vain.
const PAGE: &str =
    concat!(include_str!("../page/index.html"), "<meta name=\"dgs-streams\" content=\"streams.json\">\n");

macro_rules! assets {
    ($($name:literal $kind:expr, $bytes:expr;)*) => {
        /// Every asset: its name, its media type, its bytes.
        const ASSETS: &[(&str, &str, &[u8])] = &[$(($name, $kind, $bytes)),*];
    };
}

assets! {
    "index.html" HTML, PAGE.as_bytes();
    "page.css" CSS, include_bytes!("../page/page.css");
    "page.js" SCRIPT, include_bytes!("../page/page.js");
    "dgs-player.js" SCRIPT, include_bytes!("../page/dgs-player.js");
    "attributes.js" SCRIPT, include_bytes!("../page/attributes.js");
    "bar.js" SCRIPT, include_bytes!("../page/bar.js");
    "conditions.js" SCRIPT, include_bytes!("../page/conditions.js");
    "decoder.js" SCRIPT, include_bytes!("../page/decoder.js");
    "decoding.js" SCRIPT, include_bytes!("../page/decoding.js");
    "engine.js" SCRIPT, include_bytes!("../page/engine.js");
    "source.js" SCRIPT, include_bytes!("../page/source.js");
    "input.js" SCRIPT, include_bytes!("../page/input.js");
    "ladder.js" SCRIPT, include_bytes!("../page/ladder.js");
    "legend.js" SCRIPT, include_bytes!("../page/legend.js");
    "links.js" SCRIPT, include_bytes!("../page/links.js");
    "live.js" SCRIPT, include_bytes!("../page/live.js");
    "load.js" SCRIPT, include_bytes!("../page/load.js");
    "network.js" SCRIPT, include_bytes!("../page/network.js");
    "session.js" SCRIPT, include_bytes!("../page/session.js");
    "style.js" SCRIPT, include_bytes!("../page/style.js");
    "worker.js" SCRIPT, include_bytes!("../page/worker.js");
    "dgs_viewer.js" SCRIPT, include_bytes!("../dist/dgs_viewer.js");
    "dgs_viewer_bg.wasm" "application/wasm", include_bytes!("../dist/dgs_viewer_bg.wasm");
}

/// The asset at `path` of an address, `/` being the page; `None` if there is none.
///
/// ```
/// let page = dgs_viewer::asset("/").expect("the page");
/// assert!(page.content_type.starts_with("text/html"));
/// assert!(dgs_viewer::asset("/none").is_none());
/// ```
pub fn asset(path: &str) -> Option<Asset> {
    let name = path.strip_prefix('/').unwrap_or(path);
    let name = if name.is_empty() { "index.html" } else { name };
    let (_, content_type, bytes) = ASSETS.iter().find(|(known, ..)| *known == name)?;
    Some(Asset { bytes, content_type })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_finds_everything_that_it_names() {
        assert_eq!(asset("/").unwrap(), asset("index.html").unwrap());
        assert_eq!(asset("/../Cargo.toml"), None);
        for (name, kind, bytes) in ASSETS.iter().filter(|(_, kind, _)| *kind == SCRIPT || *kind == HTML) {
            let text = std::str::from_utf8(bytes).unwrap();
            for wording in ["from \"./", "new URL(\"./", "src=\"./", "href=\""] {
                for part in text.split(wording).skip(1) {
                    let named = part.split('"').next().unwrap();
                    let found = asset(named).is_some() || named.starts_with("data:");
                    assert!(found, "{name} ({kind}) names {named}");
                }
            }
        }
        assert!(asset("dgs_viewer_bg.wasm").unwrap().bytes.starts_with(b"\0asm"));
    }
}
