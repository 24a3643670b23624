//! A source is the text of one shader with its list of bindings; a kernel is one entry point of it.

use std::hash::{Hash, Hasher};

/// How a shader sees a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bind {
    /// `var<uniform>`.
    Uniform,
    /// `var<storage, read>`.
    Read,
    /// `var<storage, read_write>`.
    Write,
}

/// A shader. Sources are told apart by name.
#[derive(Clone, Copy, Debug)]
pub struct Source {
    /// Path of its file below `src`, unique.
    pub name: &'static str,
    /// Pieces of its text; `LAYOUT` first.
    pub parts: &'static [&'static str],
    /// Names and kinds of its bindings: place in the list is the number of the binding, group 0.
    pub bindings: &'static [(&'static str, Bind)],
}

impl Source {
    /// The whole text.
    pub fn text(&self) -> String {
        self.parts.concat()
    }
}

/// Structs, constants and functions that every shader begins with.
pub const LAYOUT: &str = include_str!("../stage/layout.wgsl");
/// Functions of kernels that list tiles.
pub const SPAN: &str = include_str!("../stage/span.wgsl");
/// Splats of a tile in workgroup memory; after [`TILE`].
pub const STAGED: &str = include_str!("../stage/staged.wgsl");
/// Functions of kernels in which a workgroup is a tile.
pub const TILE: &str = include_str!("../stage/tile.wgsl");

/// One entry point of a shader with the values of its override constants.
#[derive(Clone, Debug)]
pub struct Kernel {
    pub(super) source: &'static Source,
    pub(super) entry: &'static str,
    pub(super) constants: Vec<(&'static str, u32)>,
}

impl Kernel {
    /// Entry point `entry` of `source`.
    pub fn new(source: &'static Source, entry: &'static str) -> Self {
        Self { source, entry, constants: Vec::new() }
    }

    /// The same with override constant `name` set to `value`.
    #[must_use]
    pub fn with(mut self, name: &'static str, value: u32) -> Self {
        self.constants.push((name, value));
        self
    }

    fn key(&self) -> (&'static str, &'static str, &[(&'static str, u32)]) {
        (self.source.name, self.entry, &self.constants)
    }
}

impl PartialEq for Kernel {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for Kernel {}

impl Hash for Kernel {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.key().hash(state);
    }
}
