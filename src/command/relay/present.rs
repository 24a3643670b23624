//! Offers what is typed to a relay, and says what happens.

use anyhow::{Context, Result};
use dgs_quic::{
    moq::{self, PublishConfig, PublishError, PublishEvent, PublishReport},
    socket::{Locator, ServedStream, Trust, message::StreamChoice},
};
use serde_json::json;

use crate::{
    command::socket::{interruption, runtime},
    output::{self, VerbOutput},
    pipeline::Quiet,
};

/// Refuses so many streams under the name that `relay` has.
pub(in crate::command) fn check(relay: &Locator, streams: usize) -> Result<()> {
    match &relay.stream {
        StreamChoice::Name(name) if streams > 1 => {
            let error = PublishError::Name { name: name.clone(), streams };
            Err(error).with_context(|| relay.to_string())
        }
        StreamChoice::Name(_) | StreamChoice::Index(_) => Ok(()),
    }
}

/// Publishes `offers` at `relay` until Ctrl-C.
pub(in crate::command) fn publish(
    relay: &Locator,
    trust: Trust,
    offers: &[ServedStream],
    quiet: Quiet,
) -> Result<VerbOutput> {
    let urls: Vec<String> = offers.iter().map(|offer| address(relay, offer).to_string()).collect();
    let config = PublishConfig::new(relay.clone(), trust);
    let news = |news: &PublishEvent| tell(news, &urls, quiet);
    let published = runtime()?.block_on(moq::publish(&config, offers, interruption(), news));
    let report = published.with_context(|| relay.to_string())?;
    let json = json!({ "urls": urls, "relay": report });
    Ok(VerbOutput { text: summary(&report), json, ..VerbOutput::default() })
}

/// Where a stream is found.
fn address(relay: &Locator, offer: &ServedStream) -> Locator {
    let stream = match &relay.stream {
        StreamChoice::Index(_) => StreamChoice::Name(offer.name().to_owned()),
        named @ StreamChoice::Name(_) => named.clone(),
    };
    Locator { stream, ..relay.clone() }
}

/// Says what happens, at once: whoever started this waits for it.
fn tell(news: &PublishEvent, urls: &[String], quiet: Quiet) {
    match news {
        PublishEvent::Connected { .. } => {
            for url in urls {
                if quiet.0 {
                    output::print_status(&format!("publishing {url}"));
                } else {
                    // Where nobody reads any more, publishing goes on.
                    let _ = output::print(&format!("{url}\n"));
                }
            }
        }
        PublishEvent::Lost { reason, pause } => {
            output::print_status(&format!("the relay is gone ({reason}); again in {} s", pause.as_secs()));
        }
    }
}

/// What was published, for people.
fn summary(report: &PublishReport) -> String {
    let version = report.version.as_deref().unwrap_or("no version");
    let mut text = format!("{} connections to the relay, {version}\n", report.connections);
    for broadcast in &report.broadcasts {
        text += &format!(
            "{}: {} windows, {} groups, {} packets, {:.1} KiB\n",
            broadcast.name,
            broadcast.windows,
            broadcast.groups,
            broadcast.packets,
            broadcast.media_bytes as f64 / 1024.0
        );
    }
    text
}
