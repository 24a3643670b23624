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
/// If nothing says so.
pub(super) fn trust(url: &Locator, pin: Option<Pin>, authority: Option<&PathBuf>) -> Result<Trust> {
    match (pin.or(url.pin), authority) {
        (_, Some(file)) => Ok(Trust::Authority(file.clone())),
        (Some(pin), None) => Ok(Trust::Pin(pin)),
        (None, None) => bail!("{url}: by what is the server known? #PIN in the URL, --pin or --ca says"),
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
