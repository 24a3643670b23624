//! Answers one request: method, path, validators and ranges in; status, fields and bytes out.

use bytes::Bytes;
use http_body_util::Full;
use hyper::{
    HeaderMap, Method, Response, StatusCode,
    header::{
        ACCEPT_ENCODING, ACCEPT_RANGES, ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS,
        ACCESS_CONTROL_ALLOW_ORIGIN, ACCESS_CONTROL_EXPOSE_HEADERS, ACCESS_CONTROL_MAX_AGE, ALLOW,
        CACHE_CONTROL, CONTENT_ENCODING, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG, HeaderName,
        HeaderValue, IF_NONE_MATCH, IF_RANGE, RANGE, VARY, X_CONTENT_TYPE_OPTIONS,
    },
    http,
};

use super::{
    range::{Wanted, wanted},
    site::{Resource, Site},
};

/// An answer and its bytes.
pub(super) type Answer = Response<Full<Bytes>>;

/// What `site` answers; pages of others may read it if the site lets them (Fetch, 3.2).
///
/// # Errors
/// None in practice: every field is made of legal characters.
pub(super) fn answer(
    site: &Site,
    method: &Method,
    path: &str,
    fields: &HeaderMap,
) -> Result<Answer, http::Error> {
    let Some(origin) = site.allowed_origin() else { return answer_own(site, method, path, fields) };
    let mut answer = if *method == Method::OPTIONS {
        Response::builder()
            .status(StatusCode::NO_CONTENT)
            .header(ACCESS_CONTROL_ALLOW_METHODS, "GET, HEAD")
            .header(ACCESS_CONTROL_ALLOW_HEADERS, "Range, If-Range, If-None-Match")
            .header(ACCESS_CONTROL_MAX_AGE, 86_400)
            .body(Full::default())?
    } else {
        answer_own(site, method, path, fields)?
    };
    let shown = HeaderValue::from_static("Accept-Ranges, Content-Length, Content-Range, ETag");
    answer.headers_mut().insert(ACCESS_CONTROL_EXPOSE_HEADERS, shown);
    answer.headers_mut().insert(ACCESS_CONTROL_ALLOW_ORIGIN, origin.clone());
    Ok(answer)
}

/// What `site` answers to its own pages.
fn answer_own(site: &Site, method: &Method, path: &str, fields: &HeaderMap) -> Result<Answer, http::Error> {
    if *method != Method::GET && *method != Method::HEAD {
        return Response::builder()
            .status(StatusCode::METHOD_NOT_ALLOWED)
            .header(ALLOW, "GET, HEAD")
            .header(CONTENT_LENGTH, 0)
            .body(Full::default());
    }
    let Some(mut resource) = site.resource(path) else {
        let sentence =
            Bytes::from_static(b"there is nothing of this name; /streams.json lists the streams\n");
        return Response::builder()
            .status(StatusCode::NOT_FOUND)
            .header(CONTENT_TYPE, "text/plain; charset=utf-8")
            .header(CONTENT_LENGTH, sentence.len())
            .body(body(method, sentence));
    };
    // Ranges count bytes that are not compressed.
    let takes = takes_gzip(fields) && !fields.contains_key(RANGE);
    let compressed = if takes { site.compressed(path, &resource) } else { None };
    let mut response = Response::builder();
    if let Some(bytes) = compressed {
        resource.tag = format!("{}-gzip\"", resource.tag.trim_end_matches('"'));
        resource.bytes = bytes;
        response = response.header(CONTENT_ENCODING, "gzip");
    }
    // A page must not show a stream that is no longer served; the tag makes asking again cheap.
    let response = response
        .header(VARY, "Accept-Encoding")
        .header(ETAG, &resource.tag)
        .header(CACHE_CONTROL, "no-cache")
        .header(ACCEPT_RANGES, "bytes")
        .header(CONTENT_TYPE, resource.content_type)
        .header(X_CONTENT_TYPE_OPTIONS, "nosniff");
    if is_known(fields, &resource) {
        return response.status(StatusCode::NOT_MODIFIED).body(Full::default());
    }
    let len = resource.bytes.len() as u64;
    // Ranges are defined for GET alone.
    let wanted = if *method == Method::GET { part(fields, &resource, len) } else { Wanted::Whole };
    match wanted {
        Wanted::Whole => response.header(CONTENT_LENGTH, len).body(body(method, resource.bytes)),
        Wanted::Part(part) => {
            let (first, last) = (part.start, part.end - 1);
            // Both ends lie within the bytes, whose count is a usize.
            let bytes = resource.bytes.slice(part.start as usize..part.end as usize);
            response
                .status(StatusCode::PARTIAL_CONTENT)
                .header(CONTENT_RANGE, format!("bytes {first}-{last}/{len}"))
                .header(CONTENT_LENGTH, bytes.len())
                .body(body(method, bytes))
        }
        Wanted::Nothing => response
            .status(StatusCode::RANGE_NOT_SATISFIABLE)
            .header(CONTENT_RANGE, format!("bytes */{len}"))
            .header(CONTENT_LENGTH, 0)
            .body(Full::default()),
    }
}

