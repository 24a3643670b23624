//! Opens a graphics adapter as a device, and says what it is.

use std::sync::{Arc, Mutex};

use super::{GpuError, vulkan};

/// How to choose and open an adapter.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceOptions {
    /// Part of the adapter's name, any case; empty for the best there is: discrete before integrated
    /// before virtual before the CPU.
    pub name: String,
    /// Keeps run-time checks in every shader: for tests.
    pub checked: bool,
}

impl DeviceOptions {
    /// The environment's wish: `DGS_GPU` is part of the adapter's name.
    pub fn from_env() -> Self {
        Self { name: std::env::var("DGS_GPU").unwrap_or_default(), checked: false }
    }
}

/// What an adapter says of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceFacts {
    /// Adapter name.
    pub name: String,
    /// Driver name and version.
    pub driver: String,
    /// Vulkan, Metal, DX12.
    pub api: String,
    /// True for an adapter that is no graphics card: lavapipe, SwiftShader, WARP.
    pub is_cpu: bool,
    /// Largest storage binding, bytes.
    pub max_binding_bytes: u64,
    /// Largest buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Whether stages can be timed on the device.
    pub has_timestamps: bool,
}

/// An open device. Cheap to clone; clones are the same device.
#[derive(Clone, Debug)]
pub struct Device {
    raw: wgpu::Device,
    queue: wgpu::Queue,
    facts: Arc<DeviceFacts>,
    checked: bool,
    /// The first error that no scope caught.
    failed: Arc<Mutex<Option<GpuError>>>,
}

