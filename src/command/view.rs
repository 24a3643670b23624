//! Shows `.dgs` files in a browser, from a page on this machine, until Ctrl-C: `dgs view`.

use std::net::Ipv4Addr;

use anyhow::{Context, Result};
use dgs_player::Stream;
use dgs_quic::http::{HttpConfig, HttpLimits, HttpServer, Site, SiteStream};
use serde_json::json;

use super::{
    serve::name,
    socket::{asset, interruption, runtime},
};
use crate::{
    args::View,
    output::{self, VerbOutput},
    pipeline::Quiet,
};

/// Runs the verb.
pub fn run(args: &View, quiet: Quiet) -> Result<VerbOutput> {
    let mut warnings = Vec::new();
    let mut streams = Vec::new();
    for input in &args.inputs {
        let shown = input.display();
        let file = std::fs::read(input).with_context(|| format!("{shown}: cannot read"))?;
        let (_, damage) = Stream::from_bytes(&file).with_context(|| {
            format!("{shown}: no .dgs file that can be shown (dgs encode makes one of a scene)")
        })?;
        if !damage.is_none() {
            warnings.push(format!("{shown}: {damage}"));
        }
        let name = name(&input.to_string_lossy());
        streams.push(SiteStream { name, address: None, web_address: None, file: Some(file.into()) });
    }
    let site = Site::new(asset, &streams, None)?;
    // At once: serving may take days.
    warnings.iter().for_each(|warning| output::complain(&format!("warning: {warning}")));
    let (url, report) = runtime()?.block_on(async {
        // This machine alone: elsewhere a browser offers no WebGPU to a page without a certificate.
        let bind = (Ipv4Addr::LOCALHOST, args.port).into();
        let server =
            HttpServer::bind(&HttpConfig { bind, limits: HttpLimits::default() }, site).context("--port")?;
        let url = format!("http://localhost:{}/", server.local_addr().context("--port")?.port());
        let stop = interruption();
        // At once: whoever started this waits for it. With --json standard output is for the end.
        if quiet.0 {
            output::complain(&format!("serving {url}"));
        } else {
            output::print(&format!("{url}\n"))?;
        }
        anyhow::Ok((url, server.run(stop).await))
    })?;
    let text = format!("{} connections, {} requests\n", report.connections, report.requests);
    let json = json!({ "url": url, "server": report, "warnings": warnings });
    Ok(VerbOutput { text, json, ..VerbOutput::default() })
}
