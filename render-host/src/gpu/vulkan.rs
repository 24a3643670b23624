//! Reads what wgpu does not show of Vulkan, and makes shaders without run-time checks: the only unsafe code.
#![allow(
    unsafe_code,
    reason = "reading driver facts through raw handles and trusting shaders whose bounds are proven have no \
              safe form"
)]

#[cfg(not(any(target_vendor = "apple", target_family = "wasm")))]
use ash::vk;
#[cfg(not(any(target_vendor = "apple", target_family = "wasm")))]
use wgpu::hal::api::Vulkan;

/// Memory on the device that this process may still take, bytes, summed over its heaps: of
/// `VK_EXT_memory_budget` where the driver has it, else the size of the heaps.
#[cfg(not(any(target_vendor = "apple", target_family = "wasm")))]
pub(super) fn free_memory(device: &wgpu::Device) -> Option<u64> {
    // SAFETY: the guard keeps the device alive, nothing raw outlives it, and no handle is destroyed.
    let hal = unsafe { device.as_hal::<Vulkan>() }?;
    let (physical, instance) = (hal.raw_physical_device(), hal.shared_instance().raw_instance());
    // SAFETY: `physical` belongs to `instance`; both are alive while `hal` is.
    let extensions = unsafe { instance.enumerate_device_extension_properties(physical) }.ok()?;
    let named = |e: &vk::ExtensionProperties| {
        e.extension_name_as_c_str().is_ok_and(|name| name == ash::ext::memory_budget::NAME)
    };
    let has_budget = extensions.iter().any(named);
    let mut budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
    let mut properties = vk::PhysicalDeviceMemoryProperties2::default();
    if has_budget {
        properties = properties.push_next(&mut budget);
    }
    // SAFETY: the structures are initialised and chained only where the extension is there.
    unsafe { instance.get_physical_device_memory_properties2(physical, &mut properties) };
    let heaps = properties.memory_properties;
    let local = |i: &usize| heaps.memory_heaps[*i].flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL);
    let free = |i: usize| {
        if has_budget {
            budget.heap_budget[i].saturating_sub(budget.heap_usage[i])
        } else {
            heaps.memory_heaps[i].size
        }
    };
    Some((0..heaps.memory_heap_count as usize).filter(local).map(free).sum())
}

/// Neither Metal nor a browser says.
#[cfg(any(target_vendor = "apple", target_family = "wasm"))]
pub(super) fn free_memory(_: &wgpu::Device) -> Option<u64> {
    None
}

/// A shader module without run-time bounds checks and loop bounds.
///
/// Every kernel of this crate guards each index by a count that the host or an earlier kernel keeps within
/// the buffer's length, and every loop ends by a count; the tests run the same text with all checks on and
/// compare.
pub(super) fn trusted(device: &wgpu::Device, source: wgpu::ShaderModuleDescriptor) -> wgpu::ShaderModule {
    // SAFETY: see above; only this crate's own WGSL comes here.
    unsafe { device.create_shader_module_trusted(source, wgpu::ShaderRuntimeChecks::unchecked()) }
}
