//! Every stage on the device against its twin on the CPU, fed with the same buffers.

use render_host::{
    Camera, Rendered, Settings,
    gpu::{Device, Renderer, layout::Splat, wgpu},
    reference,
    stage::{TILE, bin, blend, project, sort},
};

use super::{
    renderer,
    support::{Scene, camera},
};

/// Reads a buffer of plain values.
fn values<T: Copy + bytemuck::Pod>(device: &Device, buffer: &wgpu::Buffer, n: usize) -> Vec<T> {
    let bytes = device.read(buffer, (n * size_of::<T>()) as u64).unwrap();
    bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect()
}

/// What the stages left on the device.
struct Found {
    splats: Vec<Splat>,
    order: Vec<u32>,
    keys: Vec<u32>,
    starts: Vec<u32>,
    list: Vec<u32>,
    picture: Rendered,
}

fn find(renderer: &mut Renderer, scene: &Scene, camera: &Camera, settings: &Settings) -> Found {
    let device = renderer.device().clone();
    let picture = renderer.render_splats(&scene.splats(), camera, settings).unwrap();
    let (lists, counters) = (renderer.lists(), picture.counters);
    Found {
        splats: values(&device, lists.splats().unwrap(), scene.gaussians.len()),
        order: values(&device, lists.order().unwrap(), counters.drawn as usize),
        keys: values(&device, lists.depth_keys().unwrap(), counters.drawn as usize),
        starts: values(&device, lists.starts().unwrap(), counters.tiles as usize + 1),
        list: values(&device, lists.entries().unwrap(), counters.intersections as usize),
        picture,
    }
}

fn close_splats(a: &Splat, b: &render_host::stage::Splat) -> bool {
    let largest = b.root.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    // What the anchor leaves of the centre is small, so its error is.
    a.centre().iter().zip(b.mean).all(|(a, b)| (a - b).abs() <= 1e-6 + 1e-6 * b.abs())
        && a.root.iter().zip(b.root).all(|(a, b)| (f64::from(*a) - b).abs() <= 4e-6 * largest)
        && a.colour.iter().zip(b.colour).all(|(a, b)| (a - b).abs() <= 4e-6 * (1.0 + b))
        && (a.log2_alpha - b.log2_alpha).abs() <= 2e-6
        // Never narrower, a pixel wider at most.
        && (a.pixels().iter().zip(b.pixels).enumerate()).all(|(k, (&ours, theirs))| {
            let wider = i64::from(ours) - i64::from(theirs);
            (0..=1).contains(&if k % 2 == 0 { -wider } else { wider })
        })
}

/// Each stage against its CPU twin, fed with what the stage before gave on the device. Returns the stages
/// that differ.
fn stage_faults(scene: &Scene, camera: &Camera, settings: &Settings, found: &Found) -> Vec<&'static str> {
    let mut faults = Vec::new();
    let mut check = |good: bool, fault| {
        if !good {
            faults.push(fault)
        }
    };
    let Found { splats, order, keys, starts, list, picture } = found;

    // Project: the same Gaussians, close to f64.
    let mut cpu = project::Projected::default();
    project::project(&scene.splats(), camera, settings, &mut cpu);
    let visible: Vec<u32> =
        (0..).zip(&cpu.keys).filter(|(_, key)| **key != project::SKIPPED).map(|(i, _)| i).collect();
    let mut drawn = order.clone();
    drawn.sort_unstable();
    check(drawn == visible, "project");
    for (&i, &key) in order.iter().zip(keys) {
        let (i, a) = (i as usize, &splats[i as usize]);
        check(key.abs_diff(cpu.keys[i]) <= 1 && close_splats(a, &cpu.splats[i]), "project");
        // From here on both sides have the device's splats.
        cpu.keys[i] = key;
        cpu.splats[i] = render_host::stage::Splat {
            mean: a.centre(),
            root: a.root.map(f64::from),
            colour: a.colour,
            log2_alpha: a.log2_alpha,
            pixels: a.pixels().map(|v| v as u16),
        };
    }

    // Sort: exact.
    let mut by_depth = sort::Order::default();
    sort::sort(&cpu.keys, false, &mut by_depth);
    check(by_depth.indices().eq(order.iter().copied()), "sort");

    // Bin: all the CPU lists, in the same order; what the device lists besides are slivers.
    let size = [camera.width() as usize, camera.height() as usize];
    let [columns, rows] = size.map(|side| side.div_ceil(TILE));
    let mut bins = bin::Bins::default();
    bin::bin(&cpu, &by_depth, &(0..rows), columns, settings, &mut bins);
    let mut slivers = 0;
    for tile in 0..columns * rows {
        let ours = list.get(starts[tile] as usize..starts[tile + 1] as usize).unwrap_or(&[]);
        let mut theirs = bins.rows()[tile / columns].tile(tile % columns).iter().peekable();
        slivers += ours.iter().filter(|index| theirs.next_if_eq(index).is_none()).count();
        check(theirs.peek().is_none(), "bin");
    }
    check(slivers <= 2 + list.len() / 500, "bin");

    // Blend: one rounding per operation apart.
    let mut tiles = blend::Tiles::default();
    blend::blend(&cpu.splats, &bins, &(0..rows), size, settings, &mut tiles);
    let (mut rgb, mut through) = (vec![0.0; 3 * size[0] * size[1]], vec![0.0; size[0] * size[1]]);
    blend::resolve(&tiles, size[0], settings, &mut rgb, &mut through);
    let close = reference::render(&scene.splats(), camera, settings).unwrap().close;
    let allowed = |i: usize| if close[i] > 0 { 2.0 * settings.alpha_cutoff + 1e-4 } else { 3e-6 };
    let through = picture.transmittance.iter().zip(&through).enumerate();
    check(through.into_iter().all(|(i, (a, b))| (a - b).abs() <= allowed(i)), "blend");
    let rgb = picture.image.rgb().iter().zip(&rgb).enumerate();
    check(rgb.into_iter().all(|(k, (a, b))| (a - b).abs() <= 6.0 * allowed(k / 3)), "blend");
    faults
}

