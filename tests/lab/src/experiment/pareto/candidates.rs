//! Lists the settings to measure: each knob alone, and presets.

use render_host::{Settings, stage::TileSide};

/// Names of the knobs; the place of one is [`Candidate::knob`].
pub const KNOBS: [&str; 9] = [
    "default",
    "alpha cut-off",
    "stop",
    "depth bits",
    "f16 attributes",
    "degree",
    "skips and threads",
    "tile side",
    "presets",
];
/// The place of the defaults.
pub const DEFAULT: usize = 0;

/// Settings with a name.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Short name, a label in a drawing.
    pub name: String,
    /// Place in [`KNOBS`].
    pub knob: usize,
    /// How to render.
    pub settings: Settings,
    /// Measured on every backend, not only on the first.
    pub everywhere: bool,
}

/// All candidates for a scene with harmonics of `degree`.
pub fn candidates(degree: u8) -> Vec<Candidate> {
    let d = Settings::default();
    let one =
        |name: &str, knob, settings| Candidate { name: name.to_owned(), knob, settings, everywhere: false };
    let mut out = vec![Candidate { everywhere: true, ..one("default", DEFAULT, d.clone()) }];
    for (name, alpha_cutoff) in [("cut 0", 0.0), ("cut 1/1024", 1.0 / 1024.0), ("cut 1/64", 1.0 / 64.0)] {
        out.push(one(name, 1, Settings { alpha_cutoff, ..d.clone() }));
    }
    for (name, transmittance_stop) in
        [("stop 0", 0.0), ("stop 1e-6", 1e-6), ("stop 1e-5", 1e-5), ("stop 1e-3", 1e-3)]
    {
        out.push(one(name, 2, Settings { transmittance_stop, ..d.clone() }));
    }
    for depth_bits in [16, 18, 20, 24] {
        out.push(one(&format!("{depth_bits} depth bits"), 3, Settings { depth_bits, ..d.clone() }));
    }
    out.push(one("f16", 4, Settings { half_attributes: true, ..d.clone() }));
    for max_sh_degree in 0..degree {
        out.push(one(&format!("degree {max_sh_degree}"), 5, Settings { max_sh_degree, ..d.clone() }));
    }
    out.push(one("no frustum cull", 6, Settings { cull_frustum: false, ..d.clone() }));
    out.push(one("box tiles", 6, Settings { exact_tiles: false, ..d.clone() }));
    out.push(one("no culling", 6, Settings { cull_frustum: false, exact_tiles: false, ..d.clone() }));
    out.push(one("serial", 6, Settings { parallel: false, ..d.clone() }));
    for tile in TileSide::ALL.into_iter().filter(|&tile| tile != d.tile) {
        out.push(one(&format!("tiles of {}", tile.pixels()), 7, Settings { tile, ..d.clone() }));
    }
    let presets = [
        ("exact", Settings::exact()),
        ("fine", Settings { alpha_cutoff: 1.0 / 1024.0, transmittance_stop: 1e-6, ..d.clone() }),
        ("device", Settings { half_attributes: true, depth_bits: 24, ..d.clone() }),
        ("draft", Settings { alpha_cutoff: 1.0 / 64.0, transmittance_stop: 1e-3, max_sh_degree: 0, ..d }),
    ];
    out.extend(presets.map(|(name, settings)| Candidate { everywhere: true, ..one(name, 8, settings) }));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn candidates_are_valid_and_differ() {
        let all = candidates(3);
        for (i, c) in all.iter().enumerate() {
            c.settings.validate().unwrap();
            assert!(c.knob < KNOBS.len());
            assert!(all[..i].iter().all(|o| o.name != c.name && o.settings != c.settings), "{}", c.name);
        }
        assert_eq!((all[0].settings.clone(), all[0].knob), (Settings::default(), DEFAULT));
        assert_eq!(candidates(0).len() + 3, all.len());
    }
}
