//! Names the devices that can be chosen.

use clap::ValueEnum;
use render_host::DeviceChoice;

/// What renders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DeviceName {
    /// The processor: the same images on every machine.
    Cpu,
    /// A graphics device, a software driver included; DGS_GPU, part of its name, chooses among several.
    Gpu,
    /// A graphics card where there is one, else the processor.
    Auto,
}

impl From<DeviceName> for DeviceChoice {
    fn from(name: DeviceName) -> Self {
        match name {
            DeviceName::Cpu => Self::Cpu,
            DeviceName::Gpu => Self::Gpu,
            DeviceName::Auto => Self::Auto,
        }
    }
}
