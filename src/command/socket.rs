//! Runs what serving and playing share: the runtime of sockets, and a person's wish to stop (Ctrl-C).

use std::{path::PathBuf, sync::Arc};

use anyhow::{Context, Result, bail};
use dgs_quic::socket::{Locator, Pin, Trust};
use tokio::{runtime::Runtime, sync::Notify};

use super::interruption::leave;

/// What sockets run on.
///
/// # Errors
/// If the system refuses threads.
pub(super) fn runtime() -> Result<Runtime> {
    Runtime::new().context("cannot start a runtime for sockets")
}

/// By what the server at `url` is known.
///
/// # Errors
/// If nothing says so, or two do that need not say the same.
pub(super) fn trust(url: &Locator, pin: Option<Pin>, authority: Option<&PathBuf>) -> Result<Trust> {
    match (pin, url.pin, authority) {
        (Some(typed), Some(pin), _) if typed != pin => {
            bail!("{url}: --pin is {typed}, and the URL has another; leave out the wrong one")
        }
        (_, Some(_), Some(_)) => bail!(
            "{url}: the server is known by the pin of the URL, --ca would not check it; leave out --ca, or \
             what is from # on in the URL"
        ),
        (_, None, Some(file)) => Ok(Trust::Authority(file.clone())),
        (Some(pin), _, None) | (None, Some(pin), None) => Ok(Trust::Pin(pin)),
        (None, None, None) => {
            bail!("{url}: by what is the server known? #PIN in the URL, --pin or --ca says")
        }
    }
}

/// Ends at the first Ctrl-C; a second ends the process.
pub(super) fn interruption() -> impl Future<Output = ()> {
    let wish = Arc::new(Notify::new());
    let heard = wish.clone();
    let mut second = false;
    // Where no handler can be set, an interruption ends the process as it does any other.
    let _ = ctrlc::set_handler(move || {
        if std::mem::replace(&mut second, true) {
            leave();
        }
        wish.notify_one();
    });
    async move { heard.notified().await }
}

/// The files of the player's page, as an HTTP server asks for them.
pub(super) fn asset(path: &str) -> Option<(&'static [u8], &'static str)> {
    dgs_viewer::asset(path).map(|asset| (asset.bytes, asset.content_type))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_is_known_by_one_thing() {
        let (digits, others) = ("ab".repeat(32), "cd".repeat(32));
        let pin = |digits: &str| digits.parse::<Pin>().unwrap();
        let bare: Locator = "dgs://host/fox".parse().unwrap();
        let pinned: Locator = format!("dgs://host/fox#{digits}").parse().unwrap();
        let file = PathBuf::from("ca.pem");
        let is_pin = |trust: Result<Trust>| matches!(trust, Ok(Trust::Pin(found)) if found == pin(&digits));
        assert!(is_pin(trust(&pinned, None, None)));
        assert!(is_pin(trust(&bare, Some(pin(&digits)), None)));
        assert!(is_pin(trust(&pinned, Some(pin(&digits)), None)));
        assert!(matches!(trust(&bare, None, Some(&file)), Ok(Trust::Authority(found)) if found == file));
        for (url, pin, authority, named) in [
            (&bare, None, None, "by what is the server known"),
            (&pinned, Some(pin(&others)), None, "--pin is cdcd"),
            (&pinned, None, Some(&file), "leave out --ca"),
        ] {
            let error = trust(url, pin, authority).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
