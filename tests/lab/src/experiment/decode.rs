//! Times the way from bytes to Gaussians on one core: the receiver, the decoder, and their smallest parts.

use std::hint::black_box;

use anyhow::{Result, ensure};
use codec_core::{
    Caps,
    internals::{
        closure::{Arrived, naive_usable},
        digest::Digest,
        gaussian::Gaussian,
        ids::Level,
        wire::{
            crc::{Crc32, crc32},
            packet::{Head, Packet},
        },
    },
    player::{Accepted, Player as CorePlayer, Waiting},
};
use codec_simd::{BatchReceiver, Kernel};
use dgs::{args::ProfileName, pipeline};
use trainer_host::{Scene, Stream, encode::Protection, stream::Player};

use super::clock::seconds as thread_seconds;
use crate::{
    figures::{Bench, Figure, median},
    setup::{Setup, codec_args, load, synth},
};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (gaussians, frames, runs) = if setup.quick { (3000, 4, 3) } else { (30_000, 24, 9) };
    let mut bench = Bench::new(
        "decode",
        format!(
            "{gaussians} Gaussians, {frames} frames, profile dgs1, default options; thread CPU time, medians \
                of {runs} interleaved runs; \
             receive: all packets of the stream through a receiver one by one (CRC, header, lattice, entropy \
             decoding in place); receive_many: \
             the same packets in batches, entropy decoded in lockstep; frames: every frame \
             in order by one decoder that keeps what did not change; bytes to Gaussians: both together, per \
             Gaussian and frame; the naive \
             twin takes a CRC bit by bit and dequantises everything again for every frame; its Gaussians \
             must be bit-identical"
        ),
    );
    let mut scenes: Vec<(&str, Scene)> = vec![("synth-balls", synth("balls", gaussians, frames)?)];
    if let Some(path) = setup.data("scenes/gltf-fox/Fox.glb", &mut bench)? {
        scenes.push(("fox", load(&path, gaussians)?));
    }
    for (name, scene) in &scenes {
        let options = pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::NONE);
        let stream = pipeline::encode(scene, &options, setup.quiet)?.stream;
        whole(&mut bench, name, &stream, runs)?;
        parts(&mut bench, name, &stream, runs)?;
    }
    Ok(bench)
}

/// A receiver's CRC without a table: what the fast ones are checked against.
fn bitwise(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _: u32| crc >> 1 ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 };
    !bytes.iter().fold(u32::MAX, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

/// Receives `stream` in `arena`, one packet at a time, and times it; the manifest is taken before.
fn receive<'a>(stream: &Stream, arena: &'a mut [u64], crc: Crc32) -> Result<(CorePlayer<'a>, f64)> {
    let caps = Caps { early_bytes: 0, ..Caps::HOST };
    let waiting = Waiting::new(arena, caps)?.with_arithmetic(crc, codec_simd::combine());
    let mut player = waiting.manifest(stream.message()).map_err(|(_, error)| error)?;
    let start = thread_seconds();
    for packet in stream.packets() {
        player.push(packet)?;
    }
    let seconds = thread_seconds() - start;
    Ok((player, seconds))
}

/// As [`receive`], by the host's CRC and many packets at a time.
fn receive_batches<'a>(
    stream: &Stream,
    arena: &'a mut [u64],
    kernel: Kernel,
) -> Result<(CorePlayer<'a>, f64)> {
    let caps = Caps { early_bytes: 0, ..Caps::HOST };
    let waiting = Waiting::new(arena, caps)?.with_arithmetic(codec_simd::crc32, codec_simd::combine());
    let mut player = waiting.manifest(stream.message()).map_err(|(_, error)| error)?;
    let mut refused = None;
    let start = thread_seconds();
    let packets = stream.packets().iter().map(Vec::as_slice);
    let answer = |answer: codec_core::Result<Accepted>| refused = refused.or(answer.err());
    BatchReceiver::with_kernel(kernel).receive(player.receiver(), packets, answer);
    let seconds = thread_seconds() - start;
    refused.map_or(Ok((player, seconds)), |error| Err(error.into()))
}

/// Digest of Gaussians, bit for bit.
fn digest(gaussians: &[Gaussian]) -> u64 {
    Digest::new().frame(gaussians, &[]).get()
}

