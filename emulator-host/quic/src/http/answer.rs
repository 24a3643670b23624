//! Answers one request: method, path, validators and ranges in; status, fields and bytes out.

use bytes::Bytes;
use http_body_util::Full;
use hyper::{
    HeaderMap, Method, Response, StatusCode,
    header::{
        ACCEPT_RANGES, ALLOW, CACHE_CONTROL, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG, HeaderName,
        IF_NONE_MATCH, IF_RANGE, RANGE, X_CONTENT_TYPE_OPTIONS,
    },
    http,
};

use super::{
    range::{Wanted, wanted},
    site::{Resource, Site},
};

/// An answer and its bytes.
pub(super) type Answer = Response<Full<Bytes>>;

/// What `site` answers.
///
/// # Errors
/// None in practice: every field is made of legal characters.
pub(super) fn answer(
    site: &Site,
    method: &Method,
    path: &str,
    fields: &HeaderMap,
) -> Result<Answer, http::Error> {
    if *method != Method::GET && *method != Method::HEAD {
        return Response::builder()
            .status(StatusCode::METHOD_NOT_ALLOWED)
            .header(ALLOW, "GET, HEAD")
            .header(CONTENT_LENGTH, 0)
            .body(Full::default());
    }
    let Some(resource) = site.resource(path) else {
        let sentence = Bytes::from_static(b"there is nothing of this name; / lists the streams\n");
        return Response::builder()
            .status(StatusCode::NOT_FOUND)
            .header(CONTENT_TYPE, "text/plain; charset=utf-8")
            .header(CONTENT_LENGTH, sentence.len())
            .body(body(method, sentence));
    };
    // A page must not show a stream that is no longer served; the tag makes asking again cheap.
    let response = Response::builder()
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
    use hyper::header::HeaderValue;

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
