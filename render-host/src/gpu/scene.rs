//! A scene holds Gaussians, their harmonics and their groups on the device.

use super::{Device, GpuError, GrowableBuffer, layout::GAUSSIAN_ROWS};
use crate::{ShDegree, Splats};

/// Gaussians in the order in which the device has them: a row of all Gaussians for each value, and the same
/// of their harmonics after that. It can be made on one thread and uploaded on another.
#[derive(Clone, Copy, Debug)]
pub struct Packed<'p> {
    /// Number of Gaussians.
    pub count: u32,
    /// Degree of their harmonics.
    pub degree: ShDegree,
    /// Whether harmonics are left out, being those of the frame before.
    pub only_moved: bool,
    /// 32-bit floats.
    pub bytes: &'p [u8],
}

impl<'p> Packed<'p> {
    /// Packs `splats` into `values`, which is replaced.
    pub fn of(splats: &Splats<'_>, only_moved: bool, values: &'p mut Vec<f32>) -> Self {
        let (n, degree) = (splats.len(), splats.sh_degree());
        let rows = n * GAUSSIAN_ROWS as usize;
        values.clear();
        values.resize(rows + if only_moved { 0 } else { n * degree.rest_len() }, 0.0);
        let (gaussians, rest) = values.split_at_mut(rows);
        for (i, g) in splats.gaussians().iter().enumerate() {
            spread(bytemuck::cast_slice(std::slice::from_ref(g)), i, n, gaussians);
        }
        if !only_moved {
            (0..n).for_each(|i| spread(splats.rest(i), i, n, rest));
        }
        Self { count: n as u32, degree, only_moved, bytes: bytemuck::cast_slice(values) }
    }

    /// Bytes of the Gaussians themselves.
    fn row_bytes(&self) -> usize {
        4 * self.count as usize * GAUSSIAN_ROWS as usize
    }

    /// Bytes that there must be.
    fn needed(&self) -> usize {
        let rest = if self.only_moved { 0 } else { self.degree.rest_len() };
        self.row_bytes() + 4 * self.count as usize * rest
    }
}

/// A scene that was uploaded once. A frame loop then uploads cameras only.
#[derive(Debug)]
pub struct Scene {
    gaussians: GrowableBuffer,
    harmonics: GrowableBuffer,
    groups: GrowableBuffer,
    count: u32,
    degree: u8,
    group_count: u32,
}

impl Scene {
    /// Uploads Gaussians of one group.
    ///
    /// # Errors
    /// The device has no room.
    pub fn new(device: &Device, splats: &Splats) -> Result<Self, GpuError> {
        Self::with_groups(device, splats, &vec![0; splats.len()])
    }

    /// Uploads Gaussians and the group of each.
    ///
    /// # Errors
    /// The device has no room, or `groups` has another length.
    pub fn with_groups(device: &Device, splats: &Splats, groups: &[u32]) -> Result<Self, GpuError> {
        let mut out = Self {
            gaussians: GrowableBuffer::new("gaussians"),
            harmonics: GrowableBuffer::new("harmonics"),
            groups: GrowableBuffer::new("groups"),
            count: 0,
            degree: 0,
            group_count: 0,
        };
        out.update(device, splats, groups)?;
        Ok(out)
    }

    /// Uploads other Gaussians in place of these, into the same memory where it suffices.
    ///
    /// # Errors
    /// As [`Scene::with_groups`].
    pub fn update(&mut self, device: &Device, splats: &Splats, groups: &[u32]) -> Result<(), GpuError> {
        let n = splats.len();
        if groups.len() != n {
            return Err(GpuError::Length { field: "groups", found: groups.len(), needed: n });
        }
        let mut values = Vec::new();
        self.write(device, &Packed::of(splats, false, &mut values), groups)
    }

    /// Uploads the same Gaussians moved: their harmonics and groups stay. Most of the bytes of a frame are
    /// harmonics, which do not move.
    ///
    /// # Errors
    /// The device has no room, or `splats` are another number of Gaussians.
    pub fn update_moved(&mut self, device: &Device, splats: &Splats) -> Result<(), GpuError> {
        let mut values = Vec::new();
        self.update_packed(device, &Packed::of(splats, true, &mut values))
    }

    /// As [`Scene::update`] of Gaussians of one group, or [`Scene::update_moved`], with what another thread
    /// has packed.
    ///
    /// # Errors
    /// The device has no room; bytes of another length than their number says; Gaussians that moved are
    /// another number than there were.
    pub fn update_packed(&mut self, device: &Device, packed: &Packed<'_>) -> Result<(), GpuError> {
        let (found, needed) = (packed.bytes.len(), packed.needed());
        if found != needed {
            return Err(GpuError::Length { field: "packed bytes", found, needed });
        }
        if !packed.only_moved {
            return self.write(device, packed, &vec![0; packed.count as usize]);
        }
        let (found, needed) = (packed.count as usize, self.count as usize);
        if found != needed {
            return Err(GpuError::Length { field: "moved Gaussians", found, needed });
        }
        self.gaussians.write(device, packed.bytes)?;
        Ok(())
    }

    /// Writes Gaussians, harmonics and groups, whose lengths fit.
    fn write(&mut self, device: &Device, packed: &Packed<'_>, groups: &[u32]) -> Result<(), GpuError> {
        let (rows, rest) = packed.bytes.split_at(packed.row_bytes());
        self.gaussians.write(device, rows)?;
        self.harmonics.reserve(device, 16)?;
        self.harmonics.write(device, rest)?;
        self.groups.write(device, bytemuck::cast_slice(groups))?;
        self.count = packed.count;
        self.degree = packed.degree.get();
        self.group_count = groups.iter().max().map_or(0, |&g| g.saturating_add(1));
        Ok(())
    }

    /// Number of Gaussians.
    pub fn len(&self) -> u32 {
        self.count
    }

    /// True without Gaussians.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Degree of the harmonics.
    pub fn degree(&self) -> u8 {
        self.degree
    }

    /// One more than the largest group; 0 without Gaussians.
    pub fn groups(&self) -> u32 {
        self.group_count
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.gaussians.bytes() + self.harmonics.bytes() + self.groups.bytes()
    }

    /// Gaussians, harmonics, groups.
    pub(super) fn buffers(&self) -> Result<[&wgpu::Buffer; 3], GpuError> {
        Ok([self.gaussians.get()?, self.harmonics.get()?, self.groups.get()?])
    }
}

/// Writes the `values` of Gaussian `at` of `n` to `out`, a row of all Gaussians for each.
fn spread(values: &[f32], at: usize, n: usize, out: &mut [f32]) {
    values.iter().enumerate().for_each(|(row, &v)| out[row * n + at] = v);
}