/// The body for a method: HEAD has none.
fn body(method: &Method, bytes: Bytes) -> Full<Bytes> {
    if *method == Method::HEAD { Full::default() } else { Full::new(bytes) }
}

/// Whether the client takes bytes compressed by gzip (RFC 9110, 12.5.3).
fn takes_gzip(fields: &HeaderMap) -> bool {
    let all = fields.get_all(ACCEPT_ENCODING).iter().filter_map(|field| field.to_str().ok());
    all.flat_map(|field| field.split(',')).any(|coding| {
        let mut parts = coding.split(';').map(str::trim);
        let is_gzip = parts.next().is_some_and(|name| name.eq_ignore_ascii_case("gzip"));
        is_gzip && !parts.any(|weight| matches!(weight, "q=0" | "q=0.0" | "q=0.00" | "q=0.000"))
    })
}

/// Whether the client says that it has these bytes already.
fn is_known(fields: &HeaderMap, resource: &Resource) -> bool {
    let tags = fields.get_all(IF_NONE_MATCH).iter().filter_map(|field| field.to_str().ok());
    // Weak comparison, as for reading: a tag of ours has no comma inside.
    let same = |tag: &str| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == resource.tag;
    tags.flat_map(|field| field.split(',')).any(|tag| same(tag.trim()))
}

/// The bytes that are wanted, if a range still means the bytes that the client knows.
fn part(fields: &HeaderMap, resource: &Resource, len: u64) -> Wanted {
    let Some(range) = only(fields, RANGE) else { return Wanted::Whole };
    let unchanged = match fields.get(IF_RANGE) {
        // A date is no tag of ours: then the file is sent whole.
        Some(tag) => tag.as_bytes() == resource.tag.as_bytes(),
        None => true,
    };
    if unchanged { wanted(range, len) } else { Wanted::Whole }
}