impl Device {
    /// Opens the best adapter that `options` allow.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] without a driver or a match, [`GpuError::Device`] when the driver refuses.
    #[cfg(not(target_family = "wasm"))]
    pub fn open(options: &DeviceOptions) -> Result<Self, GpuError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::PRIMARY;
        // Indirect arguments are written by our own kernels within limits; wgpu need not check them.
        descriptor.flags = if options.checked {
            wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL
        } else {
            wgpu::InstanceFlags::empty()
        };
        let instance = wgpu::Instance::new(descriptor);
        let adapter = pollster::block_on(Self::adapter(&instance, None, options))?;
        pollster::block_on(Self::request(&adapter, options))
    }

    /// The best adapter that `options` allow: of those that can show pictures on `surface`, if there is one.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] without a driver or a match.
    #[cfg(not(target_family = "wasm"))]
    pub async fn adapter(
        instance: &wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
        options: &DeviceOptions,
    ) -> Result<wgpu::Adapter, GpuError> {
        let mut adapters = instance.enumerate_adapters(wgpu::Backends::PRIMARY).await;
        adapters.retain(|adapter| surface.is_none_or(|surface| adapter.is_surface_supported(surface)));
        let found: Vec<String> = adapters.iter().map(|a| a.get_info().name).collect();
        let wanted = options.name.to_lowercase();
        adapters
            .into_iter()
            .filter(|a| a.get_info().name.to_lowercase().contains(&wanted))
            .min_by_key(|a| rank(a.get_info().device_type))
            .ok_or_else(|| GpuError::NoAdapter { wanted: options.name.clone(), found })
    }

    /// Refuses: in a browser adapters come by themselves, and [`Device::request`] opens one.
    ///
    /// # Errors
    /// [`GpuError::Waits`].
    #[cfg(target_family = "wasm")]
    pub fn open(_: &DeviceOptions) -> Result<Self, GpuError> {
        Err(GpuError::Waits { what: "opening a device" })
    }

    /// Opens `adapter`, which the caller chose: in a browser the one that can show pictures on a canvas.
    ///
    /// # Errors
    /// [`GpuError::Device`] when the driver refuses.
    pub async fn request(adapter: &wgpu::Adapter, options: &DeviceOptions) -> Result<Self, GpuError> {
        let (info, most) = (adapter.get_info(), adapter.limits());
        let limits = wgpu::Limits {
            max_storage_buffer_binding_size: most.max_storage_buffer_binding_size,
            max_buffer_size: most.max_buffer_size,
            ..wgpu::Limits::default()
        };
        let (max_binding_bytes, max_buffer_bytes) =
            (limits.max_storage_buffer_binding_size, limits.max_buffer_size);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("dgs"),
            required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
            required_limits: limits,
            ..Default::default()
        };
        let opened = adapter.request_device(&descriptor).await;
        let (raw, queue) =
            opened.map_err(|e| GpuError::Device { adapter: info.name.clone(), message: e.to_string() })?;
        let failed = Arc::new(Mutex::new(None));
        let first = Arc::clone(&failed);
        raw.on_uncaptured_error(Arc::new(move |error| {
            if let Ok(mut slot) = first.lock()
                && slot.is_none()
            {
                *slot = Some(named("frame", &error));
            }
        }));
        let facts = DeviceFacts {
            driver: format!("{} {}", info.driver, info.driver_info),
            api: format!("{:?}", info.backend),
            is_cpu: info.device_type == wgpu::DeviceType::Cpu,
            max_binding_bytes,
            max_buffer_bytes,
            has_timestamps: raw.features().contains(wgpu::Features::TIMESTAMP_QUERY),
            name: info.name,
        };
        Ok(Self { raw, queue, facts: Arc::new(facts), checked: options.checked, failed })
    }

    /// What the adapter says of itself.
    pub fn facts(&self) -> &DeviceFacts {
        &self.facts
    }

    /// Device memory this process may still take, bytes: the driver's budget where it has one, else the
    /// size of the device's heaps; `None` where the API says neither.
    pub fn free_memory_bytes(&self) -> Option<u64> {
        vulkan::free_memory(&self.raw)
    }

    /// The wgpu device.
    pub fn raw(&self) -> &wgpu::Device {
        &self.raw
    }

    /// The wgpu queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Runs `make`, and returns what the device refused meanwhile as an error. In a browser such errors come
    /// later: [`Device::check`] has them.
    ///
    /// # Errors
    /// [`GpuError::OutOfMemory`] or [`GpuError::Refused`], named `what`.
    #[cfg(target_family = "wasm")]
    pub fn guarded<T>(&self, _: &'static str, make: impl FnOnce() -> T) -> Result<T, GpuError> {
        Ok(make())
    }

    /// Runs `make`, and returns what the device refused meanwhile as an error.
    ///
    /// # Errors
    /// [`GpuError::OutOfMemory`] or [`GpuError::Refused`], named `what`.
    #[cfg(not(target_family = "wasm"))]
    pub fn guarded<T>(&self, what: &'static str, make: impl FnOnce() -> T) -> Result<T, GpuError> {
        use wgpu::ErrorFilter::{Internal, OutOfMemory, Validation};
        let scopes = [OutOfMemory, Internal, Validation].map(|filter| self.raw.push_error_scope(filter));
        let made = make();
        let mut first = None;
        // Scopes are a stack: the last one pushed is popped first.
        for scope in scopes.into_iter().rev() {
            first = first.or(pollster::block_on(scope.pop()));
        }
        first.map_or(Ok(made), |error| Err(self.named(what, &error)))
    }

    /// As [`named`], with what is free where that was too little.
    #[cfg(not(target_family = "wasm"))]
    fn named(&self, what: &'static str, error: &wgpu::Error) -> GpuError {
        match named(what, error) {
            GpuError::OutOfMemory { what, message, .. } => {
                GpuError::OutOfMemory { what, free: self.free_memory_bytes(), message }
            }
            other => other,
        }
    }

    /// The first error of the frames so far that no call returned, once.
    ///
    /// # Errors
    /// That error.
    pub fn check(&self) -> Result<(), GpuError> {
        let taken = self.failed.lock().map_or(None, |mut slot| slot.take());
        taken.map_or(Ok(()), Err)
    }

    /// Waits until the device has done all that was submitted.
    ///
    /// # Errors
    /// The device was lost, an error of a frame, or [`GpuError::Waits`] in a browser.
    pub fn wait(&self) -> Result<(), GpuError> {
        if cfg!(target_family = "wasm") {
            return Err(GpuError::Waits { what: "reading back" });
        }
        self.raw
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|e| GpuError::Refused { what: "wait", message: e.to_string() })?;
        self.check()
    }

    /// A shader module: without run-time checks unless [`DeviceOptions::checked`] asks for them.
    pub(super) fn module(&self, label: &str, text: &str) -> wgpu::ShaderModule {
        let source = wgpu::ShaderSource::Wgsl(text.into());
        let descriptor = wgpu::ShaderModuleDescriptor { label: Some(label), source };
        if self.checked {
            self.raw.create_shader_module(descriptor)
        } else {
            vulkan::trusted(&self.raw, descriptor)
        }
    }

    /// `bytes` bytes (a multiple of 4) of `buffer` from the start, once all that was submitted is done.
    ///
    /// # Errors
    /// No memory for the copy, or the device was lost.
    pub fn read(&self, buffer: &wgpu::Buffer, bytes: u64) -> Result<Vec<u8>, GpuError> {
        self.read_all(&[(buffer, bytes)])
    }

    /// As [`Device::read`], of several buffers at once, one after the other.
    pub(super) fn read_all(&self, parts: &[(&wgpu::Buffer, u64)]) -> Result<Vec<u8>, GpuError> {
        let bytes = parts.iter().map(|&(_, bytes)| bytes).sum();
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let landing = self.buffer("read-back", bytes, usage)?;
        let mut encoder = self.raw.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut first = 0;
        for &(buffer, bytes) in parts {
            encoder.copy_buffer_to_buffer(buffer, 0, &landing, first, bytes);
            first += bytes;
        }
        self.queue.submit([encoder.finish()]);
        landing.slice(..).map_async(wgpu::MapMode::Read, |_| ());
        self.wait()?;
        let view = landing
            .slice(..bytes)
            .get_mapped_range()
            .map_err(|e| GpuError::Refused { what: "read-back", message: e.to_string() })?;
        Ok(view.to_vec())
    }

    /// A buffer of at least `bytes` (a multiple of 16), or why not.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] above the device's limits, [`GpuError::OutOfMemory`].
    pub fn buffer(
        &self,
        what: &'static str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<wgpu::Buffer, GpuError> {
        // Room for one of any struct: WebGPU refuses bindings smaller than that.
        let size = bytes.max(64).next_multiple_of(16);
        let storage = usage.contains(wgpu::BufferUsages::STORAGE);
        let allowed =
            if storage { self.facts.max_binding_bytes } else { u64::MAX }.min(self.facts.max_buffer_bytes);
        if size > allowed {
            return Err(GpuError::TooLarge { what, bytes, allowed });
        }
        let descriptor = wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false };
        self.guarded(what, || self.raw.create_buffer(&descriptor))
    }
}

fn named(what: &'static str, error: &wgpu::Error) -> GpuError {
    let message = error.to_string();
    match error {
        wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory { what, free: None, message },
        _ => GpuError::Refused { what, message },
    }
}

/// Which kind of adapter is taken before which.
#[cfg(not(target_family = "wasm"))]
fn rank(kind: wgpu::DeviceType) -> u8 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}