fn whole(bench: &mut Bench, name: &str, stream: &Stream, runs: usize) -> Result<()> {
    let manifest = stream.manifest()?;
    let frames = manifest.head().frames;
    let mut arena = dgs_player::arena(stream.message(), &Caps { early_bytes: 0, ..Caps::HOST })?;
    // A stream is received once; the table is set up by the manifest, outside the time.
    let received = stream.receive()?;
    let content = received.content();
    let (mut player, mut fast, mut naive) = (Player::new(&manifest), Vec::new(), Vec::new());
    let mut shown = 0usize;
    for frame in 0..frames {
        let gaussians = player.show(&content, frame)?.gaussians;
        shown += gaussians.len();
        fast.push(digest(gaussians));
        naive.push(digest(Player::new(&manifest).show(&content, frame)?.gaussians));
    }
    ensure!(fast == naive, "{name}: a decoder that keeps what did not change shows something else");
    let (mut table, mut host, mut slow) = (Vec::new(), Vec::new(), Vec::new());
    let here = Kernel::ALL.into_iter().filter(|k| *k != Kernel::Scalar && k.is_here());
    let mut batches: Vec<(Kernel, Vec<f64>)> = here.map(|kernel| (kernel, Vec::new())).collect();
    let (mut first, mut steady, mut anew) = (Vec::new(), Vec::new(), Vec::new());
    for run in 0..runs {
        table.push(receive(stream, &mut arena, crc32)?.1);
        host.push(receive(stream, &mut arena, codec_simd::crc32)?.1);
        for (kernel, times) in &mut batches {
            let (player, seconds) = receive_batches(stream, &mut arena, *kernel)?;
            times.push(seconds);
            let found = player.content();
            let same = found.symbols == content.symbols && found.blocks == content.blocks;
            ensure!(same, "{name}: packets taken together by {} leave something else", kernel.name());
        }
        let mut player = Player::new(&manifest);
        let start = thread_seconds();
        player.show(&content, 0)?;
        first.push(thread_seconds() - start);
        let start = thread_seconds();
        for frame in 1..frames {
            black_box(player.show(&content, frame)?);
        }
        steady.push(thread_seconds() - start);
        if run % 3 == 0 {
            let (found, seconds) = receive(stream, &mut arena, bitwise)?;
            slow.push(seconds);
            ensure!(found.content().symbols == content.symbols, "{name}: a CRC changed symbols");
            let mut players: Vec<Player> = (0..frames).map(|_| Player::new(&manifest)).collect();
            let start = thread_seconds();
            for (frame, player) in (0..frames).zip(&mut players) {
                black_box(player.show(&content, frame)?);
            }
            anew.push(thread_seconds() - start);
        }
    }
    let symbols = content.symbols.len() as f64;
    let packets = stream.packets().len() as f64;
    let (table, host, slow) = (median(&table), median(&host), median(&slow));
    let (first, steady, anew) = (median(&first), median(&steady), median(&anew));
    let rate = |seconds: f64| shown as f64 / seconds / 1e6;
    // The kernels come slowest first; what a host does is the last of them.
    let batches: Vec<(Kernel, f64)> = batches.iter().map(|(k, times)| (*k, median(times))).collect();
    let best = batches.last().map_or(host, |(_, seconds)| *seconds);
    let figure =
        Figure::new(format!("{name}.bytes_to_gaussians"), rate(best + first + steady), "M Gaussian-frames/s");
    let figure = figure.error(0.0, "bits differ from the naive twin");
    bench.push(figure.peer("naive twin", rate(slow + anew), false).runs(runs));
    let figure = Figure::new(format!("{name}.frames"), rate(first + steady), "M Gaussian-frames/s");
    bench.push(
        figure.error(0.0, "bits differ").peer("all dequantised every frame", rate(anew), false).runs(runs),
    );
    let first_frame = Figure::new(format!("{name}.first_frame"), 1e3 * first, "ms");
    bench.push(first_frame.error(0.0, "bits differ").runs(runs));
    if frames > 1 {
        let next = 1e3 * steady / f64::from(frames - 1);
        let next_frame = Figure::new(format!("{name}.next_frame"), next, "ms");
        bench.push(next_frame.error(0.0, "bits differ").runs(runs));
    }
    let figure = Figure::new(format!("{name}.receive"), symbols / host / 1e6, "Msymbol/s");
    let figure = figure.error(0.0, "symbols differ between CRCs");
    bench.push(figure.peer("1 KiB CRC table", symbols / table / 1e6, false).runs(runs));
    let figure = Figure::new(format!("{name}.receive_packet"), 1e6 * host / packets, "µs");
    bench.push(figure.error(0.0, "symbols differ between CRCs").runs(runs));
    for (kernel, seconds) in batches {
        let key = format!("{name}.receive_many.{}", kernel.name());
        let figure = Figure::new(key, symbols / seconds / 1e6, "Msymbol/s").error(0.0, "bits differ");
        bench.push(figure.peer("one by one", symbols / host / 1e6, false).runs(runs));
        let key = format!("{name}.receive_many_packet.{}", kernel.name());
        let figure = Figure::new(key, 1e6 * seconds / packets, "µs").error(0.0, "bits differ");
        bench.push(figure.peer("one by one", 1e6 * host / packets, true).runs(runs));
    }
    bench.push(Figure::new(format!("{name}.symbols_per_packet"), symbols / packets, ""));
    Ok(())
}

