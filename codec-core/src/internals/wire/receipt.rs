//! DGSF, the receipt, holds what the receiver tells the sender (paper section 7.1).
//!
//! Acknowledged packet ranges, packets recovered by repair, groups completed since the last
//! receipt, the playout time, and optionally where the viewer is. One receipt fits one datagram;
//! what does not fit waits for the next. Layout in `SPEC.md`; every list is a view over the bytes.

use core::cell::Cell;

use super::{
    crc::{Crc32, checked, crc32},
    packet::KIND_RECEIPT,
};
use crate::{
    cursor::{Reader, Writer, in_range, varint_len},
    error::{Error, Result},
    ids::{ClusterId, EpochId, Group, Level, PacketId, Span, WindowId},
    limits,
};

/// The viewer's pose: position and unit quaternion wxyz of the camera in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ViewerPose {
    /// Camera centre, scene units.
    pub position: [f32; 3],
    /// Camera to world, wxyz.
    pub rotation: [f32; 4],
}

/// A parsed receipt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receipt<'a> {
    /// Counts receipts, so that old ones are told from new.
    pub sequence: u32,
    /// Playout time, microseconds since the session began.
    pub playout_us: u64,
    /// The viewer's pose, if it changed.
    pub pose: Option<ViewerPose>,
    ranges: (&'a [u8], u32),
    recovered: (&'a [u8], u32),
    completed: (&'a [u8], u32),
}

/// Inclusive range of packet ids.
pub type IdRange = (PacketId, PacketId);

impl<'a> Receipt<'a> {
    /// Parses a whole receipt, CRC included.
    ///
    /// # Errors
    /// Short bytes, a wrong CRC, illegal fields, leftovers.
    pub fn parse(bytes: &'a [u8], crc: Crc32) -> Result<Self> {
        in_range("receipt", 0, bytes.len() as u64, 5, limits::MAX_RECEIPT_BYTES as u64)?;
        let content = checked("receipt.crc", bytes, crc)?;
        let mut reader = Reader::new(content);
        let first = reader.u8("receipt.kind")?;
        in_range("receipt.kind", 0, first, KIND_RECEIPT << 5, KIND_RECEIPT << 5 | 1)?;
        let sequence = reader.varint("receipt.sequence", u32::MAX)?;
        let playout_us = reader.u64("receipt.playout_us")?;
        let pose = if first & 1 == 1 {
            let mut values = [0f32; 7];
            for value in &mut values {
                let place = reader.offset();
                *value = reader.f32("receipt.pose")?;
                in_range("receipt.pose", place, u8::from(value.is_finite()), 1, 1)?;
            }
            let [x, y, z, qw, qx, qy, qz] = values;
            Some(ViewerPose { position: [x, y, z], rotation: [qw, qx, qy, qz] })
        } else {
            None
        };
        let mut list = |count, item: &dyn Fn(&mut Reader<'a>) -> Result<()>| -> Result<(&'a [u8], u32)> {
            let n = reader.varint(count, limits::MAX_RECEIPT_BYTES as u32)?;
            let start = reader.offset();
            for _ in 0..n {
                item(&mut reader)?;
            }
            let end = reader.offset();
            let items = content.get(start..end);
            Ok((items.ok_or(Error::short(count, start, content.len(), end))?, n))
        };
        let end = Cell::new(None);
        let ranges = list("receipt.ranges", &|r| {
            end.set(Some(read_range(r, end.get())?.1));
            Ok(())
        })?;
        let recovered = list("receipt.recovered", &|r| read_recovered(r).map(|_| ()))?;
        let completed = list("receipt.completed", &|r| read_group(r).map(|_| ()))?;
        reader.finish("receipt.leftover")?;
        Ok(Self { sequence, playout_us, pose, ranges, recovered, completed })
    }

    /// Acknowledged packets, ascending; none is an error, since [`Receipt::parse`] has read them all.
    pub fn acknowledged(&self) -> impl Iterator<Item = Result<IdRange>> + use<'a> {
        let mut reader = Reader::new(self.ranges.0);
        let mut end = None;
        (0..self.ranges.1).map(move |_| {
            let range = read_range(&mut reader, end)?;
            end = Some(range.1);
            Ok(range)
        })
    }

    /// Packets recovered by repair; none is an error.
    pub fn recovered(&self) -> impl Iterator<Item = Result<PacketId>> + use<'a> {
        let mut reader = Reader::new(self.recovered.0);
        (0..self.recovered.1).map(move |_| read_recovered(&mut reader))
    }

    /// Groups completed since the last receipt; none is an error.
    pub fn completed(&self) -> impl Iterator<Item = Result<Group>> + use<'a> {
        let mut reader = Reader::new(self.completed.0);
        (0..self.completed.1).map(move |_| read_group(&mut reader))
    }
}

