//! Shows streams and scenes until Ctrl-C, from a page on this machine, or in a window: `dgs view`.

#[cfg(feature = "window")]
mod loader;
mod opened;
#[cfg(feature = "window")]
mod window;

use std::net::Ipv4Addr;

use anyhow::{Context, Result, bail};
use dgs_quic::http::{HttpConfig, HttpLimits, HttpServer, Site, SiteStream};
use serde_json::json;

use self::opened::{check, check_names, opened};
use super::{
    serve::name,
    socket::{asset, interruption, runtime},
};
use crate::{
    args::{View, WindowArgs},
    output::{self, VerbOutput},
    pipeline::Quiet,
};

/// Runs the verb.
pub fn run(args: &View, quiet: Quiet) -> Result<VerbOutput> {
    match &args.screenshot {
        Some(out) => screenshot(args, out, quiet),
        None if args.window => window(args, quiet),
        None => page(args, quiet),
    }
}

#[cfg(feature = "window")]
use self::window::{screenshot, window};

/// Refuses: this program has no window.
#[cfg(not(feature = "window"))]
fn window(_: &View, _: Quiet) -> Result<VerbOutput> {
    anyhow::bail!("--window: this program was built without it; cargo build --release --features window")
}

/// Refuses: what a window would show needs what windows need.
#[cfg(not(feature = "window"))]
fn screenshot(_: &View, _: &std::path::Path, _: Quiet) -> Result<VerbOutput> {
    anyhow::bail!("--screenshot: this program was built without it; cargo build --release --features window")
}

/// Serves a page until Ctrl-C.
fn page(args: &View, quiet: Quiet) -> Result<VerbOutput> {
    let WindowArgs { seek, paused, once, fullscreen, .. } = args.look;
    if seek > 0.0 || paused || once || fullscreen {
        bail!("--seek, --paused, --once and --fullscreen are for --window, which is missing");
    }
    // Before any is encoded, for minutes.
    check_names(&args.inputs)?;
    args.inputs.iter().try_for_each(|input| check(input, args))?;
    let (mut warnings, mut damaged) = (Vec::new(), false);
    let mut streams = Vec::new();
    for input in &args.inputs {
        let file = opened(input, args, quiet, &mut |warning| warnings.push(warning))?;
        damaged |= file.damaged;
        let name = name(input);
        streams.push(SiteStream { name, address: None, web_address: None, file: Some(file.bytes.into()) });
    }
    let site = Site::new(asset, &streams, None)?;
    // At once: serving may take days.
    warnings.iter().for_each(|warning| output::print_status(&format!("warning: {warning}")));
    let (url, report) = runtime()?.block_on(async {
        // This machine alone: elsewhere a browser offers no WebGPU to a page without a certificate.
        let bind = (Ipv4Addr::LOCALHOST, args.port).into();
        let server =
            HttpServer::bind(&HttpConfig { bind, limits: HttpLimits::default() }, site).context("--port")?;
        let url = format!("http://localhost:{}/", server.local_addr().context("--port")?.port());
        let stop = interruption();
        // At once: whoever started this waits for it. With --json standard output is for the end.
        if quiet.0 {
            output::print_status(&format!("serving {url}"));
        } else {
            output::print(&format!("{url}\n"))?;
        }
        anyhow::Ok((url, server.run(stop).await))
    })?;
    let text = format!("{} connections, {} requests\n", report.connections, report.requests);
    let json = json!({ "url": url, "server": report, "warnings": warnings });
    // They were said when serving began.
    Ok(VerbOutput { text, json, warnings: Vec::new(), damaged })
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::args::{Cli, Verb};

    /// Nothing is read or encoded before: the inputs of this test are not there, or take long.
    #[test]
    fn streams_of_one_name_are_refused_before_anything_is_read() {
        for (inputs, named) in [
            (["none.dgs", "a/none.dgs"], "two streams are called none, none.dgs and a/none.dgs"),
            (["synth:cloth:900000:900", "synth:cloth"], "dgs encode makes a file of a scene"),
        ] {
            let typed = [["dgs", "view", "--port", "0"].as_slice(), &inputs].concat();
            let Ok(Cli { verb: Verb::View(args), .. }) = Cli::try_parse_from(&typed) else {
                panic!("{typed:?}")
            };
            let error = format!("{:#}", run(&args, Quiet(true)).unwrap_err());
            assert!(error.contains(named), "{error}");
        }
    }
}
