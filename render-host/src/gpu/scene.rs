//! A scene holds Gaussians, their harmonics and their groups on the device.

use super::{Device, GpuError, Growing, layout::GAUSSIAN_ROWS};
use crate::Splats;

/// A scene that was uploaded once. A frame loop then uploads cameras only.
#[derive(Debug)]
pub struct Scene {
    gaussians: Growing,
    harmonics: Growing,
    groups: Growing,
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
            gaussians: Growing::new("gaussians"),
            harmonics: Growing::new("harmonics"),
            groups: Growing::new("groups"),
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
        let mut rest = vec![0.0f32; n * splats.sh_degree().rest_len()];
        (0..n).for_each(|i| spread(splats.rest(i), i, n, &mut rest));
        self.write_gaussians(device, splats)?;
        self.harmonics.reserve(device, 16)?;
        self.harmonics.write(device, bytemuck::cast_slice(&rest))?;
        self.groups.write(device, bytemuck::cast_slice(groups))?;
        self.count = n as u32;
        self.degree = splats.sh_degree().get();
        self.group_count = groups.iter().max().map_or(0, |&g| g.saturating_add(1));
        Ok(())
    }

    /// Uploads the same Gaussians moved: their harmonics and groups stay. Most of the bytes of a frame are
    /// harmonics, which do not move.
    ///
    /// # Errors
    /// The device has no room, or `splats` are another number of Gaussians.
    pub fn update_moved(&mut self, device: &Device, splats: &Splats) -> Result<(), GpuError> {
        let (found, needed) = (splats.len(), self.count as usize);
        if found != needed {
            return Err(GpuError::Length { field: "moved Gaussians", found, needed });
        }
        self.write_gaussians(device, splats)
    }

    fn write_gaussians(&mut self, device: &Device, splats: &Splats) -> Result<(), GpuError> {
        let n = splats.len();
        let mut rows = vec![0.0f32; n * GAUSSIAN_ROWS as usize];
        for (i, g) in splats.gaussians().iter().enumerate() {
            spread(bytemuck::cast_slice(std::slice::from_ref(g)), i, n, &mut rows);
        }
        self.gaussians.write(device, bytemuck::cast_slice(&rows))?;
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
