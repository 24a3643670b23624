//! Numbers about images: how far one is from another.
//!
//! Every comparison takes the image under test first and the reference second, wants equal sizes (the
//! error names both), is the same for any number of threads, and has a test in which it must fail.

pub mod distortion;
pub mod flicker;
pub mod flip;
pub mod heat;
pub mod lpips;
pub mod psnr;
pub mod ssim;
pub mod where_counted;

pub use distortion::distortion;
pub use flicker::flicker;
pub use flip::flip;
pub use heat::heat;
pub use lpips::{Lpips, LpipsError};
pub use psnr::{mse, psnr};
pub use ssim::ssim;
pub use where_counted::{ssim_where_counted, where_counted};
