//! Writes AV1 as MP4: the table of samples stands before them, so that a player starts before it has all.
//!
//! ISO/IEC 14496-12 and "AV1 Codec ISO Media File Format Binding".

use std::{
    io::{Seek, SeekFrom, Write},
    num::NonZeroU32,
};

use shiguredo_mp4::{
    BoxSize, BoxType, TrackKind, Uint,
    boxes::{Av01Box, Av1cBox, SampleEntry, UnknownBox, VisualSampleEntryFields},
    mux::{self, Mp4FileMuxer, Mp4FileMuxerOptions, MuxError},
};

use crate::{
    error::VideoError,
    track::{BT709, Sample, Track},
};

/// A file on its way.
pub struct Mp4<W> {
    file: W,
    muxer: Mp4FileMuxer,
    entry: SampleEntry,
    timescale: NonZeroU32,
    duration: u32,
    /// Where the next sample begins.
    position: u64,
}

impl<W: Write + Seek> Mp4<W> {
    pub fn begin(mut file: W, track: &Track) -> Result<Self, VideoError> {
        let reserved_moov_box_size = mux::estimate_maximum_moov_box_size(&[track.pictures]);
        let options = Mp4FileMuxerOptions { reserved_moov_box_size, ..Mp4FileMuxerOptions::default() };
        let muxer = Mp4FileMuxer::with_options(options).map_err(failed)?;
        let head = muxer.initial_boxes_bytes();
        file.write_all(head)?;
        let position = head.len() as u64;
        // A rate is above 0.
        let timescale = NonZeroU32::new(track.rate.numerator).unwrap_or(NonZeroU32::MIN);
        let entry = SampleEntry::Av01(sample_entry(track));
        Ok(Self { file, muxer, entry, timescale, duration: track.rate.denominator, position })
    }

    pub fn add(&mut self, sample: &Sample) -> Result<(), VideoError> {
        self.file.write_all(&sample.bytes)?;
        let sample = mux::Sample {
            track_kind: TrackKind::Video,
            sample_entry: Some(self.entry.clone()),
            keyframe: sample.key,
            timescale: self.timescale,
            duration: self.duration,
            composition_time_offset: None,
            data_offset: self.position,
            data_size: sample.bytes.len(),
        };
        self.muxer.append_sample(&sample).map_err(failed)?;
        self.position += sample.data_size as u64;
        Ok(())
    }

    pub fn finish(mut self) -> Result<W, VideoError> {
        let boxes = self.muxer.finalize().map_err(failed)?;
        for (offset, bytes) in boxes.offset_and_bytes_pairs() {
            self.file.seek(SeekFrom::Start(offset))?;
            self.file.write_all(bytes)?;
        }
        Ok(self.file)
    }
}

fn failed(error: MuxError) -> VideoError {
    VideoError::Mp4(error.to_string())
}

/// What a player needs to know before the first sample.
fn sample_entry(track: &Track) -> Av01Box {
    let configuration = &track.configuration;
    let av1c_box = Av1cBox {
        seq_profile: Uint::new(0),
        seq_level_idx_0: Uint::new(configuration.level),
        seq_tier_0: Uint::new(configuration.tier),
        high_bitdepth: Uint::new(0),
        twelve_bit: Uint::new(0),
        monochrome: Uint::new(0),
        chroma_subsampling_x: Uint::new(1),
        chroma_subsampling_y: Uint::new(1),
        // Vertical: on the left, between two rows.
        chroma_sample_position: Uint::new(1),
        initial_presentation_delay_minus_one: None,
        config_obus: configuration.sequence_header.clone(),
    };
    // Primaries, transfer and matrix, then a bit that is set for the full range.
    let colour = [&b"nclx"[..], &[0, BT709, 0, BT709, 0, BT709, 0]].concat();
    let colour = UnknownBox {
        box_type: BoxType::Normal(*b"colr"),
        box_size: BoxSize::with_payload_size(BoxType::Normal(*b"colr"), colour.len() as u64),
        payload: colour,
    };
    let visual = VisualSampleEntryFields {
        data_reference_index: VisualSampleEntryFields::DEFAULT_DATA_REFERENCE_INDEX,
        width: track.size.0,
        height: track.size.1,
        horizresolution: VisualSampleEntryFields::DEFAULT_HORIZRESOLUTION,
        vertresolution: VisualSampleEntryFields::DEFAULT_VERTRESOLUTION,
        frame_count: VisualSampleEntryFields::DEFAULT_FRAME_COUNT,
        compressorname: VisualSampleEntryFields::NULL_COMPRESSORNAME,
        depth: VisualSampleEntryFields::DEFAULT_DEPTH,
    };
    Av01Box { visual, av1c_box, unknown_boxes: vec![colour] }
}
