//! Holds what a page's server serves, by path: assets of the page, streams, the list of streams, the pin.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    io::Write as _,
    str::FromStr,
    sync::{Mutex, PoisonError},
};

use bytes::Bytes;
use flate2::{Compression, write::GzEncoder};
use hyper::header::HeaderValue;
use serde::Serialize;

use crate::socket::{Pin, message::is_name};

/// The assets of a page: bytes and content type of a path such as `index.html` or `player/dgs.wasm`.
pub type Assets = fn(&str) -> Option<(&'static [u8], &'static str)>;

/// What is asked for when no path is given.
const INDEX: &str = "index.html";

/// A stream of the list.
#[derive(Clone, Debug)]
pub struct SiteStream {
    /// Its name, as in its address.
    pub name: String,
    /// Its address for `dgs play`, if there is a session server.
    pub address: Option<String>,
    /// Its address for a browser's WebTransport, if there is a session server.
    pub web_address: Option<String>,
    /// The bytes of its `.dgs` file, if it has an end.
    pub file: Option<Bytes>,
}

/// Why a site cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum SiteError {
    /// The name is no name of a stream.
    #[error("{name:?} cannot name a stream: 1 to 64 letters, digits, '.', '_', '-' are allowed")]
    Name {
        /// The name.
        name: String,
    },
    /// Two streams share a name.
    #[error("two streams are called {name}; rename one of the files")]
    Twice {
        /// The name.
        name: String,
    },
    /// The list of streams cannot be written.
    #[error("the list of streams: {0}")]
    List(#[from] serde_json::Error),
}

/// An origin as browsers send it (RFC 6454, 6.1), such as `https://example.org`, or `*` for any.
///
/// # Examples
/// ```
/// use dgs_quic::http::Origin;
///
/// assert!("https://example.org:8080".parse::<Origin>().is_ok());
/// assert!("example.org".parse::<Origin>().is_err());
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin(HeaderValue);

impl FromStr for Origin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let host = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"));
        let is_host =
            host.is_some_and(|host| !host.is_empty() && !host.contains(['/', '?', '#', '*', '@', ',', ' ']));
        let header = HeaderValue::from_str(text).ok().filter(|_| text == "*" || is_host);
        header.map(Self).ok_or_else(|| "https://HOST[:PORT], http://HOST[:PORT] or * is allowed".to_owned())
    }
}

/// Everything that is served.
#[derive(Debug)]
pub struct Site {
    assets: Assets,
    /// By path, with its leading slash.
    made: BTreeMap<String, Resource>,
    /// Whose pages besides our own may read what is served.
    allowed_origin: Option<Origin>,
    /// Assets that were asked for, by path, compressed by gzip.
    compressed: Mutex<BTreeMap<String, Bytes>>,
}

/// The bytes of one path.
#[derive(Clone, Debug)]
pub(super) struct Resource {
    pub(super) bytes: Bytes,
    pub(super) content_type: &'static str,
    /// Strong validator (RFC 9110, section 8.8.3): SHA-256 of the bytes, in quotes.
    pub(super) tag: String,
    /// Whether it is an asset of the page.
    is_asset: bool,
}

impl Resource {
    fn new(bytes: Bytes, content_type: &'static str) -> Self {
        let digest = ring::digest::digest(&ring::digest::SHA256, &bytes);
        let mut tag = String::with_capacity(66);
        tag.push('"');
        for byte in digest.as_ref() {
            // A String takes everything.
            let _ = write!(tag, "{byte:02x}");
        }
        tag.push('"');
        Self { bytes, content_type, tag, is_asset: false }
    }
}

/// A stream in `/streams.json`.
#[derive(Serialize)]
struct Listed<'s> {
    name: &'s str,
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    address: Option<&'s str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    web_address: Option<&'s str>,
}

impl Site {
    /// A page of `assets` over `streams`; with `pin`, its digits under `/certificate.sha256`. Paths:
    /// `/` is the asset `index.html`; `/streams.json` the list of streams; `/streams/NAME.dgs` a stream as a
    /// file.
    ///
    /// # Errors
    /// [`SiteError`].
    pub fn new(assets: Assets, streams: &[SiteStream], pin: Option<Pin>) -> Result<Self, SiteError> {
        let mut made = BTreeMap::new();
        for (at, stream) in streams.iter().enumerate() {
            let name = || stream.name.clone();
            if !is_name(&stream.name) {
                return Err(SiteError::Name { name: name() });
            }
            if streams[..at].iter().any(|before| before.name == stream.name) {
                return Err(SiteError::Twice { name: name() });
            }
            if let Some(file) = &stream.file {
                let resource = Resource::new(file.clone(), "application/octet-stream");
                made.insert(file_path(&stream.name), resource);
            }
        }
        let listed: Vec<Listed<'_>> = streams.iter().map(listed).collect();
        let json = serde_json::to_vec_pretty(&listed)?;
        made.insert("/streams.json".to_owned(), Resource::new(json.into(), "application/json"));
        if let Some(pin) = pin {
            let resource = Resource::new(pin.to_string().into(), "text/plain; charset=utf-8");
            made.insert("/certificate.sha256".to_owned(), resource);
        }
        Ok(Self { assets, made, allowed_origin: None, compressed: Mutex::default() })
    }

