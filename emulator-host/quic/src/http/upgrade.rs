//! Turns a request of a page of this site into a WebSocket (RFC 6455) for the server of sessions.

use std::net::SocketAddr;

use bytes::Bytes;
use http_body_util::Full;
use hyper::{
    HeaderMap, Method, Request, Response, StatusCode,
    body::Incoming,
    header::{
        CONNECTION, CONTENT_LENGTH, CONTENT_TYPE, HOST, HeaderName, ORIGIN, SEC_WEBSOCKET_ACCEPT,
        SEC_WEBSOCKET_KEY, SEC_WEBSOCKET_VERSION, UPGRADE,
    },
    http,
};
use hyper_util::rt::TokioIo;
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{handshake::derive_accept_key, protocol::Role},
};

use super::answer::Answer;
use crate::socket::{WebSocketAcceptor, socket_config};

/// Where sessions are.
pub(super) const PATH: &str = "/session";
/// The version of RFC 6455.
const VERSION: &str = "13";
/// Characters of a key: 16 bytes in Base64.
const KEY_LENGTH: usize = 24;

/// Answers `request`, which is for [`PATH`]; where it is granted, `entrance` gets the WebSocket.
///
/// # Errors
/// None in practice: every field is made of legal characters.
pub(super) fn upgrade(
    request: &mut Request<Incoming>,
    entrance: &WebSocketAcceptor,
    address: SocketAddr,
) -> Result<Answer, http::Error> {
    let key = match key(request.method(), request.headers()) {
        Ok(key) => key.to_owned(),
        Err((status, sentence)) => return refusal(status, sentence),
    };
    let Some(place) = entrance.place(address.ip()) else {
        return refusal(StatusCode::SERVICE_UNAVAILABLE, "all places are taken\n");
    };
    let (upgrading, entrance) = (hyper::upgrade::on(request), entrance.clone());
    // It ends with the connection: at the latest when the bounds on a head are exceeded.
    tokio::spawn(async move {
        let Ok(upgraded) = upgrading.await else { return };
        let io = TokioIo::new(upgraded);
        let socket = WebSocketStream::from_raw_socket(io, Role::Server, Some(socket_config())).await;
        entrance.enter(socket, address, place).await;
    });
    Response::builder()
        .status(StatusCode::SWITCHING_PROTOCOLS)
        .header(CONNECTION, "upgrade")
        .header(UPGRADE, "websocket")
        .header(SEC_WEBSOCKET_ACCEPT, derive_accept_key(key.as_bytes()))
        .body(Full::default())
}

/// The key of a request for a WebSocket.
///
/// # Errors
/// A status and a sentence for whoever asks otherwise.
fn key<'f>(method: &Method, fields: &'f HeaderMap) -> Result<&'f str, (StatusCode, &'static str)> {
    let is_upgrade = names(fields, CONNECTION, "upgrade") && names(fields, UPGRADE, "websocket");
    if *method != Method::GET || !is_upgrade {
        return Err((StatusCode::UPGRADE_REQUIRED, "a WebSocket is here, nothing to read\n"));
    }
    if field(fields, SEC_WEBSOCKET_VERSION) != Some(VERSION) {
        return Err((StatusCode::UPGRADE_REQUIRED, "version 13 of the WebSocket protocol is spoken here\n"));
    }
    if !is_of_this_site(fields) {
        return Err((StatusCode::FORBIDDEN, "pages of other sites have no sessions here\n"));
    }
    let key = field(fields, SEC_WEBSOCKET_KEY).filter(|key| key.len() == KEY_LENGTH);
    key.ok_or((StatusCode::BAD_REQUEST, "Sec-WebSocket-Key is 24 characters of Base64\n"))
}

/// Whether who asks is no browser, or shows a page of the host that it asks.
fn is_of_this_site(fields: &HeaderMap) -> bool {
    if !fields.contains_key(ORIGIN) {
        return true;
    }
    let origin = field(fields, ORIGIN).and_then(|origin| origin.split_once("://"));
    origin.is_some_and(|(_, host)| field(fields, HOST) == Some(host))
}

/// Whether the list of a field holds `name`, in whatever case.
fn names(fields: &HeaderMap, list: HeaderName, name: &str) -> bool {
    let texts = fields.get_all(list).iter().filter_map(|field| field.to_str().ok());
    texts.flat_map(|text| text.split(',')).any(|found| found.trim().eq_ignore_ascii_case(name))
}

/// A field that stands there once.
fn field(fields: &HeaderMap, name: HeaderName) -> Option<&str> {
    let mut all = fields.get_all(name).iter();
    let first = all.next()?;
    if all.next().is_some() { None } else { first.to_str().ok() }
}

fn refusal(status: StatusCode, sentence: &'static str) -> Result<Answer, http::Error> {
    let sentence = Bytes::from_static(sentence.as_bytes());
    Response::builder()
        .status(status)
        .header(SEC_WEBSOCKET_VERSION, VERSION)
        .header(CONTENT_TYPE, "text/plain; charset=utf-8")
        .header(CONTENT_LENGTH, sentence.len())
        .body(Full::new(sentence))
}

#[cfg(test)]
mod tests {
    use hyper::header::HeaderValue;

    use super::*;

    const REQUEST: [(HeaderName, &str); 6] = [
        (HOST, "localhost:4641"),
        (CONNECTION, "keep-alive, Upgrade"),
        (UPGRADE, "WebSocket"),
        (SEC_WEBSOCKET_VERSION, "13"),
        (SEC_WEBSOCKET_KEY, "dGhlIHNhbXBsZSBub25jZQ=="),
        (ORIGIN, "http://localhost:4641"),
    ];

    fn fields_with(change: Option<(HeaderName, &str)>) -> HeaderMap {
        let fields = REQUEST.into_iter().chain(change);
        fields.map(|(name, value)| (name, HeaderValue::from_str(value).unwrap())).collect()
    }

    #[test]
    fn a_page_of_this_site_is_let_in_and_nobody_else() {
        let status =
            |fields: &HeaderMap| key(&Method::GET, fields).err().map_or(101, |(code, _)| code.as_u16());
        assert_eq!(key(&Method::GET, &fields_with(None)), Ok("dGhlIHNhbXBsZSBub25jZQ=="));
        assert_eq!(key(&Method::HEAD, &fields_with(None)).unwrap_err().0, StatusCode::UPGRADE_REQUIRED);
        for (name, value, expected) in [
            (ORIGIN, "http://elsewhere:4641", 403),
            (ORIGIN, "null", 403),
            (SEC_WEBSOCKET_VERSION, "8", 426),
            (SEC_WEBSOCKET_KEY, "short", 400),
            (UPGRADE, "h2c", 426),
            (CONNECTION, "close", 426),
        ] {
            let mut fields = fields_with(None);
            fields.insert(&name, HeaderValue::from_str(value).unwrap());
            assert_eq!(status(&fields), expected, "{name}: {value}");
        }
        // Twice is once too often; and who sends no origin is no browser.
        assert_eq!(status(&fields_with(Some((ORIGIN, "http://localhost:4641")))), 403);
        let mut program = fields_with(None);
        program.remove(ORIGIN);
        assert_eq!(status(&program), 101);
    }

    #[test]
    fn the_answer_to_the_key_of_the_standard_is_that_of_the_standard() {
        assert_eq!(derive_accept_key(b"dGhlIHNhbXBsZSBub25jZQ=="), "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=");
    }
}
