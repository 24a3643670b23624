//! Chooses the Gaussians that stay: by where they are, or by what they are.

use std::{cmp::Ordering, str::FromStr};

use super::{EditError, edited};
use crate::scene::{
    Attributes, Epoch, Scene, SceneError, Track,
    activation::{SH_C0, sigmoid},
};

/// A box along the axes, both corners included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least x, y, z.
    pub low: [f32; 3],
    /// Greatest x, y, z.
    pub high: [f32; 3],
}

impl FromStr for Bounds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || "x,y,z,X,Y,Z (two corners of a box; - leaves a side open) is allowed".to_owned();
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let [x, y, z, far_x, far_y, far_z] = parts[..] else { return Err(refused()) };
        let side = |text: &str, open: f32| match text {
            "-" => Ok(open),
            text => text.parse::<f32>().ok().filter(|v| !v.is_nan()).ok_or_else(refused),
        };
        let side3 = |[x, y, z]: [&str; 3], open: f32| -> Result<[f32; 3], String> {
            Ok([side(x, open)?, side(y, open)?, side(z, open)?])
        };
        let (low, high) =
            (side3([x, y, z], f32::NEG_INFINITY)?, side3([far_x, far_y, far_z], f32::INFINITY)?);
        if low.iter().zip(&high).any(|(low, high)| low > high) {
            return Err("a first corner that is no greater than the second is allowed".to_owned());
        }
        Ok(Self { low, high })
    }
}

impl Bounds {
    fn hold(&self, position: &[f32; 3]) -> bool {
        (0..3).all(|axis| (self.low[axis]..=self.high[axis]).contains(&position[axis]))
    }
}

/// What a condition is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Property {
    X,
    Y,
    Z,
    /// 0 to 1.
    Opacity,
    /// Of the longest axis, scene units.
    Scale,
    /// Display colour, 0 to 1.
    Red,
    Green,
    Blue,
}

/// Names of properties, as they are typed.
const PROPERTIES: [(&str, Property); 8] = [
    ("x", Property::X),
    ("y", Property::Y),
    ("z", Property::Z),
    ("opacity", Property::Opacity),
    ("scale", Property::Scale),
    ("red", Property::Red),
    ("green", Property::Green),
    ("blue", Property::Blue),
];

/// A property, a comparison and a number: `opacity>0.05`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    property: Property,
    /// The order that a value and `number` must be in; a value may also be equal if `or_equal`.
    order: Ordering,
    or_equal: bool,
    number: f32,
}

impl FromStr for Condition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names: Vec<&str> = PROPERTIES.iter().map(|property| property.0).collect();
        let refused = || format!("PROPERTY<NUMBER (or <=, >, >=) of {} is allowed", names.join(", "));
        let at = text.find(['<', '>']).ok_or_else(refused)?;
        let (name, rest) = text.split_at(at);
        let order = if rest.starts_with('<') { Ordering::Less } else { Ordering::Greater };
        let number = &rest[1..];
        let (or_equal, number) = match number.strip_prefix('=') {
            Some(number) => (true, number),
            None => (false, number),
        };
        let number = number.trim().parse::<f32>().ok().filter(|v| !v.is_nan()).ok_or_else(refused)?;
        let property = PROPERTIES.iter().find(|property| property.0 == name.trim());
        Ok(Self { property: property.ok_or_else(refused)?.1, order, or_equal, number })
    }
}

impl Condition {
    /// Whether Gaussian `i` meets it at frame `t`.
    fn is_met(&self, epoch: &Epoch, t: usize, i: usize) -> bool {
        let (n, a) = (epoch.count(), epoch.attributes());
        let colour = |channel: usize| 0.5 + SH_C0 * a.sh0.frame(t, n)[i][channel];
        let value = match self.property {
            Property::X => a.positions.frame(t, n)[i][0],
            Property::Y => a.positions.frame(t, n)[i][1],
            Property::Z => a.positions.frame(t, n)[i][2],
            Property::Opacity => sigmoid(a.opacity_logits.frame(t, n)[i]),
            Property::Scale => a.log_scales.frame(t, n)[i].into_iter().fold(f32::MIN, f32::max).exp(),
            Property::Red => colour(0),
            Property::Green => colour(1),
            Property::Blue => colour(2),
        };
        let found = value.partial_cmp(&self.number);
        found == Some(self.order) || self.or_equal && found == Some(Ordering::Equal)
    }
}

/// The Gaussians that are inside of `bounds` at any frame.
///
/// # Errors
/// No Gaussian is.
pub fn crop(scene: &Scene, bounds: &Bounds) -> Result<Scene, EditError> {
    selected(scene, "crop", |epoch, t, i| {
        bounds.hold(&epoch.attributes().positions.frame(t, epoch.count())[i])
    })
}

/// The Gaussians that meet `condition` at any frame.
///
/// # Errors
/// No Gaussian does.
pub fn filter(scene: &Scene, condition: &Condition) -> Result<Scene, EditError> {
    selected(scene, "filter", |epoch, t, i| condition.is_met(epoch, t, i))
}

/// Frames of an epoch that differ: the first alone if nothing moves.
fn distinct_frames(epoch: &Epoch) -> std::ops::Range<usize> {
    if epoch.attributes().is_constant() { 0..1 } else { 0..epoch.frames() }
}

/// The Gaussians that `stays` chooses at any frame; epochs may become empty, the whole may not.
fn selected(
    scene: &Scene,
    what: &'static str,
    stays: impl Fn(&Epoch, usize, usize) -> bool,
) -> Result<Scene, EditError> {
    let out = edited(scene, |epoch| {
        let any = |i: usize| distinct_frames(epoch).any(|t| stays(epoch, t, i));
        rows(epoch, &(0..epoch.count()).map(any).collect::<Vec<bool>>())
    })?;
    if out.max_count() == 0 {
        return Err(EditError::Nothing(what));
    }
    Ok(out)
}

/// The rows of an epoch that stay.
fn rows(epoch: &Epoch, stays: &[bool]) -> Result<Epoch, SceneError> {
    fn of<T: Copy>(track: &Track<T>, stays: &[bool]) -> Track<T> {
        let chosen = |values: &[T]| {
            let rows = values.iter().zip(stays.iter().cycle());
            rows.filter_map(|(&value, &stays)| stays.then_some(value)).collect()
        };
        match track {
            Track::Constant(values) => Track::Constant(chosen(values)),
            Track::PerFrame(values) => Track::PerFrame(chosen(values)),
        }
    }
    let a = epoch.attributes();
    let rest = a.sh_degree.rest_len();
    let bands = a.sh_rest.chunks_exact(rest.max(1)).zip(stays);
    let sh_rest = bands.filter(|(_, stays)| **stays).flat_map(|(bands, _)| bands.iter().copied()).collect();
    let attributes = Attributes {
        positions: of(&a.positions, stays),
        rotations: of(&a.rotations, stays),
        log_scales: of(&a.log_scales, stays),
        opacity_logits: of(&a.opacity_logits, stays),
        sh0: of(&a.sh0, stays),
        sh_rest,
        sh_degree: a.sh_degree,
    };
    if stays.contains(&true) {
        return Epoch::new(epoch.frames(), attributes);
    }
    Epoch::new(epoch.frames(), Attributes::of_none(a.sh_degree))
}
