use pulp::WithSimd;

use super::*;

fn splats(n: usize) -> Vec<Splat> {
    (0..n)
        .map(|i| {
            let t = i as f64;
            Splat {
                mean: [8.0 + 9.0 * (1.7 * t).sin(), 8.0 + 9.0 * (2.3 * t).cos()],
                root: [0.1 + 0.002 * (t % 200.0), 0.3 * (0.9 * t).sin(), 0.7 - 0.003 * (t % 200.0)],
                colour: [0.3, 0.001 * (i % 200) as f32, 1.5],
                log2_alpha: -0.02 * (i % 200) as f32 - 3.0,
                pixels: [0, 16, 0, 16],
            }
        })
        .collect()
}

fn work<'a>(
    splats: &'a [Splat],
    list: &'a [u32],
    cell: &'a Tile,
    settings: &'a Settings,
    image: &'a [f32],
    found: &'a mut TileGradients,
    scratch: &'a mut Scratch,
) -> Backward<'a> {
    let (corner, size) = ([0, 0], [16, 16]);
    Backward { splats, list, cell, corner, size, settings, image, statistics: false, found, scratch }
}

fn cell(splats: &[Splat], list: &[u32], settings: &Settings) -> Tile {
    let mut tile = Tile::EMPTY;
    blend::blend_tile(splats, list, [0, 0], [16, 16], settings, true, &mut tile);
    tile
}

#[test]
fn totals_are_the_sums_of_each_row() {
    let rows: [Lanes; SUMS] = std::array::from_fn(|k| LANE.map(|i| (0.1 + i).powi(k as i32 - 3)));
    let bits = |v: [f32; SUMS]| v.map(f32::to_bits);
    assert_eq!(bits(totals(&rows)), bits(rows.map(|row| total(&row))));
}

#[test]
fn every_vector_width_gives_the_same_bits() {
    let splats = splats(300);
    let list: Vec<u32> = (0..300).collect();
    let image: Vec<f32> = (0..768).map(|i| (i as f32 * 0.7).sin()).collect();
    let settings = Settings::default();
    let cell = cell(&splats, &list, &settings);
    let (mut a, mut b) = (TileGradients::default(), TileGradients::default());
    work(&splats, &list, &cell, &settings, &image, &mut a, &mut Scratch::default())
        .with_simd(pulp::Scalar::new());
    let mut scratch = Scratch::default();
    pulp::Arch::new().dispatch(work(&splats, &list, &cell, &settings, &image, &mut b, &mut scratch));
    let bits = |f: &TileGradients| f.partials.as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(a.partials[0] != [0.0; PARTS]);
    assert_eq!(bits(&a), bits(&b));
    assert_eq!(a.background, b.background);
}

/// A list of several segments gives each splat what the definition gives: f64, every prefix anew.
#[test]
fn long_lists_are_walked_in_segments() {
    let n = 3 * SEGMENT + 77;
    let mut splats = splats(n);
    splats.iter_mut().for_each(|s| s.log2_alpha -= 4.0);
    let list: Vec<u32> = (0..n as u32).collect();
    let image: Vec<f32> = (0..768).map(|i| (i as f32 * 0.7).sin()).collect();
    let settings = Settings { background: [0.3, 0.6, 0.9], ..Settings::exact() };
    let cell = cell(&splats, &list, &settings);
    let (mut found, mut scratch) = (TileGradients::default(), Scratch::default());
    pulp::Arch::new().dispatch(work(&splats, &list, &cell, &settings, &image, &mut found, &mut scratch));

    let mut exact = vec![[0.0f64; 4]; n];
    for p in 0..256 {
        let g: [f64; 3] = std::array::from_fn(|c| f64::from(image[3 * p + c]));
        let alphas: Vec<f64> = splats
            .iter()
            .map(|s| {
                let (dx, dy) = ((p % 16) as f64 + 0.5 - s.mean[0], (p / 16) as f64 + 0.5 - s.mean[1]);
                let (u, v) = (s.root[0] * dx + s.root[1] * dy, s.root[2] * dy);
                (f64::from(s.log2_alpha) - u * u - v * v).exp2()
            })
            .collect();
        let mut front = vec![1.0; n];
        for k in 1..n {
            front[k] = front[k - 1] * (1.0 - alphas[k - 1]);
        }
        let mut behind = settings.background.map(f64::from);
        for k in (0..n).rev() {
            let colour = splats[k].colour.map(f64::from);
            for c in 0..3 {
                exact[k][0] += std::f64::consts::LN_2 * alphas[k] * front[k] * g[c] * (colour[c] - behind[c]);
                exact[k][1 + c] += alphas[k] * front[k] * g[c];
                behind[c] = alphas[k] * colour[c] + (1.0 - alphas[k]) * behind[c];
            }
        }
    }
    let largest = exact.as_flattened().iter().fold(0.0f64, |a, v| a.max(v.abs()));
    for (exact, partial) in exact.iter().zip(&found.partials) {
        for (e, p) in exact.iter().zip(&partial[5..]) {
            assert!((e - f64::from(*p)).abs() < 1e-4 * largest, "{e} {p}, largest {largest}");
        }
    }
}