    /// Lets pages of `origin` read what is served: otherwise browsers show it to pages of this server alone.
    #[must_use]
    pub fn with_allowed_origin(self, origin: Origin) -> Self {
        Self { allowed_origin: Some(origin), ..self }
    }

    pub(super) fn allowed_origin(&self) -> Option<&HeaderValue> {
        self.allowed_origin.as_ref().map(|origin| &origin.0)
    }

    /// The bytes of `resource`, which is that of `path`, compressed by gzip, if it is an asset: streams are
    /// compressed as they are.
    pub(super) fn compressed(&self, path: &str, resource: &Resource) -> Option<Bytes> {
        if !resource.is_asset {
            return None;
        }
        let lock = || self.compressed.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = lock().get(path) {
            return Some(known.clone());
        }
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        let made = encoder.write_all(&resource.bytes).and_then(|()| encoder.finish());
        // Writing to memory does not fail.
        let made = Bytes::from(made.ok()?);
        lock().insert(path.to_owned(), made.clone());
        Some(made)
    }

    /// What is served under `path`, which begins with a slash. An asset goes before what is made here.
    pub(super) fn resource(&self, path: &str) -> Option<Resource> {
        let path = if path == "/" { &format!("/{INDEX}") } else { path };
        let asset = (self.assets)(path.strip_prefix('/')?);
        match asset {
            Some((bytes, content_type)) => {
                let resource = Resource::new(Bytes::from_static(bytes), content_type);
                Some(Resource { is_asset: true, ..resource })
            }
            None => self.made.get(path).cloned(),
        }
    }
}

fn file_path(name: &str) -> String {
    format!("/streams/{name}.dgs")
}

fn listed(stream: &SiteStream) -> Listed<'_> {
    Listed {
        name: &stream.name,
        file: stream.file.as_ref().map(|_| file_path(&stream.name)),
        bytes: stream.file.as_ref().map(Bytes::len),
        address: stream.address.as_deref(),
        web_address: stream.web_address.as_deref(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;

    use super::*;

    #[test]
    fn an_asset_goes_before_what_is_made_and_a_missing_one_is_missing() {
        let assets: Assets = |path| (path == "index.html").then_some((b"page".as_slice(), "text/html"));
        let stream = SiteStream {
            name: "fox".to_owned(),
            address: Some("dgs://host".to_owned()),
            web_address: None,
            file: Some(Bytes::from_static(b"DGSM")),
        };
        let site = Site::new(assets, std::slice::from_ref(&stream), None).unwrap();
        let mut page = Vec::new();
        let resource = |path: &str| site.resource(path).unwrap();
        let compressed = site.compressed("/", &resource("/")).unwrap();
        flate2::read::GzDecoder::new(&compressed[..]).read_to_end(&mut page).unwrap();
        assert_eq!(page, b"page");
        assert!(site.compressed("/streams/fox.dgs", &resource("/streams/fox.dgs")).is_none());
        assert_eq!(site.resource("/").unwrap().bytes, "page");
        assert_eq!(site.resource("/streams/fox.dgs").unwrap().bytes, "DGSM");
        for missing in ["", "index.html", "//", "/certificate.sha256", "/streams/..%2ffox.dgs", "/../fox.dgs"]
        {
            assert!(site.resource(missing).is_none(), "{missing}");
        }
        let bare = Site::new(|_| None, std::slice::from_ref(&stream), None).unwrap();
        assert!(bare.resource("/").is_none());
        let json = bare.resource("/streams.json").unwrap().bytes;
        let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
        assert_eq!(json[0]["file"], "/streams/fox.dgs");
        assert_eq!((&json[0]["bytes"], &json[0]["address"]), (&4.into(), &"dgs://host".into()));
        let twice = [stream.clone(), stream.clone()];
        assert!(matches!(Site::new(|_| None, &twice, None), Err(SiteError::Twice { .. })));
        let bad = SiteStream { name: "a/b".to_owned(), ..stream };
        assert!(matches!(Site::new(|_| None, &[bad], None), Err(SiteError::Name { .. })));
    }
}
