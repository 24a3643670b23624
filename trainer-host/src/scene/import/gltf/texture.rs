//! Colours a surface by its base colour: textures decoded within bounds, sampled in linear light.

use std::{collections::BTreeMap, sync::Arc};

use gltf::{material::AlphaMode, texture::WrappingMode};
use render_host::image_file::{Bounds, FileError, Rgba8};

use super::document::{Document, FORMAT};
use crate::scene::import::{Limits, error::ImportError};

/// What a primitive's surface looks like.
pub(super) struct Material {
    factor: [f32; 4],
    texture: Option<Texture>,
    alpha: AlphaMode,
    cutoff: f32,
    /// Which set of texture coordinates.
    pub uv_set: u32,
}

struct Texture {
    image: Arc<Rgba8>,
    wrap: [WrappingMode; 2],
    place: Place,
}

/// Where a texture lies: coordinates are scaled, turned, then moved.
#[derive(Clone, Copy)]
struct Place {
    scale: [f32; 2],
    /// Sine and cosine of the turn.
    turn: (f32, f32),
    offset: [f32; 2],
}

impl Place {
    fn new(info: &::gltf::texture::Info<'_>) -> Self {
        match info.texture_transform() {
            None => Self { scale: [1.0; 2], turn: (0.0, 1.0), offset: [0.0; 2] },
            Some(t) => Self { scale: t.scale(), turn: t.rotation().sin_cos(), offset: t.offset() },
        }
    }

    fn apply(self, uv: [f32; 2]) -> [f32; 2] {
        let [u, v] = [0, 1].map(|i| uv[i] * self.scale[i]);
        let (sin, cos) = self.turn;
        [cos * u - sin * v + self.offset[0], sin * u + cos * v + self.offset[1]]
    }
}

impl Material {
    /// Decodes a material's base colour.
    pub fn new(
        document: &Document,
        material: &::gltf::Material<'_>,
        textures: &mut Textures,
    ) -> Result<Self, ImportError> {
        let base = material.pbr_metallic_roughness();
        let info = base.base_color_texture();
        let texture = match &info {
            None => None,
            Some(info) => {
                let texture = info.texture();
                let image = textures.image(document, &texture.source())?;
                let wrap = [texture.sampler().wrap_s(), texture.sampler().wrap_t()];
                Some(Texture { image, wrap, place: Place::new(info) })
            }
        };
        Ok(Self {
            factor: base.base_color_factor(),
            texture,
            alpha: material.alpha_mode(),
            cutoff: material.alpha_cutoff().unwrap_or(0.5),
            uv_set: info.map_or(0, |info| {
                let moved = info.texture_transform().and_then(|transform| transform.tex_coord());
                moved.unwrap_or_else(|| info.tex_coord())
            }),
        })
    }

    /// Display colour and opacity at `uv` under a vertex colour; `None` where nothing is drawn.
    pub fn colour(&self, uv: [f32; 2], vertex: [f32; 4]) -> Option<[f32; 4]> {
        let texel = self.texture.as_ref().map_or([1.0; 4], |t| t.sample(uv));
        let linear = [0, 1, 2, 3].map(|i| texel[i] * self.factor[i] * vertex[i]);
        let alpha = match self.alpha {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask if linear[3] < self.cutoff => return None,
            AlphaMode::Mask => 1.0,
            AlphaMode::Blend => linear[3].clamp(0.0, 1.0),
        };
        if alpha < 1.0 / 255.0 || linear.iter().any(|v| !v.is_finite()) {
            return None;
        }
        Some([encode(linear[0]), encode(linear[1]), encode(linear[2]), alpha])
    }
}

/// Images decoded so far: each once, however many materials and nodes show it.
pub(super) struct Textures {
    decoded: BTreeMap<usize, Arc<Rgba8>>,
    /// Bytes that further images may take.
    left: u64,
}

impl Textures {
    /// No images yet; all of them together may take `limits.max_bytes`.
    pub fn new(limits: &Limits) -> Self {
        Self { decoded: BTreeMap::new(), left: limits.max_bytes }
    }

    fn image(&mut self, document: &Document, source: &::gltf::Image<'_>) -> Result<Arc<Rgba8>, ImportError> {
        if let Some(image) = self.decoded.get(&source.index()) {
            return Ok(image.clone());
        }
        let field = format!("image {}", source.index());
        let image = decode(document.image_bytes(source)?, self.left)
            .map_err(|e| FORMAT.malformed(field, e, "an undamaged PNG, JPEG or WebP"))?;
        self.left = self.left.saturating_sub(image.data().len() as u64);
        let image = Arc::new(image);
        self.decoded.insert(source.index(), image.clone());
        Ok(image)
    }
}

impl Texture {
    /// Bilinear sample: linear rgb, alpha as stored.
    fn sample(&self, uv: [f32; 2]) -> [f32; 4] {
        let size: [u32; 2] = self.image.size().into();
        let uv = self.place.apply(uv);
        let at = [0, 1].map(|i| uv[i] * size[i] as f32 - 0.5);
        let low = at.map(f32::floor);
        let (fx, fy) = (at[0] - low[0], at[1] - low[1]);
        let mut out = [0.0; 4];
        for (dx, dy, weight) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let x = wrapped((low[0] as i64).saturating_add(dx), size[0], self.wrap[0]);
            let y = wrapped((low[1] as i64).saturating_add(dy), size[1], self.wrap[1]);
            let texel = self.image.pixel(x, y).unwrap_or_default().map(|v| f32::from(v) / 255.0);
            for i in 0..3 {
                out[i] += weight * decode_srgb(texel[i]);
            }
            out[3] += weight * texel[3];
        }
        out
    }
}

/// Decodes an image that may take `most` bytes.
fn decode(bytes: &[u8], most: u64) -> Result<Rgba8, FileError> {
    Rgba8::decode(bytes, Bounds { side: 16_384, bytes: most.min(1 << 30), flat_bytes: 64 << 20 })
}

fn wrapped(texel: i64, size: u32, mode: WrappingMode) -> u32 {
    let size = i64::from(size);
    let inside = match mode {
        WrappingMode::ClampToEdge => texel.clamp(0, size - 1),
        WrappingMode::Repeat => texel.rem_euclid(size),
        WrappingMode::MirroredRepeat => {
            let turn = texel.rem_euclid(2 * size);
            turn.min(2 * size - 1 - turn)
        }
    };
    inside as u32
}

fn decode_srgb(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Display value of linear light, cut to 0..=1.
pub(super) fn encode(v: f32) -> f32 {
    let v = v.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_wrap_as_the_sampler_says() {
        let at = |mode| [-1, 0, 3, 4, 5].map(|t| wrapped(t, 4, mode));
        assert_eq!(at(WrappingMode::Repeat), [3, 0, 3, 0, 1]);
        assert_eq!(at(WrappingMode::ClampToEdge), [0, 0, 3, 3, 3]);
        assert_eq!(at(WrappingMode::MirroredRepeat), [0, 0, 3, 3, 2]);
    }

    #[test]
    fn textures_are_scaled_then_turned_then_moved() {
        let place = Place { scale: [0.5, 2.0], turn: (1.0, 0.0), offset: [0.25, 0.0] };
        assert_eq!(place.apply([1.0, 0.125]), [0.0, 0.5]);
    }

    #[test]
    fn display_colour_survives_linear_light() {
        for v in [0.0, 0.02, 0.2, 0.5, 1.0] {
            assert!((encode(decode_srgb(v)) - v).abs() < 1e-6);
        }
    }
}