/// What a receipt says, as plain lists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Value<'a> {
    /// Counts receipts.
    pub sequence: u32,
    /// Playout time, microseconds since the session began.
    pub playout_us: u64,
    /// The viewer's pose.
    pub pose: Option<ViewerPose>,
    /// Acknowledged packets, ascending, not touching each other.
    pub acknowledged: &'a [IdRange],
    /// Packets recovered by repair.
    pub recovered: &'a [PacketId],
    /// Completed groups.
    pub completed: &'a [Group],
}

impl Value<'_> {
    /// Writes the receipt, CRC included, to the front of `out`; returns its length. Lists that do
    /// not fit 1200 bytes are cut: newest ranges are kept, then recovered ids, then groups.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Capacity`] if `out` is smaller than the receipt,
    /// [`crate::ErrorKind::Illegal`] if ranges are not ascending or a number of the pose is not finite.
    pub fn write(&self, out: &mut [u8]) -> Result<usize> {
        let (ranges, recovered, completed) = self.fitting();
        let older = self.acknowledged.len().saturating_sub(ranges);
        let mut writer = Writer::new(out);
        writer.bytes(&[KIND_RECEIPT << 5 | u8::from(self.pose.is_some())])?;
        writer.varint(self.sequence)?;
        writer.bytes(&self.playout_us.to_le_bytes())?;
        if let Some(pose) = self.pose {
            for value in pose.position.into_iter().chain(pose.rotation) {
                in_range("receipt.pose", writer.len(), u8::from(value.is_finite()), 1, 1)?;
                writer.bytes(&value.to_le_bytes())?;
            }
        }
        writer.varint(ranges as u32)?;
        let mut end: Option<u32> = None;
        for &(first, last) in self.acknowledged.iter().skip(older) {
            // Before the first range there is no gap.
            let least = end.map_or(0, |e| e + 2);
            let place = writer.len();
            in_range("receipt.range", place, first.get(), least, last.get().max(least))?;
            in_range("receipt.range", place, last.get(), first.get(), PacketId::MAX)?;
            writer.varint(first.get() - least)?;
            writer.varint(last.get() - first.get())?;
            end = Some(last.get());
        }
        writer.varint(recovered as u32)?;
        for id in self.recovered.iter().take(recovered) {
            writer.varint(id.get())?;
        }
        writer.varint(completed as u32)?;
        for group in self.completed.iter().take(completed) {
            let (kind, span) = match group.span {
                Span::Canonical(EpochId(e)) => (0, e),
                Span::Motion(WindowId(w)) => (4, w),
            };
            writer.bytes(&[kind | group.level.get()])?;
            writer.varint(span.into())?;
            writer.varint(group.cluster.0.into())?;
        }
        let crc = crc32(writer.written());
        writer.bytes(&crc.to_le_bytes())?;
        Ok(writer.len())
    }

    /// Bytes that [`Self::write`] writes, if the ranges ascend.
    pub fn wire_len(&self) -> usize {
        let (ranges, recovered, completed) = self.fitting();
        let counts = [ranges, recovered, completed].map(|count| varint_len(count as u32));
        let mut len = 1 + varint_len(self.sequence) + 8 + 4 + counts.iter().sum::<usize>();
        len += if self.pose.is_some() { 28 } else { 0 };
        let mut least = 0;
        for (first, last) in self.acknowledged.iter().skip(self.acknowledged.len().saturating_sub(ranges)) {
            len += varint_len(first.get().saturating_sub(least));
            len += varint_len(last.get().saturating_sub(first.get()));
            least = last.get() + 2;
        }
        len += self.recovered.iter().take(recovered).map(|id| varint_len(id.get())).sum::<usize>();
        for group in self.completed.iter().take(completed) {
            let (Span::Canonical(EpochId(span)) | Span::Motion(WindowId(span))) = group.span;
            len += 1 + varint_len(span.into()) + varint_len(group.cluster.0.into());
        }
        len
    }

    /// How many of each list fit: newest ranges, recovered ids, groups.
    fn fitting(&self) -> (usize, usize, usize) {
        let mut room = limits::MAX_RECEIPT_BYTES - 4 - 9 - 5 - 28 - 6;
        let mut keep = |len: usize| {
            let fits = len <= room;
            room -= if fits { len } else { room };
            fits
        };
        // A range costs at most 4 + 4 bytes whatever came before it.
        let ranges = self.acknowledged.iter().rev().take_while(|_| keep(8)).count();
        let recovered = self.recovered.iter().take_while(|id| keep(varint_len(id.get()))).count();
        let completed = self.completed.iter().take_while(|_| keep(7)).count();
        (ranges, recovered, completed)
    }
}

