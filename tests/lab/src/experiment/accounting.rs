//! Prints the accounting table of the paper (its table 3): `paper`, its context coder, `dgs1`.

use anyhow::Result;
use dgs::{args::ProfileName, pipeline};
use trainer_host::encode::Protection;

use crate::{
    figures::{Bench, Figure},
    setup::{Setup, codec_args, load, synth},
};

/// Rows of the paper's table for D-NeRF bouncingballs: name, MiB.
const PAPER_MIB: [(&str, f64); 9] = [
    ("raw_symbols", 68.839),
    ("empirical_entropy", 42.817),
    ("monolithic", 42.821),
    ("payload", 42.942),
    ("headers", 0.792),
    ("dependencies", 0.141),
    ("crc", 0.144),
    ("manifest", 0.314),
    ("wire", 44.334),
];

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "accounting",
        "every byte of a stream, MiB; the peer column is the paper's own table (28.8k Gaussians of another \
            scene), \
         so shapes compare, not sizes; default quality, no parity",
    );
    let samples = if setup.quick { 4000 } else { 28_640 };
    let found = setup.data("scenes/gltf-fox/Fox.glb", &mut bench)?;
    let (name, scene) = match found {
        Some(path) => ("fox", load(&path, samples)?),
        None => ("synth-figure", synth("figure", samples, 30)?),
    };
    let profiles = [
        ("paper", ProfileName::Paper),
        ("paper-context", ProfileName::PaperContext),
        ("dgs1", ProfileName::Dgs1),
    ];
    for (profile, typed) in profiles {
        let options = pipeline::encode_options(&codec_args(typed), Protection::NONE);
        let encoded = pipeline::encode(&scene, &options, setup.quiet)?;
        let packets = encoded.packet_report()?;
        let ledger = &encoded.report.ledger;
        let key = |what: &str| format!("{name}.{profile}.{what}");
        let rows = [
            ledger.raw_symbols,
            ledger.empirical_entropy,
            ledger.monolithic,
            ledger.payload,
            ledger.headers,
            ledger.dependencies,
            ledger.crc,
            ledger.manifest,
            ledger.wire(),
        ];
        for ((row, paper), bytes) in PAPER_MIB.into_iter().zip(rows) {
            let mut figure = Figure::new(key(row), bytes / 1048576.0, "MiB");
            figure.peer = Some("paper".into());
            figure.peer_value = Some(paper);
            bench.push(figure);
        }
        let mut beside = |what: &str, value: f64, unit: &str, paper: f64| {
            let mut figure = Figure::new(key(what), value, unit);
            figure.peer = Some("paper".into());
            figure.peer_value = Some(paper);
            bench.push(figure);
        };
        let per_symbol = 8.0 * ledger.monolithic / ledger.symbols.max(1) as f64;
        let gap = 100.0 * (ledger.monolithic / ledger.empirical_entropy.max(1.0) - 1.0);
        beside("rans_gap", gap, "%", 0.009);
        beside("bits_per_symbol", per_symbol, "bit", 9.952);
        beside("symbols_per_gaussian", ledger.symbols as f64 / ledger.gaussians as f64, "", 1251.4);
        beside("packetisation_overhead", 100.0 * ledger.packetisation_overhead(), "%", 2.45);
        beside("robustness_premium", 100.0 * ledger.robustness_premium(), "%", 3.53);
        beside("bits_per_gaussian", ledger.bits_per_gaussian(), "bit", 12_894.7);
        beside("mean_payload", packets.mean_payload_bytes, "byte", 1192.8);
        beside("fill", 100.0 * packets.fill, "%", 99.4);
        beside("chunk_loss_per_packet", packets.chunk_loss_bytes, "byte", 3.36);
        beside("packets_per_refinement_group", packets.packets_per_refinement_group, "", 385.0);
        let clusters = encoded.report.clustering.clusters as f64;
        bench.push(Figure::new(key("clusters"), clusters, ""));
        bench.push(Figure::new(key("packets_per_base_group"), packets.packets_per_base_group, ""));
        let metadata = ledger.manifest_parts.iter().find(|part| part.name == "manifest clusters");
        let metadata = metadata.map_or(0.0, |part| part.bits / 8.0);
        bench.push(Figure::new(key("cluster_metadata"), metadata / 1048576.0, "MiB"));
    }
    Ok(bench)
}
