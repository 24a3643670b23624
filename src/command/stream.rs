//! Streams a scene by one scheduler over one link: `dgs stream`.

use anyhow::Result;
use serde_json::json;
use trainer_host::{
    encode::Protection,
    stream::PacketMap,
    utility,
    viewpoint::{Framing, Ring},
};

use crate::{
    args::StreamArgs,
    figures::number,
    output::VerbOutput,
    pipeline::{self, Quiet},
};

/// Runs the verb.
pub fn run(args: &StreamArgs, quiet: Quiet) -> Result<VerbOutput> {
    let mut warnings = Vec::new();
    let table: Option<utility::Table>;
    let stream = if pipeline::is_stream(&args.input) {
        let path = std::path::Path::new(&args.input);
        let stream = pipeline::read_stream(path, &mut |w| warnings.push(w))?;
        table = pipeline::stored_utilities(&pipeline::utility_path(path), stream.manifest()?.raw()).ok();
        if table.is_none() {
            warnings.push(format!(
                "{}: no utilities beside it (encode with --utility); all groups count the same",
                args.input
            ));
        }
        stream
    } else {
        let loaded = pipeline::import(&args.input, &args.scene)?;
        let stream = pipeline::encode(
            &loaded.scene,
            &pipeline::encode_options(&args.codec, Protection::STANDARD),
            quiet,
        )?
        .stream;
        let map = PacketMap::of(&stream)?;
        let received = stream.receive()?;
        let framing = Framing::of(&loaded.scene);
        let cameras = framing.ring(Ring::Measuring, 3, (128, 128))?;
        let options = utility::UtilityOptions::paper();
        let measured = pipeline::utilities(
            &utility::References::renders(&loaded.scene, &cameras),
            &received.content(),
            &map,
            &options,
            None,
            quiet,
            &mut |_| (),
        )?;
        table = Some(measured);
        stream
    };
    let map = PacketMap::of(&stream)?;
    let graph = pipeline::graph(&stream, &map, table.as_ref())?;
    let link = pipeline::link(&args.link, &graph)?;
    warnings.extend(link.warnings.iter().cloned());
    let (report, shown) =
        pipeline::deliver(&stream, &map, &graph, &link.config, pipeline::policy(args.policy))?;
    let startup = report.startup_ms.map_or("never".to_owned(), |ms| format!("{ms:.0} ms"));
    let text = format!(
        "{} over {}\n  startup {startup}, miss {:.1} % (base {:.1} %), utility {:.3}\n  \
         limited by {}\n  \
         goodput {} kbit/s, usable {} kbit/s, wasted {:.1} KiB, {} of {} frames shown, {} recovered by \
         repair\n",
        report.policy,
        link.description,
        100.0 * report.miss_rate,
        100.0 * report.base_miss_rate,
        report.utility,
        link.limit(&report),
        number(report.goodput_bps / 1000.0),
        number(report.usable_goodput_bps / 1000.0),
        report.waste.total_bytes() as f64 / 1024.0,
        shown.len(),
        graph.frames(),
        report.recovered
    );
    let limit = link.limit(&report);
    let json = json!({ "link": link.description, "limit": limit, "report": report, "warnings": warnings });
    Ok(VerbOutput { text, json, warnings, damaged: false })
}