fn parts(bench: &mut Bench, name: &str, stream: &Stream, runs: usize) -> Result<()> {
    let packets: Vec<&[u8]> = stream.packets().iter().map(Vec::as_slice).filter(|p| p.len() > 8).collect();
    let bytes: usize = packets.iter().map(|p| p.len()).sum();
    let masks: Vec<u8> = (0..1 << 16).map(|i: u32| (i.wrapping_mul(2_654_435_761) >> 27) as u8).collect();
    let passes = (200_000 / packets.len().max(1)).max(1);
    let (mut head, mut parse) = (Vec::new(), Vec::new());
    let mut crcs: [(&str, Crc32, Vec<f64>); 3] =
        [("table", crc32, vec![]), ("host", codec_simd::crc32, vec![]), ("bitwise", bitwise, vec![])];
    let mut closure = Vec::new();
    for packet in &packets {
        for (other, crc, _) in &crcs {
            ensure!(crc(packet) == crc32(packet), "{other}: another CRC");
        }
        let whole = Packet::parse(&packet[..packet.len() - 4])?;
        ensure!(Head::parse(packet)?.id == whole.id(), "a packet's head names another packet");
        if let Packet::Slices(slices) = whole {
            let mut again = vec![0u8; slices.wire_len()];
            slices.write(&mut again)?;
            ensure!(again == *packet, "a packet does not write back to its bytes");
        }
    }
    for &mask in &masks {
        let naive = Level::ALL.into_iter().filter(|&l| naive_usable(|l| Arrived(mask).has(l), l)).count();
        ensure!(Arrived(mask).usable() == naive, "closure of {mask:#06b}");
    }
    for _ in 0..runs {
        let start = thread_seconds();
        for _ in 0..passes {
            for packet in &packets {
                black_box(Head::parse(black_box(&packet[..packet.len() - 4]))?);
            }
        }
        head.push(1e9 * (thread_seconds() - start) / (passes * packets.len()) as f64);
        let start = thread_seconds();
        for _ in 0..passes {
            for packet in &packets {
                black_box(Packet::parse(black_box(&packet[..packet.len() - 4]))?);
            }
        }
        parse.push(1e9 * (thread_seconds() - start) / (passes * packets.len()) as f64);
        for (which, crc, times) in &mut crcs {
            let passes = if *which == "host" { passes } else { passes.div_ceil(40) };
            let start = thread_seconds();
            for _ in 0..passes {
                packets.iter().for_each(|packet| {
                    black_box(crc(black_box(packet)));
                });
            }
            times.push((passes * bytes) as f64 / (thread_seconds() - start) / 1e9);
        }
        let mut updated = masks.clone();
        let start = thread_seconds();
        let mut usable = 0usize;
        for (i, mask) in updated.iter_mut().enumerate() {
            let arrived = Arrived(*mask).with(Level::ALL[i % Level::COUNT]);
            *mask = arrived.0;
            usable += arrived.usable();
        }
        black_box((usable, updated));
        closure.push(1e9 * (thread_seconds() - start) / masks.len() as f64);
    }
    let figure = Figure::new(format!("{name}.packet_head"), median(&head), "ns");
    bench.push(figure.error(0.0, "ids differ from the whole packet's").runs(runs));
    let figure = Figure::new(format!("{name}.packet_parse"), median(&parse), "ns");
    bench.push(figure.error(0.0, "packets write back to other bytes").runs(runs));
    let naive = median(&crcs[2].2);
    for (which, _, speeds) in &crcs[..2] {
        let figure = Figure::new(format!("{name}.crc_{which}"), median(speeds), "GB/s");
        bench.push(figure.error(0.0, "checksums differ").peer("bit by bit", naive, false).runs(runs));
    }
    bench.push(Figure::new(format!("{name}.packet_bytes"), bytes as f64 / packets.len() as f64, "bytes"));
    let figure = Figure::new(format!("{name}.closure_update"), median(&closure), "ns");
    bench.push(figure.error(0.0, "masks differ from the naive closure").runs(runs));
    Ok(())
}
