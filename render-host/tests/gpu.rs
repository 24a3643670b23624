//! The wgpu backend on whatever adapter there is: judged by the f64 reference, and by the CPU backend stage
//! by stage.
#![cfg(feature = "gpu")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers fail like tests")]

mod support;

use render_host::gpu::{Device, Options, Renderer};
use render_host::{Settings, reference};
use std::sync::OnceLock;
use support::{Scene, camera};

/// The device all tests share, with run-time checks in every shader. Without an adapter a test is skipped
/// with a notice, and fails in CI.
fn device() -> Option<&'static Device> {
    static DEVICE: OnceLock<Option<Device>> = OnceLock::new();
    let device =
        DEVICE.get_or_init(|| match Device::open(&Options { checked: true, ..Options::from_env() }) {
            Ok(device) => Some(device),
            Err(error) => {
                assert!(
                    std::env::var("CI").is_ok_and(|v| v == "true") == false,
                    "CI needs an adapter: {error}"
                );
                eprintln!("SKIPPED: {error}");
                None
            }
        });
    device.as_ref()
}

#[test]
fn a_dense_scene_meets_the_promise() {
    let Some(device) = device() else { return };
    println!("{:?}", device.facts());
    let mut renderer = Renderer::new(device).unwrap();
    let scene = Scene::random(20_000, 1, 0.004, 0.03, 7);
    let camera = camera(320, 240);
    for settings in
        [Settings::default(), Settings::exact(), Settings { antialiased: true, ..Settings::default() }]
    {
        let got = renderer.render_splats(&scene.splats(), &camera, &settings).unwrap();
        let exact = reference::render(&scene.splats(), &camera, &settings).unwrap();
        let cpu = render_host::render(&scene.splats(), &camera, &settings).unwrap();
        println!(
            "{:?}\n{:?}\ngpu {:?}\ncpu {:?}",
            got.counters,
            cpu.counters,
            exact.difference(got.image.rgb()),
            exact.difference(cpu.image.rgb())
        );
    }
}