/// Ranges are coded as the gap after the range before (less the two that separate ranges) and
/// the length less one.
fn read_range(reader: &mut Reader<'_>, end: Option<PacketId>) -> Result<IdRange> {
    let least = end.map_or(0, |e| e.get() + 2);
    let place = reader.offset();
    let gap = reader.varint("receipt.range", PacketId::MAX)?;
    let len = reader.varint("receipt.range", PacketId::MAX)?;
    let (first, last) = (least.saturating_add(gap), least.saturating_add(gap).saturating_add(len));
    in_range("receipt.range", place, last, 0, PacketId::MAX)?;
    let past = Error::illegal("receipt.range", place, last.into(), (0, PacketId::MAX.into()));
    PacketId::new(first).zip(PacketId::new(last)).ok_or(past)
}

fn read_recovered(reader: &mut Reader<'_>) -> Result<PacketId> {
    let place = reader.offset();
    let id = reader.varint("receipt.recovered", PacketId::MAX)?;
    let past = Error::illegal("receipt.recovered", place, id.into(), (0, PacketId::MAX.into()));
    PacketId::new(id).ok_or(past)
}

fn read_group(reader: &mut Reader<'_>) -> Result<Group> {
    let place = reader.offset();
    let kind = in_range("receipt.group", place, reader.u8("receipt.group")?, 0, 7)?;
    let span = reader.varint("receipt.span", u16::MAX.into())? as u16;
    let cluster = ClusterId(reader.varint("receipt.cluster", u16::MAX.into())? as u16);
    let span = if kind & 4 == 0 { Span::Canonical(EpochId(span)) } else { Span::Motion(WindowId(span)) };
    Ok(Group { span, cluster, level: Level::from_bits(kind) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::{vec, vec::Vec};

    proptest! {
        #[test]
        fn receipts_round_trip(
            gaps in proptest::collection::vec((0u32..50, 0u32..50), 0..60), sequence: u32, playout_us: u64,
            recovered in proptest::collection::vec(0u32..1 << 24, 0..20),
            pose in proptest::option::of(-9f32..9.0),
            groups in proptest::collection::vec((any::<bool>(), any::<u16>(), any::<u16>(), 0u8..4), 0..20),
        ) {
            let mut at = 0;
            let ranges: Vec<IdRange> = gaps.iter().map(|&(gap, len)| {
                let first = at + gap;
                at = first + len + 2;
                (PacketId::new(first).unwrap(), PacketId::new(first + len).unwrap())
            }).collect();
            let recovered: Vec<PacketId> = recovered.into_iter().filter_map(PacketId::new).collect();
            let completed: Vec<Group> = groups.into_iter().map(|(m, s, c, l)| Group {
                span: if m { Span::Motion(WindowId(s)) } else { Span::Canonical(EpochId(s)) },
                cluster: ClusterId(c), level: Level::from_bits(l),
            }).collect();
            let pose = pose.map(|v| ViewerPose { position: [v; 3], rotation: [1.0, 0.0, 0.0, 0.0] });
            let value = Value {
                sequence, playout_us, pose,
                acknowledged: &ranges, recovered: &recovered, completed: &completed,
            };
            let mut out = vec![0u8; 1200];
            let len = value.write(&mut out).unwrap();
            prop_assert_eq!(value.wire_len(), len);
            let receipt = Receipt::parse(&out[..len], crc32).unwrap();
            let head = (receipt.sequence, receipt.playout_us, receipt.pose);
            prop_assert_eq!(head, (sequence, playout_us, pose));
            prop_assert_eq!(receipt.acknowledged().collect::<Result<Vec<_>>>(), Ok(ranges));
            prop_assert_eq!(receipt.recovered().collect::<Result<Vec<_>>>(), Ok(recovered));
            prop_assert_eq!(receipt.completed().collect::<Result<Vec<_>>>(), Ok(completed));
        }

        #[test]
        fn any_bytes_parse_or_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut bytes = bytes;
            if let Some(first) = bytes.first_mut() { *first = *first & 1 | 0xe0; }
            // A CRC that always fits: the fuzzer gets behind the door.
            let fits: Crc32 = |_| 0;
            bytes.extend([0; 4]);
            if let Ok(receipt) = Receipt::parse(&bytes, fits) {
                prop_assert!(receipt.acknowledged().all(|range| range.is_ok()));
                prop_assert!(receipt.recovered().all(|id| id.is_ok()));
                prop_assert!(receipt.completed().all(|group| group.is_ok()));
            }
        }
    }

    #[test]
    fn a_pose_that_no_sender_reads_is_not_written() {
        for at in 0..7 {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                let mut pose = ViewerPose { position: [1.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] };
                let mut numbers = pose.position.iter_mut().chain(&mut pose.rotation);
                *numbers.nth(at).unwrap() = bad;
                let value = Value {
                    sequence: 1,
                    playout_us: 0,
                    pose: Some(pose),
                    acknowledged: &[],
                    recovered: &[],
                    completed: &[],
                };
                let error = value.write(&mut [0; 100]).unwrap_err();
                assert_eq!((error.kind, error.field), (crate::ErrorKind::Illegal, "receipt.pose"));
            }
        }
    }

    #[test]
    fn a_long_history_is_cut_to_one_datagram_and_keeps_the_newest() {
        let ranges: Vec<IdRange> = (0..4000)
            .map(|i| (PacketId::new(i * 1000).unwrap(), PacketId::new(i * 1000 + 500).unwrap()))
            .collect();
        let value = Value {
            sequence: 1,
            playout_us: 0,
            pose: None,
            acknowledged: &ranges,
            recovered: &[],
            completed: &[],
        };
        let mut out = vec![0u8; 1200];
        let len = value.write(&mut out).unwrap();
        let receipt = Receipt::parse(&out[..len], crc32).unwrap();
        assert_eq!(receipt.acknowledged().last(), ranges.last().copied().map(Ok));
        assert!(receipt.acknowledged().count() > 100);
    }
}
