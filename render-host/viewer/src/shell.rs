//! The shell gives a page screen, controls and decoder as JavaScript classes: arguments in, numbers out, no
//! logic. The decoder may be another instance of this WebAssembly, in a worker.

mod controls;
mod decoder;

use render_host::{
    Footprint, ShDegree,
    gpu::{Packed, wgpu},
};
use wasm_bindgen::prelude::*;
use web_sys::HtmlCanvasElement;

use crate::{
    ranges::{FIRST_BYTES, message},
    screen::{DrawOptions, Screen},
    session::Overlay,
    shell::controls::Controls,
};

/// A canvas with a device.
#[wasm_bindgen(js_name = Screen)]
pub struct ScreenShell(Screen);

#[wasm_bindgen(js_class = Screen)]
impl ScreenShell {
    /// Opens a device that can draw on `canvas`.
    pub async fn open(canvas: HtmlCanvasElement) -> Result<ScreenShell, JsError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::BROWSER_WEBGPU;
        let instance = wgpu::Instance::new(descriptor);
        let surface = instance.create_surface(wgpu::SurfaceTarget::Canvas(canvas))?;
        Ok(Self(Screen::open(&instance, surface).await?))
    }

    /// Name of the adapter; empty where the browser keeps it to itself.
    #[wasm_bindgen(getter)]
    pub fn adapter(&self) -> String {
        self.0.adapter()
    }

    /// Whether the device is gone: open another screen on the canvas.
    #[wasm_bindgen(getter)]
    pub fn lost(&self) -> bool {
        self.0.is_lost()
    }

    /// Frames that the device has finished.
    #[wasm_bindgen(getter)]
    pub fn finished(&self) -> u32 {
        self.0.finished()
    }

    /// Frames that it still draws.
    #[wasm_bindgen(getter)]
    pub fn pending(&self) -> u32 {
        self.0.pending()
    }

    /// Whether the last picture was not whole: draw again.
    #[wasm_bindgen(getter)]
    pub fn stale(&self) -> bool {
        self.0.must_draw_again()
    }

    /// Bytes on the device.
    #[wasm_bindgen(getter)]
    pub fn bytes(&self) -> f64 {
        self.0.bytes() as f64
    }

    /// Uploads a picture that a decoder has packed: number of Gaussians, degree of their harmonics, whether
    /// these are left out, the bytes; and the number of the footprint that its Gaussians are drawn with.
    pub fn upload(
        &mut self,
        count: u32,
        degree: u8,
        only_moved: bool,
        footprint: u8,
        bytes: &[u8],
    ) -> Result<(), JsError> {
        let degree = ShDegree::new(degree)
            .ok_or_else(|| JsError::new(&format!("degree of harmonics: {degree}, allowed: 0 to 3")))?;
        let footprint = Footprint::numbered(footprint)
            .ok_or_else(|| JsError::new(&format!("footprint: {footprint}, allowed: 0 to 2")))?;
        Ok(self.0.upload_packed(&Packed { count, degree, only_moved, bytes }, footprint)?)
    }

    /// Draws what was uploaded on `width` × `height` pixels.
    pub fn draw(&mut self, controls: &Controls, width: u32, height: u32) -> Result<(), JsError> {
        let size = [width, height];
        let (background, sh_degree) = (controls.background(), controls.reduction().sh_degree);
        let look = DrawOptions { size, shown: size, background, sh_degree };
        Ok(self.0.draw_uploaded(controls.orbit(), &look)?)
    }

    /// Gives the device up, as a browser may at any time: for tests.
    pub fn destroy(&self) {
        self.0.destroy();
    }
}

/// Bytes to ask for first when a file is fetched in pieces.
#[wasm_bindgen(js_name = firstBytes)]
pub fn first_bytes() -> f64 {
    FIRST_BYTES as f64
}

/// Bytes of WebAssembly memory.
#[wasm_bindgen(js_name = memoryBytes)]
pub fn memory_bytes() -> f64 {
    let memory: js_sys::WebAssembly::Memory = wasm_bindgen::memory().unchecked_into();
    let buffer: js_sys::ArrayBuffer = memory.buffer().unchecked_into();
    f64::from(buffer.byte_length())
}

/// Colours that blocks are painted in by the overlay at this place among all, r g b of 0 to 1 each: of
/// levels, proxies, base, refinements; else from the most to the least.
#[wasm_bindgen(js_name = overlayColours)]
pub fn overlay_colours(overlay: u32) -> Vec<f32> {
    let overlay = Overlay::ALL.get(overlay as usize).copied().unwrap_or_default();
    overlay.colours().as_flattened().to_vec()
}

/// How many bytes of a file are needed for its manifest, which begins with `first`; 0 when they are there.
#[wasm_bindgen(js_name = manifestBytes)]
pub fn manifest_bytes(first: &[u8]) -> Result<f64, JsError> {
    Ok(message(first)?.err().map_or(0.0, |needed| needed as f64))
}
