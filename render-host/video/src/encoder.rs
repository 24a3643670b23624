//! An encoder makes AV1 of planes: the same samples on any number of threads.
//!
//! It has no parameters of type, so that its code is made here, where it is optimised.

use rav1e::{
    Config, Context, EncoderConfig, EncoderStatus,
    color::{
        ChromaSamplePosition, ChromaSampling, ColorDescription, ColorPrimaries, MatrixCoefficients,
        PixelRange, TransferCharacteristics,
    },
    data::{FrameType, Rational},
    prelude::Tune,
};

use crate::{error::VideoError, planes::Planes, rate::FrameRate, track::Sample};

/// The base quantiser where no quality is chosen, 0 to 255.
const QUANTIZER: usize = 60;
/// How much the encoder searches, 0 (most) to 10.
const SPEED: u8 = 8;
/// The longest time without a key picture, seconds: players seek to one.
const SECONDS_PER_KEY: f64 = 2.0;
/// Pictures from one key picture to the next: the fewest where the clip changes at once, and the most.
const PICTURES_PER_KEY: (u64, f64) = (12, 240.0);
/// Pixels of a tile; tiles are encoded beside each other.
const TILE_PIXELS: usize = 256 * 256;
/// The most tiles of a picture.
const MAX_TILES: usize = 16;
/// The shortest and longest side of pictures that become a video, pixels: the encoder takes 16 and more, and
/// an odd side gets one more.
const SIDES: (u32, u32) = (15, 65_534);

/// An encoder that has pictures to give back.
pub struct Encoder {
    context: Context<u8>,
}

impl Encoder {
    /// For pictures of `size`, both sides even, at a quality of 1 to 100, if one is chosen.
    pub fn new(size: (usize, usize), rate: FrameRate, quality: Option<u8>) -> Result<Self, VideoError> {
        let mut configuration = configuration(size, rate);
        if let Some(quality) = quality {
            configuration.quantizer = (255 * (100 - usize::from(quality.min(100))) + 50) / 100;
        }
        let config = Config::new().with_encoder_config(configuration);
        let context = config.new_context().map_err(|error| VideoError::Encoder(error.to_string()))?;
        Ok(Self { context })
    }

    /// Takes the next picture; `coded` are those that are done, in the order in which they are shown.
    pub fn add(&mut self, planes: &Planes) -> Result<Vec<Sample>, VideoError> {
        let mut frame = self.context.new_frame();
        let (width, half) = (planes.size.0, planes.size.0 / 2);
        let samples = [(&planes.luma, width), (&planes.blue, half), (&planes.red, half)];
        for (plane, (values, stride)) in frame.planes.iter_mut().zip(samples) {
            plane.copy_from_raw_u8(values, stride, 1);
        }
        self.context.send_frame(frame).map_err(failed)?;
        self.coded()
    }

    /// The pictures that are left, after the last.
    pub fn finish(mut self) -> Result<Vec<Sample>, VideoError> {
        self.context.flush();
        self.coded()
    }

    /// Pictures until the encoder wants more of them, or has given all.
    fn coded(&mut self) -> Result<Vec<Sample>, VideoError> {
        let mut samples = Vec::new();
        loop {
            match self.context.receive_packet() {
                Ok(packet) => {
                    samples.push(Sample { bytes: packet.data, key: packet.frame_type == FrameType::KEY });
                }
                Err(EncoderStatus::Encoded) => {}
                Err(EncoderStatus::NeedMoreData | EncoderStatus::LimitReached) => return Ok(samples),
                Err(other) => return Err(failed(other)),
            }
        }
    }
}

fn failed(status: EncoderStatus) -> VideoError {
    VideoError::Encoder(status.to_string())
}

/// Refuses pictures that the encoder does not take.
pub fn check_size((width, height): (u32, u32)) -> Result<(), VideoError> {
    let (least, most) = SIDES;
    let allowed = least..=most;
    if !allowed.contains(&width) || !allowed.contains(&height) {
        return Err(VideoError::Size { width, height, least, most });
    }
    Ok(())
}

fn configuration((width, height): (usize, usize), rate: FrameRate) -> EncoderConfig {
    let frames_per_second = f64::from(rate.numerator) / f64::from(rate.denominator);
    let (least, most) = PICTURES_PER_KEY;
    let longest = (SECONDS_PER_KEY * frames_per_second).round().clamp(1.0, most) as u64;
    let mut configuration = EncoderConfig::with_speed_preset(SPEED);
    configuration.width = width;
    configuration.height = height;
    configuration.time_base = Rational { num: u64::from(rate.denominator), den: u64::from(rate.numerator) };
    configuration.bit_depth = 8;
    configuration.chroma_sampling = ChromaSampling::Cs420;
    configuration.chroma_sample_position = ChromaSamplePosition::Vertical;
    configuration.pixel_range = PixelRange::Limited;
    configuration.color_description = Some(ColorDescription {
        color_primaries: ColorPrimaries::BT709,
        transfer_characteristics: TransferCharacteristics::BT709,
        matrix_coefficients: MatrixCoefficients::BT709,
    });
    configuration.set_key_frame_interval(longest.min(least), longest);
    configuration.quantizer = QUANTIZER;
    configuration.tune = Tune::Psnr;
    // By the size alone, never by the number of threads: bytes would follow it.
    configuration.tiles = (width * height / TILE_PIXELS).clamp(1, MAX_TILES);
    configuration
}
