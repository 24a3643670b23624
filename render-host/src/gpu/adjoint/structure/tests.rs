//! The loss alone: same pictures on both sides.

use super::{
    super::super::{
        Executor,
        layout::Frame,
        test_scene::{TestRng, executor},
    },
    *,
};
use crate::adjoint::loss::{Distortion, Loss};

/// Largest difference of a gradient, by its largest value, and of a loss, relative.
const TOLERANCE: f64 = 4e-7;

fn noise(width: u32, height: u32, seed: u64) -> Image {
    let mut r = TestRng(seed);
    Image::new(width, height, (0..3 * width * height).map(|_| r.unit()).collect()).unwrap()
}

/// Losses and gradients of `pictures` by the kernels of `source`.
fn stage(
    executor: &Executor,
    source: &'static Source,
    structure: &Structure,
    target: &Image,
    pictures: &[Image],
) -> (Vec<f64>, Vec<Vec<f32>>) {
    let device = executor.device();
    let size = [target.width(), target.height()];
    let pixels = (size[0] * size[1]) as usize;
    let [columns, rows] = size.map(|side| side.div_ceil(16));
    let worlds = pictures.len() as u32;
    let frame = Frame { size: [size[0], size[1], columns, rows], ..Frame::default() };
    let frame = device.uniform("frame", bytemuck::bytes_of(&frame)).unwrap();
    let batch = Batch { worlds, past: worlds, ..Batch::default() };
    let planes: Vec<f32> = pictures
        .iter()
        .flat_map(|p| (0..3).flat_map(|c| p.rgb()[c..].iter().step_by(3).copied().collect::<Vec<_>>()))
        .collect();
    let wanted = device.filled("wanted", bytemuck::cast_slice(target.rgb())).unwrap();
    let tiles = (columns * rows) as usize;
    let chunks = Chunks::new(device, structure, tiles, batch, 0, CHUNK_BYTES).unwrap();
    assert_eq!(chunks.chunks.len(), 1);
    device.queue().write_buffer(&chunks.framebuffer, 0, bytemuck::cast_slice(&planes));
    let mut recording = Recording::new();
    let buffers = [&frame, &chunks.chunks[0].batch, &wanted];
    chunks.record_loss(source, buffers, [columns, rows, 3 * worlds], &mut recording);
    chunks.totals.record(&mut recording);
    executor.run(recording).unwrap();
    let gradients = device.read_f32(&chunks.framebuffer, planes.len()).unwrap();
    let gradients = gradients
        .chunks_exact(3 * pixels)
        .map(|planes| (0..3 * pixels).map(|i| planes[i % 3 * pixels + i / 3]).collect());
    (chunks.read(device).unwrap(), gradients.collect())
}

/// Worst error of a loss and of a gradient of `worlds` pictures against the twin.
fn error(
    executor: &Executor,
    source: &'static Source,
    [width, height]: [u32; 2],
    worlds: usize,
    wrong: impl Fn(&mut Structure),
) -> f64 {
    let target = noise(width, height, 1);
    let pictures: Vec<Image> = (0..worlds).map(|w| noise(width, height, 2 + w as u64)).collect();
    let mix = Mix::weighted(0.7);
    let mut structure = Structure::new(executor.device(), &target, mix).unwrap();
    wrong(&mut structure);
    let (losses, gradients) = stage(executor, source, &structure, &target, &pictures);
    assert_eq!((losses.len(), gradients.len()), (worlds, worlds));
    let twin = Distortion::weighted(target, mix.structure);
    let mut most = 0.0f64;
    let mut see = |e: f64| most = if e.is_nan() { f64::INFINITY } else { most.max(e) };
    for ((picture, loss), got) in pictures.iter().zip(losses).zip(gradients) {
        let mut expected = vec![f32::NAN; got.len()];
        let value = twin.differentiate(picture, false, &mut expected).unwrap();
        see((loss / value - 1.0).abs());
        let largest = expected.iter().fold(0.0f32, |m, g| m.max(g.abs()));
        got.iter().zip(&expected).for_each(|(a, b)| see(f64::from((a - b).abs() / largest)));
    }
    most
}

#[test]
fn losses_and_pixel_gradients_are_those_of_the_cpu() {
    let Some(executor) = executor() else { return };
    for (size, worlds) in [
        ([75, 53], 1),
        ([75, 53], 5),
        ([16, 16], 2),
        ([33, 40], 4),
        ([11, 11], 1),
        ([12, 5], 3),
        ([4, 30], 1),
        ([1, 1], 2),
    ] {
        let error = error(executor, &STRUCTURE, size, worlds, |_| ());
        println!("{size:?}, {worlds} worlds: {error:.1e}");
        assert!(error < TOLERANCE, "{size:?}, {worlds} worlds: {error}");
    }
}

/// Each is wrong in one thing, and is found to be.
#[test]
fn a_wrong_window_or_constant_is_seen() {
    let Some(executor) = executor() else { return };
    for (here, there) in [
        ("const C1: f32 = 1e-4;", "const C1: f32 = 2e-4;"),
        ("const C2: f32 = 9e-4;", "const C2: f32 = 1e-3;"),
        ("const MIDDLE: u32 = 5u;", "const MIDDLE: u32 = 4u;"),
        ("window.down[k / 4u]", "window.along[k / 4u]"),
        ("pixel < window.centres.yw", "pixel <= window.centres.yw"),
        ("(y - 0.5) * filter_down", "y * filter_down"),
    ] {
        let text: &'static str = STRUCTURE.text().replace(here, there).leak();
        assert_ne!(text, STRUCTURE.text(), "{here} is in the text");
        let parts: &'static [&'static str] = vec![text].leak();
        let wrong: &'static Source = Box::leak(Box::new(Source { name: there, parts, ..STRUCTURE }));
        // Below the window along one side: weights along and down differ.
        let error = error(executor, wrong, [31, 8], 2, |_| ());
        assert!(error > 10.0 * TOLERANCE, "{there} went unseen: {error}");
    }
    let error = error(executor, &STRUCTURE, [31, 24], 1, |structure| {
        let weights = [0.27f32, 0.22, 0.11, 0.03, 0.004, 0.001, 0.0, 0.0];
        executor.device().queue().write_buffer(&structure.window, 0, bytemuck::cast_slice(&weights));
    });
    assert!(error > 10.0 * TOLERANCE, "a wrong weight went unseen: {error}");
}

#[test]
fn as_many_worlds_go_together_as_fit() {
    let bytes = CHUNK_BYTES;
    assert_eq!(together(32, bytes, 800 * 800, 0), 1);
    assert_eq!(together(32, bytes, 400 * 400, 0), 5);
    assert_eq!(together(3, bytes, 400 * 400, 0), 3);
    assert_eq!(together(32, bytes, 400 * 400, bytes / 2), 2);
    assert_eq!(together(32, bytes, 10_000 * 10_000, 0), 1, "four worlds at least");
    assert_eq!(together(1 << 20, bytes, 1, 0), MAX_QUADS);
    assert_eq!(together(0, bytes, 0, 0), 1);
}
