//! Serves streams over QUIC until Ctrl-C: `dgs serve`.

use std::{path::Path, time::Duration};

use anyhow::{Context, Result};
use dgs_quic::socket::{
    Identity, Locator, Offer, Server, ServerConfig, ServerLimits, ServerReport, ViewerReport,
    message::{MAX_NAME_BYTES, StreamChoice},
};
use serde_json::json;

use super::socket::{interruption, runtime};
use crate::{
    args::Serve,
    output::{self, VerbOutput},
    pipeline::{self, Quiet},
};

/// Runs the verb.
pub fn run(args: &Serve, quiet: Quiet) -> Result<VerbOutput> {
    let mut warnings = Vec::new();
    let impairment = args.impair.as_deref().map(pipeline::impairment).transpose()?;
    let host = args.host.clone().unwrap_or_else(|| args.listen.ip().to_string());
    let identity = match args.cert.as_deref().zip(args.key.as_deref()) {
        Some((certificate, key)) => Identity::read(certificate, key)?,
        None => Identity::self_signed(&[host.clone(), "localhost".to_owned()])
            .with_context(|| format!("--host is {host}"))?,
    };
    let mut offers = Vec::new();
    for input in &args.inputs {
        let ready = pipeline::sendable(input, &args.scene, &args.codec, quiet, &mut |w| warnings.push(w))?;
        offers.push(Offer::new(&name(input), &ready.stream, ready.graph)?);
    }
    let limits = ServerLimits {
        max_viewers: args.max_viewers,
        max_rate_bps: args.max_rate.map(|mbit| (mbit * 1e6) as u64),
        idle: Duration::from_secs(args.idle),
        ..ServerLimits::default()
    };
    let policy = pipeline::policy(args.policy);
    let config = ServerConfig { bind: args.listen, identity, limits, policy, impairment };
    // At once: serving may take days.
    warnings.iter().for_each(|warning| output::complain(&format!("warning: {warning}")));
    let mut viewers = Vec::new();
    let (urls, report) = runtime()?.block_on(async {
        let server = Server::bind(config, offers)?;
        let port = server.local_addr().context("--listen")?.port();
        let url = |name: &str| Locator {
            host: host.clone(),
            port,
            stream: StreamChoice::Name(name.to_owned()),
            pin: Some(server.pin()),
        };
        let urls: Vec<String> = server.names().map(|name| url(name).to_string()).collect();
        let stop = interruption();
        // At once: whoever started this waits for it. With --json standard output is for the end.
        for url in &urls {
            if quiet.0 {
                output::complain(&format!("serving {url}"))
            } else {
                output::print(&format!("{url}\n"))?
            }
        }
        let ended = |viewer: &ViewerReport| {
            if !quiet.0 {
                // Where nobody reads any more, serving goes on.
                let _ = output::print(&line(viewer));
            }
            viewers.push(viewer.clone());
        };
        anyhow::Ok((urls, server.run(stop, ended).await))
    })?;
    let json = json!({ "urls": urls, "server": report, "viewers": viewers, "warnings": warnings });
    Ok(VerbOutput { text: summary(&report), json, ..VerbOutput::default() })
}

/// What a stream is called: its file's name without extension, other characters than a name has replaced.
pub(super) fn name(input: &str) -> String {
    let plain = input.strip_prefix("synth:").map_or(input, |kind| kind.split(':').next().unwrap_or(kind));
    let stem = Path::new(plain).file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
    let legal = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' };
    let name: String = stem.chars().take(MAX_NAME_BYTES).map(legal).collect();
    if name.is_empty() { "stream".to_owned() } else { name }
}

/// One viewer for people.
fn line(viewer: &ViewerReport) -> String {
    let ViewerReport { address, stream, seconds, rounds, packets, .. } = viewer;
    let share = 100.0 * viewer.lost as f64 / (*packets).max(1) as f64;
    let rate = viewer.media_bytes as f64 * 8e-6 / seconds.max(1e-3);
    format!(
        "{address} {stream}: {seconds:.1} s, {rounds} rounds, {packets} packets ({rate:.2} Mbit/s), lost \
         {share:.1} %, {} sent again, {} receipts ({} refused), round trip {:.1} ms; {}\n",
        viewer.retransmitted, viewer.receipts, viewer.refused_receipts, viewer.rtt_ms, viewer.end
    )
}

/// The server's own counts for people.
fn summary(report: &ServerReport) -> String {
    let refused: Vec<String> = report.refused.iter().map(|(code, count)| format!("{code} {count}")).collect();
    let refused = if refused.is_empty() { "none".to_owned() } else { refused.join(", ") };
    format!(
        "{} viewers; {} handshakes failed, {} turned away, {} had to prove their address; \
         refused: {refused}\n",
        report.viewers, report.failed_handshakes, report.turned_away, report.retried
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_called_by_their_files() {
        for (input, called) in [
            ("a/Fox.glb", "Fox"),
            ("b c.dgs", "b-c"),
            ("synth:figure:8000:60", "figure"),
            ("folder/", "folder"),
            ("/", "stream"),
        ] {
            assert_eq!(name(input), called);
        }
    }
}