#[test]
fn every_stage_matches_its_cpu_twin() {
    let Some(mut renderer) = renderer() else { return };
    let (plain, camera) = (Settings::default(), camera(130, 90));
    let all = Settings { exact_tiles: false, ..plain.clone() };
    let antialiased = Settings { antialiased: true, ..plain.clone() };
    for (scene, settings) in [
        (Scene::random(3000, 3, 0.005, 0.2, 23), plain),
        (Scene::random(800, 0, 0.02, 0.6, 29), all),
        (Scene::random(900, 1, 0.001, 0.05, 31), antialiased),
    ] {
        let found = find(&mut renderer, &scene, &camera, &settings);
        assert_eq!(stage_faults(&scene, &camera, &settings, &found), [""; 0]);
    }
}

/// Each change spoils one stage, and is found there.
#[test]
fn a_stage_that_differs_is_found() {
    let Some(mut renderer) = renderer() else { return };
    let scene = Scene::random(400, 0, 0.02, 0.2, 43);
    let (camera, settings) = (camera(70, 50), Settings::default());
    type Spoil = fn(&mut Found);
    let spoils: [(Spoil, &str); 7] = [
        (|f| f.splats[f.order[0] as usize].mean[0] += 1e-4, "project"),
        (|f| f.splats[f.order[9] as usize].colour[1] *= 1.001, "project"),
        (|f| f.keys[5] += 9, "project"),
        (|f| [&mut f.order, &mut f.keys].into_iter().for_each(|v| v.swap(10, 11)), "sort"),
        (|f| f.list[f.starts[5] as usize..f.starts[6] as usize].reverse(), "bin"),
        (|f| f.starts[6] -= 1, "bin"),
        (|f| f.picture.transmittance[900] += 1e-3, "blend"),
    ];
    for (spoil, stage) in spoils {
        let mut found = find(&mut renderer, &scene, &camera, &settings);
        assert_eq!(stage_faults(&scene, &camera, &settings, &found), [""; 0]);
        spoil(&mut found);
        let faults = stage_faults(&scene, &camera, &settings, &found);
        assert!(faults.contains(&stage), "{stage}: {faults:?}");
    }
}

#[test]
fn equal_depths_go_by_index() {
    let Some(mut renderer) = renderer() else { return };
    let mut scene = Scene::random(5000, 0, 0.01, 0.03, 37);
    // 50 of each, far apart in the list: within and across the blocks of the sort.
    (0..5000).for_each(|i| scene.gaussians[i].position = scene.gaussians[i % 100].position);
    let (camera, settings) = (camera(64, 64), Settings::default());
    let found = find(&mut renderer, &scene, &camera, &settings);
    assert_eq!(stage_faults(&scene, &camera, &settings, &found), [""; 0]);
}

/// More blocks of keys than one step of the scan takes.
#[test]
fn a_quarter_of_a_million_specks_are_sorted() {
    let Some(mut renderer) = renderer() else { return };
    let mut scene = Scene::random(270_000, 0, 1e-4, 2e-4, 41);
    scene.gaussians.iter_mut().step_by(3).for_each(|g| g.opacity = 0.0);
    let (camera, settings) = (camera(64, 64), Settings::default());
    let got = renderer.render_splats(&scene.splats(), &camera, &settings).unwrap();
    let drawn = got.counters.drawn as usize;
    let order: Vec<u32> = values(renderer.device(), renderer.lists().order().unwrap(), drawn);
    let keys: Vec<u32> = values(renderer.device(), renderer.lists().depth_keys().unwrap(), drawn);
    assert!(drawn > 100_000 && got.counters.absent == 90_000);
    let sorted = |w: (&[u32], &[u32])| w.0[0] < w.0[1] || (w.0[0] == w.0[1] && w.1[0] < w.1[1]);
    assert!(keys.windows(2).zip(order.windows(2)).all(sorted));
}
