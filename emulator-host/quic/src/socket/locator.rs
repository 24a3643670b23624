//! Parses and writes the address of a stream: `dgs://HOST[:PORT][/NAME][#PIN]`, or by another scheme.

use std::{fmt, str::FromStr};

use super::{
    identity::Pin,
    message::{StreamChoice, is_name},
    scheme::Scheme,
};

/// The port when none is given.
pub const DEFAULT_PORT: u16 = 4640;
/// The port of a relay when none is given: that of HTTPS.
const RELAY_PORT: u16 = 443;
/// Longest name of a broadcast, its parts together.
const MAX_PATH_BYTES: usize = 255;

/// Where a stream is served, and by whose certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Locator {
    /// By what.
    pub scheme: Scheme,
    /// Name or address of the server; IPv6 without its brackets.
    pub host: String,
    /// UDP port.
    pub port: u16,
    /// The stream; the first one where none is named.
    pub stream: StreamChoice,
    /// SHA-256 of the server's certificate.
    pub pin: Option<Pin>,
}

/// Why a text is no address of a stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}: {part} is {found:?}, allowed {allowed}")]
pub struct LocatorError {
    text: String,
    part: &'static str,
    found: String,
    allowed: &'static str,
}

impl FromStr for Locator {
    type Err = LocatorError;

    fn from_str(text: &str) -> Result<Self, LocatorError> {
        let illegal = |part, found: &str, allowed| LocatorError {
            text: text.to_owned(),
            part,
            found: found.to_owned(),
            allowed,
        };
        let (found, rest) = text.split_once("://").unwrap_or(("", text));
        let scheme = Scheme::of(found);
        let allowed = match found {
            "http" => "dgs, https, moq+https: what dgs serve prints with http is for browsers",
            "" if text.ends_with(".dgs") => "dgs, https, moq+https: a file is shown by dgs view",
            _ => "dgs, https, moq+https",
        };
        let scheme = scheme.ok_or_else(|| illegal("scheme", found, allowed))?;
        let (rest, pin) = match rest.split_once('#').or_else(|| rest.split_once("?pin=")) {
            Some((rest, pin)) => {
                let parsed = pin.parse().map_err(|_| illegal("pin", pin, "64 hexadecimal digits"))?;
                (rest, Some(parsed))
            }
            None => (rest, None),
        };
        let (place, name) = rest.split_once('/').unwrap_or((rest, ""));
        let stream = match name {
            "" => StreamChoice::Index(0),
            name if is_name(name) => StreamChoice::Name(name.to_owned()),
            // Relays grant names by their first parts.
            path if scheme == Scheme::Moq && is_path(path) => StreamChoice::Name(path.to_owned()),
            name => return Err(illegal("name", name, "1 to 64 letters, digits, '.', '_', '-'")),
        };
        let (host, port) = match place.strip_prefix('[').and_then(|inside| inside.split_once(']')) {
            Some((host, port)) => (host, port.strip_prefix(':').or(port.is_empty().then_some(""))),
            None => place.split_once(':').map_or((place, Some("")), |(host, port)| (host, Some(port))),
        };
        let port = match port {
            Some("") if scheme == Scheme::Moq => Some(RELAY_PORT),
            Some("") => Some(DEFAULT_PORT),
            port => port.and_then(|port| port.parse().ok()).filter(|port| *port > 0),
        };
        let port = port.ok_or_else(|| illegal("port", place, "1 to 65535"))?;
        let legal = |c: char| c.is_ascii_alphanumeric() || ".:-_".contains(c);
        if host.is_empty() || host.len() > 253 || !host.chars().all(legal) {
            return Err(illegal("host", host, "a name or an address"));
        }
        Ok(Self { scheme, host: host.to_owned(), port, stream, pin })
    }
}

/// Whether `text` is names with slashes between.
fn is_path(text: &str) -> bool {
    text.len() <= MAX_PATH_BYTES && text.split('/').all(is_name)
}

impl fmt::Display for Locator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scheme, host, port, stream, pin } = self;
        let scheme = scheme.name();
        if host.contains(':') {
            write!(f, "{scheme}://[{host}]:{port}")?;
        } else {
            write!(f, "{scheme}://{host}:{port}")?;
        }
        if let StreamChoice::Name(name) = stream {
            write!(f, "/{name}")?;
        }
        pin.as_ref().map_or(Ok(()), |pin| write!(f, "#{pin}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_come_back_as_they_were() {
        let pin = "0123456789abcdef".repeat(4);
        for text in [
            "dgs://127.0.0.1:4640".to_owned(),
            format!("dgs://example.org:9/fox#{pin}"),
            format!("dgs://[::1]:4640/a.b-c_d#{pin}"),
            format!("https://[::1]:4640/a.b-c_d#{pin}"),
            format!("moq+https://relay.example:443/live/fox#{pin}"),
        ] {
            assert_eq!(text.parse::<Locator>().unwrap().to_string(), text);
        }
        let short = format!("dgs://host/fox?pin={pin}").parse::<Locator>().unwrap();
        assert_eq!(short.to_string(), format!("dgs://host:{DEFAULT_PORT}/fox#{pin}"));
        assert_eq!("moq+https://relay/fox".parse::<Locator>().unwrap().port, RELAY_PORT);
        assert_eq!("dgs://[::1]".parse::<Locator>().unwrap().port, DEFAULT_PORT);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, named) in [
            ("http://host/fox", "scheme is \"http\", allowed dgs, https, moq+https"),
            ("http://host/fox", "what dgs serve prints with http is for browsers"),
            ("fox.dgs", "a file is shown by dgs view"),
            ("dgs://host:0/fox", "port"),
            ("dgs://host:70000", "port"),
            ("dgs://[::1]x", "port"),
            ("dgs:///fox", "host"),
            ("dgs://ho st", "host"),
            ("dgs://host/a/b", "name is \"a/b\""),
            ("moq+https://host/a//b", "name is \"a//b\""),
            ("dgs://host#12", "pin is \"12\""),
        ] {
            let error = text.parse::<Locator>().unwrap_err();
            assert!(error.to_string().contains(named), "{error}");
        }
    }
}
