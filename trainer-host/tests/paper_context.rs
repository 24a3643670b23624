//! The context coder of profile `paper`: the same Gaussians in fewer bytes, from the same decisions.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use codec_core::internals::wire::manifest::ChunkCoder;
use trainer_host::{
    Scene,
    encode::{Decisions, EncodeOptions, Encoded, encode, write},
    import::{
        Limits,
        synth::{self, SynthKind},
    },
    stream::Player,
};

fn scene() -> Scene {
    let kind = SynthKind::Cloth;
    let options = synth::SynthOptions { kind, gaussians: 1000, frames: 10, frames_per_second: 20.0, seed: 7 };
    synth::make(&options, &Limits::default()).unwrap()
}

/// Every value of every frame, as bits.
fn decoded(encoded: &Encoded) -> Vec<u32> {
    let stream = &encoded.stream;
    let received = stream.receive().unwrap();
    let manifest = stream.manifest().unwrap();
    let mut player = Player::new(&manifest);
    let mut values = Vec::new();
    for frame in 0..manifest.head().frames {
        for g in &player.instant(&received.content(), frame).unwrap().gaussians {
            values.extend(g.position.iter().chain(&g.scale).chain(&g.rotation).chain(&g.sh0));
            values.push(g.opacity);
        }
    }
    values.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn both_coders_give_the_same_gaussians_and_the_context_coder_takes_fewer_bytes() {
    let scene = scene();
    let coded =
        |options: &EncodeOptions| encode(&scene, options, &trainer_host::encode::no_progress).unwrap();
    let (tables, context) = (coded(&EncodeOptions::paper()), coded(&EncodeOptions::paper_context()));
    assert_eq!(tables.stream.manifest().unwrap().chunk_coder(), Some(ChunkCoder::Tables));
    assert_eq!(context.stream.manifest().unwrap().chunk_coder(), Some(ChunkCoder::Context));
    assert_eq!(decoded(&tables), decoded(&context));
    let (a, b) = (&tables.report.ledger, &context.report.ledger);
    assert_eq!((a.symbols, a.raw_symbols), (b.symbols, b.raw_symbols));
    assert!(b.payload < 0.8 * a.payload, "{} and {} bytes of payload", a.payload, b.payload);
    assert!(b.manifest < a.manifest, "no tables travel");
    for ledger in [a, b] {
        // Cutting into packets costs something, and less than a fifth: probabilities start anew.
        assert!(ledger.monolithic <= ledger.payload && ledger.payload < 1.2 * ledger.monolithic);
    }
}

#[test]
fn decisions_with_the_context_coder_replay_to_the_same_bytes() {
    let scene = scene();
    let first = encode(&scene, &EncodeOptions::paper_context(), &trainer_host::encode::no_progress).unwrap();
    let json = serde_json::to_string(&first.decisions).unwrap();
    let decisions: Decisions = serde_json::from_str(&json).unwrap();
    let again = write(&scene, &decisions, &trainer_host::encode::no_progress).unwrap();
    assert_eq!(again.stream.to_bytes().unwrap(), first.stream.to_bytes().unwrap());
    // Without the word it is profile `paper`, as decisions were before there was a choice.
    let old = json.replace("\"context_coder\":true,", "");
    assert_ne!(old, json);
    let replayed =
        write(&scene, &serde_json::from_str(&old).unwrap(), &trainer_host::encode::no_progress).unwrap();
    let tables = encode(&scene, &EncodeOptions::paper(), &trainer_host::encode::no_progress).unwrap();
    assert_eq!(replayed.stream.to_bytes().unwrap(), tables.stream.to_bytes().unwrap());
}