/// A field that stands there once.
fn only(fields: &HeaderMap, name: HeaderName) -> Option<&str> {
    let mut all = fields.get_all(name).iter();
    let first = all.next()?;
    if all.next().is_some() { None } else { first.to_str().ok() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::SiteStream;

    fn site() -> Site {
        let file = Some(Bytes::from_static(b"0123456789"));
        let stream = SiteStream { name: "ten".to_owned(), address: None, web_address: None, file };
        Site::new(|_| None, &[stream], None).unwrap()
    }

    fn answered(method: Method, fields: &[(HeaderName, &str)]) -> Answer {
        let mut map = HeaderMap::new();
        for (name, value) in fields {
            map.append(name, HeaderValue::from_str(value).unwrap());
        }
        answer(&site(), &method, "/streams/ten.dgs", &map).unwrap()
    }

    fn field(answer: &Answer, name: HeaderName) -> &str {
        answer.headers().get(name).map_or("", |value| value.to_str().unwrap())
    }

    #[test]
    fn assets_are_compressed_for_who_takes_it_and_streams_are_not() {
        let assets = |path: &str| {
            (path == "a.js").then_some((&b"let a = 1; let b = 1; let c = 1;"[..], "text/javascript"))
        };
        let file = Some(Bytes::from_static(b"0123456789"));
        let stream = SiteStream { name: "ten".to_owned(), address: None, web_address: None, file };
        let site = Site::new(assets, &[stream], None).unwrap();
        let ask = |path: &str, fields: &[(HeaderName, &str)]| {
            let fields =
                fields.iter().map(|(name, value)| (name.clone(), HeaderValue::from_str(value).unwrap()));
            answer(&site, &Method::GET, path, &fields.collect()).unwrap()
        };
        let gzip = (ACCEPT_ENCODING, "br, gzip;q=0.8");
        let packed = ask("/a.js", std::slice::from_ref(&gzip));
        assert_eq!(field(&packed, CONTENT_ENCODING), "gzip");
        let tag = field(&packed, ETAG).to_owned();
        let plain = ask("/a.js", &[(ACCEPT_ENCODING, "gzip;q=0, br")]);
        assert_eq!((field(&plain, CONTENT_ENCODING), field(&plain, CONTENT_LENGTH)), ("", "32"));
        assert_ne!(field(&plain, ETAG), tag);
        assert_eq!(ask("/a.js", &[gzip.clone(), (IF_NONE_MATCH, &tag)]).status().as_u16(), 304);
        assert_eq!(field(&ask("/a.js", &[gzip.clone(), (RANGE, "bytes=0-3")]), CONTENT_LENGTH), "4");
        assert_eq!(field(&ask("/streams/ten.dgs", &[gzip]), CONTENT_LENGTH), "10");
    }

    #[test]
    fn pages_of_others_read_what_they_are_let_to() {
        assert_eq!(field(&answered(Method::GET, &[]), ACCESS_CONTROL_ALLOW_ORIGIN), "");
        assert_eq!(answered(Method::OPTIONS, &[]).status().as_u16(), 405);
        let open = site().with_allowed_origin("*".parse().unwrap());
        let ask = |method| answer(&open, &method, "/streams/ten.dgs", &HeaderMap::new()).unwrap();
        assert_eq!(field(&ask(Method::GET), ACCESS_CONTROL_ALLOW_ORIGIN), "*");
        let preflight = ask(Method::OPTIONS);
        assert_eq!(preflight.status().as_u16(), 204);
        assert!(field(&preflight, ACCESS_CONTROL_ALLOW_HEADERS).contains("Range"));
        for none in ["", "example.org", "https://", "https://a/b", "https://a, https://b", "https://a\n"] {
            assert!(none.parse::<crate::http::Origin>().is_err(), "{none:?}");
        }
    }

    #[test]
    fn ranges_and_validators_decide_together() {
        let tag = field(&answered(Method::GET, &[]), ETAG).to_owned();
        let stale = "\"0000\"";
        let weak = format!("W/{tag}");
        let both = format!("{stale}, {tag}");
        let range = (RANGE, "bytes=2-4");
        for (fields, status) in [
            (vec![], 200),
            (vec![range.clone()], 206),
            (vec![range.clone(), (IF_RANGE, tag.as_str())], 206),
            (vec![range.clone(), (IF_RANGE, stale)], 200),
            (vec![range.clone(), (IF_RANGE, weak.as_str())], 200),
            (vec![range.clone(), (IF_RANGE, "Sat, 29 Oct 1994 19:43:31 GMT")], 200),
            (vec![range.clone(), range.clone()], 200),
            (vec![(RANGE, "bytes=10-")], 416),
            (vec![(RANGE, "bytes=10-"), (IF_RANGE, stale)], 200),
            (vec![(IF_NONE_MATCH, tag.as_str())], 304),
            (vec![(IF_NONE_MATCH, both.as_str())], 304),
            (vec![(IF_NONE_MATCH, weak.as_str())], 304),
            (vec![(IF_NONE_MATCH, "*")], 304),
            (vec![(IF_NONE_MATCH, stale)], 200),
            (vec![range.clone(), (IF_NONE_MATCH, tag.as_str())], 304),
        ] {
            assert_eq!(answered(Method::GET, &fields).status().as_u16(), status, "{fields:?}");
        }
        let part = answered(Method::GET, std::slice::from_ref(&range));
        assert_eq!(field(&part, CONTENT_RANGE), "bytes 2-4/10");
        assert_eq!(field(&part, CONTENT_LENGTH), "3");
        assert_eq!(field(&answered(Method::GET, &[(RANGE, "bytes=10-")]), CONTENT_RANGE), "bytes */10");
        let head = answered(Method::HEAD, &[range]);
        assert_eq!((head.status().as_u16(), field(&head, CONTENT_LENGTH)), (200, "10"));
        assert_eq!(answered(Method::DELETE, &[]).status().as_u16(), 405);
    }
}
