//! Lists the codecs under measurement, each with its knob.

use anyhow::Result;
use trainer_host::Scene;

use super::{coded::Coded, context, dgs1, plain, spz, uniform};

/// What a codec is to `dgs1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CodecKind {
    /// `dgs1` itself.
    Ours,
    /// `dgs1` without one of its means: no peer.
    Variant,
    /// The paper's format.
    Paper,
    /// A known method, written here.
    Method,
    /// A public format, through its own or our writer.
    Public,
}

impl CodecKind {
    /// Whether `dgs1` competes with it.
    pub const fn is_peer(self) -> bool {
        matches!(self, Self::Method | Self::Public)
    }
}

/// Codes a scene at one setting of the codec's knob (and a zstd level where one is used) and decodes the
/// frames named.
pub type Code = fn(&Scene, f32, i32, &[u32]) -> Result<Coded>;

/// A codec with its knob.
#[derive(Clone)]
pub struct Codec {
    /// Name in keys and tables.
    pub name: &'static str,
    /// What it is.
    pub kind: CodecKind,
    /// What the knob means.
    pub knob: &'static str,
    /// Settings, finest first.
    pub settings: Vec<f32>,
    /// zstd level, where one is used.
    pub level: i32,
    /// How to run it.
    pub code: Code,
}

/// All codecs, with fewer settings if `quick`.
pub fn all(quick: bool) -> Vec<Codec> {
    let ladder = |full: &[f32]| -> Vec<f32> {
        let every = if quick { 3 } else { 1 };
        full.iter().copied().step_by(every).collect()
    };
    let codec = |name, kind, knob, settings, level, code| {
        let level = if quick { 3 } else { level };
        Codec { name, kind, knob, settings, level, code }
    };
    let steps = "quantiser steps relative to the default";
    let position = "position step relative to the default";
    let fine = [0.2, 0.35, 0.5, 0.71, 1.0, 1.6, 2.5, 4.0, 6.3];
    let wide = [0.35, 0.7, 1.4, 2.8, 5.6, 11.0];
    let mut out = vec![
        codec("dgs1", CodecKind::Ours, steps, ladder(&fine), 0, dgs1::dgs1),
        codec("dgs1-even", CodecKind::Variant, steps, ladder(&wide), 0, dgs1::even),
        codec("paper", CodecKind::Paper, steps, ladder(&[0.5, 1.0, 2.0, 4.0, 8.0, 16.0]), 0, dgs1::paper),
        codec("uniform-rans", CodecKind::Method, steps, ladder(&wide), 0, uniform::code),
        codec("context-rans", CodecKind::Method, steps, ladder(&wide), 0, context::code),
        codec("ply-zstd", CodecKind::Public, "bits of a float", vec![32.0, 16.0], 19, plain::code),
        codec("spz-frames", CodecKind::Public, position, vec![1.0], 0, spz::code_frames),
        codec("spz-zstd", CodecKind::Public, position, vec![1.0], 19, spz::code),
        codec(
            "spz-delta-zstd",
            CodecKind::Public,
            position,
            ladder(&[0.5, 1.0, 2.0, 4.0, 8.0, 16.0]),
            19,
            spz::code_delta,
        ),
    ];
    out.push(fourdgs());
    out
}

/// The public crate `fourdgs`.
fn fourdgs() -> Codec {
    Codec {
        name: "4dgs",
        kind: CodecKind::Public,
        knob: "profile: 0 fine, 1 default, 2 coarse",
        settings: vec![0.0, 1.0, 2.0],
        level: 0,
        code: super::fourdgs::code,
    }
}
