//! Lists every experiment: one file per bench, one [`Bench`] of figures each.

mod accounting;
mod agreement;
mod clock;
mod cloud;
mod convert;
mod counterfactual;
mod decode;
mod delivery;
mod demo;
mod embedded;
mod entropy;
mod erasure;
mod gpu;
mod gradient;
mod loss;
mod objective;
mod pareto;
mod partial;
mod quic_model;
mod rank;
mod rate;
mod render;
mod repair;
mod serve;
mod sims;
mod skips;
mod stress;
mod structure;
mod train;
mod transport;
mod utility;
mod video;
mod view;
mod worlds;

use anyhow::Result;

use crate::{figures::Bench, setup::Setup};

/// A bench by name.
pub struct Experiment {
    /// As typed.
    pub name: &'static str,
    /// What it measures.
    pub about: &'static str,
    /// Measures.
    pub run: fn(&Setup) -> Result<Bench>,
}

/// All benches, in the order of the walk.
pub const ALL: &[Experiment] = &[
    Experiment { name: "demo", about: "wall time and peak memory of `dgs demo`", run: demo::run },
    Experiment {
        name: "rate",
        about: "rate and distortion of dgs1 beside the paper's format and public peers, Bjøntegaard rates, \
            overheads (--out)",
        run: rate::run,
    },
    Experiment {
        name: "accounting",
        about: "the paper's accounting table for profile paper, its own figures beside",
        run: accounting::run,
    },
    Experiment {
        name: "entropy",
        about: "the packet coder: symbols per second beside bytes over entropy, public coders in the same \
            run",
        run: entropy::run,
    },
    Experiment {
        name: "decode",
        about: "bytes to Gaussians on one core: receiver, frames, packet parse, CRC, closure",
        run: decode::run,
    },
    Experiment {
        name: "loss",
        about: "random packet subsets render; quality at 1, 5, 10 and 20 % packet loss",
        run: loss::run,
    },
    Experiment {
        name: "embedded",
        about: "flash, RAM, stack, instructions and digests on Cortex-M4F, WebAssembly and in C, within \
            budget",
        run: embedded::run,
    },
    Experiment {
        name: "repair",
        about: "residual loss of XOR and of the Cauchy code at equal overhead, and the code's speed beside \
            public peers",
        run: repair::run,
    },
    Experiment {
        name: "render",
        about: "CPU render time per frame beside its error against the f64 reference",
        run: render::run,
    },
    Experiment {
        name: "worlds",
        about: "pictures of 1 to 128 states in one call against serial renders, with memory",
        run: worlds::run,
    },
    Experiment {
        name: "counterfactual",
        about: "states, utilities and gradients per second against rendering every state alone",
        run: counterfactual::run,
    },
    Experiment {
        name: "utility",
        about: "utilities of all groups of a stream: time and error against every state decoded and \
        rendered alone",
        run: utility::run,
    },
    Experiment {
        name: "rank",
        about: "rank of the temporal basis after packet-conditioned training, chosen by validation (--out)",
        run: rank::run,
    },
    Experiment {
        name: "objective",
        about: "four ways of training for delivery: the complete state and the worst tenth of partial ones",
        run: objective::run,
    },
    Experiment {
        name: "erasure",
        about: "a scene trained for delivery beside one trained without, in the same states",
        run: erasure::run,
    },
    Experiment {
        name: "gradient",
        about: "gradients against f64 differences, time with gradients, utilities of groups estimated from \
            them",
        run: gradient::run,
    },
    Experiment {
        name: "train",
        about: "one iteration of training by stage: time of motion, picture, loss, gradients and update, and \
            of settings that trade accuracy for time, beside errors",
        run: train::run,
    },
    Experiment {
        name: "skips",
        about: "work, time and error of every skip of the CPU renderer, and of what a sequence keeps",
        run: skips::run,
    },
    Experiment {
        name: "stress",
        about: "numerical stress: time, error against f64 and refusals of every hard case",
        run: stress::run,
    },
    Experiment {
        name: "pareto",
        about: "time against error of every tolerance, precision and skip, alone and together (--out)",
        run: pareto::run,
    },
    Experiment {
        name: "gpu",
        about: "wgpu backend: time per stage beside its error, world batches",
        run: gpu::run,
    },
    Experiment {
        name: "sims",
        about: "deliveries of 30 s at 5 Mbit/s per second and core, time per packet event",
        run: sims::run,
    },
    Experiment {
        name: "agreement",
        about: "one stream over the model, over quinn-proto in virtual time and over loopback sockets: \
            startup, misses, losses, goodput, latency",
        run: agreement::run,
    },
    Experiment {
        name: "quic-model",
        about: "the model of QUIC beside quinn-proto in virtual time: goodput, lateness of frames, speed",
        run: quic_model::run,
    },
    Experiment {
        name: "transport",
        about: "schedulers on measured traces: utility beside the best possible, pictures, startup, waste",
        run: transport::run,
    },
    Experiment {
        name: "workloads",
        about: "schedulers over streams of 0.7 s to 3 min and 0.008 to 5 Mbit/s, on held-out \
            recordings (four of them decided one choice, that gains are scaled)",
        run: transport::workloads::run,
    },
    Experiment {
        name: "serve",
        about: "viewers at once over loopback at 50 Mbit/s: goodput, loss, processor time, memory, startup",
        run: serve::run,
    },
    Experiment {
        name: "view",
        about: "the player in a browser: first picture, frames per second, bytes, memory",
        run: view::run,
    },
    Experiment {
        name: "video",
        about: "pictures to AV1 without any tool: speed, bytes, error, beside encoders of ffmpeg",
        run: video::run,
    },
    Experiment {
        name: "convert",
        about: "a million Gaussians from PLY to other formats, and fewer Gaussians that look alike: time, \
            size, memory, PSNR, beside splat-transform",
        run: convert::run,
    },
    Experiment {
        name: "structure",
        about: "the source itself: lines per floor, public items, cycles between files, crates, lengths of \
            examples",
        run: structure::run,
    },
];
