//! The functions of `include/dgs.h`, and all `unsafe` of this crate.
//!
//! What cannot be checked is the caller's promise, the same for every function:
//!
//! 1. a pointer with a length points to that many readable (`*mut`: writable) elements, and nobody
//!    else writes (`*mut`: reads or writes) them during the call;
//! 2. a pointer to one struct is null, where that is allowed, or points to one;
//! 3. a [`DgsReceiver`] comes from [`dgs_open`], its block is where it was and as the library left
//!    it, and no other call with it is going on.
//!
//! Null, alignment, room and overlap with the block are checked. Memory that the caller need not
//! have initialised is zeroed before a slice of it is made.

#![allow(unsafe_code, reason = "pointers come from C; every block says what it relies on")]
#![allow(clippy::missing_safety_doc, reason = "one list of promises, above, for all functions")]

use core::{ffi::c_void, ptr, slice};

use codec_core::{
    Caps, Gaussian,
    decode::{self, Decoder},
    digest::Digest,
    ids::{EpochId, PacketId},
    receiver::{self, Arrival, Receiver, Requirements},
    wire::{
        crc::crc32,
        manifest::{self, Manifest, Sealed},
        receipt::{IdRange, Value, ViewerPose},
    },
};

use crate::{block::Places, types::*};

type Outcome<T> = Result<T, DgsError>;

/// A receiver and decoder at the front of its block. Opaque to C.
pub struct DgsReceiver {
    /// [`TAG`] and this struct's address: a receiver that is closed or was moved is found.
    tag: usize,
    /// Bytes of the block.
    len: usize,
    receiver: Receiver<'static>,
    decoder: decode::Memory<'static>,
    epoch: Option<EpochId>,
}

const TAG: usize = 0x6467_7331;

/// Puts an outcome into the caller's error and the status.
unsafe fn report(error: *mut DgsError, outcome: Outcome<()>) -> i32 {
    let Err(found) = outcome else { return DGS_OK };
    if !error.is_null() && error.is_aligned() {
        // SAFETY: not null, aligned; promise 2.
        unsafe { error.write(found) };
    }
    found.status
}

fn usable<T>(pointer: *const T, argument: &'static str) -> Outcome<()> {
    match () {
        () if pointer.is_null() => Err(DgsError::argument(DGS_NULL, argument)),
        () if !pointer.is_aligned() => Err(DgsError::argument(DGS_MISUSE, argument)),
        () => Ok(()),
    }
}

/// A caller's list; null is an empty one.
unsafe fn list<'a, T>(pointer: *const T, len: usize, argument: &'static str) -> Outcome<&'a [T]> {
    if len == 0 {
        return Ok(&[]);
    }
    usable(pointer, argument)?;
    fits::<T>(len, argument)?;
    // SAFETY: not null, aligned, no longer than an address space; promise 1.
    Ok(unsafe { slice::from_raw_parts(pointer, len) })
}

/// A caller's list to write to, zeroed; null is an empty one. Zero is a value of every `T` used
/// here: they are numbers.
unsafe fn target<'a, T>(pointer: *mut T, len: usize, argument: &'static str) -> Outcome<&'a mut [T]> {
    if len == 0 {
        return Ok(&mut []);
    }
    usable(pointer, argument)?;
    fits::<T>(len, argument)?;
    // SAFETY: not null, aligned, no longer than an address space; promise 1. All of it is
    // initialised by the first line.
    unsafe {
        ptr::write_bytes(pointer, 0, len);
        Ok(slice::from_raw_parts_mut(pointer, len))
    }
}

fn fits<T>(len: usize, argument: &'static str) -> Outcome<()> {
    let bytes = len.checked_mul(size_of::<T>()).filter(|&b| b <= isize::MAX as usize);
    bytes.map(|_| ()).ok_or(DgsError::argument(DGS_MISUSE, argument))
}

/// Writes `value` where the caller wants it, if anywhere.
unsafe fn put<T>(pointer: *mut T, value: T, argument: &'static str) -> Outcome<()> {
    if pointer.is_null() {
        return Ok(());
    }
    usable(pointer, argument)?;
    // SAFETY: not null, aligned; promise 2.
    unsafe { pointer.write(value) };
    Ok(())
}

unsafe fn open_receiver<'a>(pointer: *mut DgsReceiver) -> Outcome<&'a mut DgsReceiver> {
    usable(pointer, "receiver")?;
    // SAFETY: not null, aligned; promise 3. The tag is a plain number in initialised memory.
    let tag = unsafe { (&raw const (*pointer).tag).read() };
    if tag != TAG ^ pointer.addr() {
        return Err(DgsError::argument(DGS_MISUSE, "receiver"));
    }
    // SAFETY: the tag says that `dgs_open` wrote it here; promise 3 that nobody else uses it.
    Ok(unsafe { &mut *pointer })
}

impl DgsReceiver {
    /// Refuses a caller's buffer inside the block.
    fn apart<T>(&self, pointer: *const T, len: usize, argument: &'static str) -> Outcome<()> {
        let start = ptr::from_ref(self).addr();
        let end = pointer.addr().saturating_add(len.saturating_mul(size_of::<T>()));
        let overlaps = len > 0 && pointer.addr() < start.saturating_add(self.len) && end > start;
        if overlaps { Err(DgsError::argument(DGS_MISUSE, argument)) } else { Ok(()) }
    }

    fn manifest(&self) -> Outcome<&Manifest<'static>> {
        self.receiver.manifest().ok_or(DgsError::argument(DGS_NO_MANIFEST, "manifest"))
    }
}

/// The version of DGSM that this library reads.
#[unsafe(no_mangle)]
pub extern "C" fn dgs_version() -> u32 {
    manifest::VERSION.into()
}

/// Writes to `bytes` how large the manifest in `message` is unpacked: the scratch memory of
/// `dgs_sizes_of`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_manifest_bytes(
    message: *const u8,
    message_len: usize,
    bytes: *mut usize,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        usable(bytes, "bytes")?;
        // SAFETY: promises 1 and 2.
        unsafe {
            let sealed = Sealed::parse(list(message, message_len, "message")?)?;
            put(bytes, sealed.raw_len, "bytes")
        }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// Writes to `sizes` what the stream of the manifest in `message` needs; `early` is left 0.
/// `scratch` holds the unpacked manifest for the time of the call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_sizes_of(
    message: *const u8,
    message_len: usize,
    scratch: *mut u8,
    scratch_len: usize,
    sizes: *mut DgsSizes,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        usable(sizes, "sizes")?;
        // SAFETY: promise 1.
        let (message, scratch) =
            unsafe { (list(message, message_len, "message")?, target(scratch, scratch_len, "scratch")?) };
        let raw = manifest::open(message, crc32, scratch)?;
        let manifest = Manifest::parse(raw)?;
        let need = Requirements::of(&manifest, &Caps::HOST)?;
        let gaussians = manifest.epochs().map(|e| e.gaussians as usize).max().unwrap_or(0);
        let found = DgsSizes {
            manifest: raw.len(),
            cells: need.cells,
            symbols: need.symbols,
            blocks: need.blocks,
            seen: need.seen,
            slots: need.slots,
            progress: need.progress,
            parity: need.parity,
            early: 0,
            gaussians,
        };
        // SAFETY: promise 2.
        unsafe { put(sizes, found, "sizes") }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// Bytes of the block for a receiver of `sizes`; 0 if there is no such block or `sizes` is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_memory_bytes(sizes: *const DgsSizes) -> usize {
    if usable(sizes, "sizes").is_err() {
        return 0;
    }
    // SAFETY: not null, aligned; promise 2.
    let sizes = unsafe { sizes.read() };
    Places::of(&sizes, size_of::<DgsReceiver>()).map_or(0, |p| p.end)
}

/// Makes a receiver of `sizes` in `memory`, which must be aligned to DGS_ALIGN and at least
/// `dgs_memory_bytes` long. The block belongs to the receiver until `dgs_close`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_open(
    memory: *mut c_void,
    memory_len: usize,
    sizes: *const DgsSizes,
    receiver: *mut *mut DgsReceiver,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        usable(memory, "memory")?;
        usable(sizes, "sizes")?;
        usable(receiver, "receiver")?;
        if !memory.addr().is_multiple_of(DGS_ALIGN) || align_of::<DgsReceiver>() > DGS_ALIGN {
            return Err(DgsError::argument(DGS_MISUSE, "memory"));
        }
        // SAFETY: not null, aligned; promise 2.
        let sizes = unsafe { sizes.read() };
        let places = Places::of(&sizes, size_of::<DgsReceiver>());
        let places = places.ok_or(DgsError::argument(DGS_CAPACITY, "sizes"))?;
        if memory_len < places.end {
            let needed = places.end as u64;
            let short = DgsError::argument(DGS_CAPACITY, "memory");
            return Err(DgsError { found: memory_len as u64, least: needed, most: needed, ..short });
        }
        let block: *mut u8 = memory.cast();
        // SAFETY: promise 1; zeroes make every byte of every part below a value of its type.
        unsafe { ptr::write_bytes(block, 0, places.end) };
        let p = &places;
        // SAFETY: `Places` keeps parts apart, aligned and inside `places.end` bytes, which are
        // there and zeroed; they are the receiver's until `dgs_close` (promise 3).
        let (memory, decoder) = unsafe {
            let memory = receiver::Memory {
                manifest: part(block, p.manifest, sizes.manifest),
                cells: part(block, p.cells, sizes.cells),
                symbols: part(block, p.symbols, sizes.symbols),
                blocks: part(block, p.blocks, sizes.blocks),
                seen: part(block, p.seen, sizes.seen),
                slots: part(block, p.slots, sizes.slots),
                progress: part(block, p.progress, sizes.progress),
                parity: part(block, p.parity, sizes.parity),
                early: part(block, p.early, sizes.early),
            };
            let canonical = part(block, p.canonical, sizes.gaussians);
            (memory, decode::Memory { canonical, known: part(block, p.known, sizes.blocks) })
        };
        let handle: *mut DgsReceiver = block.cast();
        let tag = TAG ^ handle.addr();
        // SAFETY: `Places` starts parts behind the struct; the block is aligned for it. `receiver`
        // is not null and aligned; promise 2.
        unsafe {
            let receiver = Receiver::new(memory);
            handle.write(DgsReceiver { tag, len: places.end, receiver, decoder, epoch: None });
        }
        // SAFETY: promise 2.
        unsafe { put(receiver, handle, "receiver") }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// `count` elements of a block at byte `at`.
unsafe fn part<T>(block: *mut u8, at: usize, count: usize) -> &'static mut [T] {
    // SAFETY: the caller gives a place that is inside the block, aligned, and nobody else's.
    unsafe { slice::from_raw_parts_mut(block.add(at).cast(), count) }
}

/// Ends a receiver; its block is the caller's again. Null and closed receivers are left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_close(receiver: *mut DgsReceiver) {
    // SAFETY: promise 3. Nothing in it needs dropping.
    if let Ok(receiver) = unsafe { open_receiver(receiver) } {
        receiver.tag = 0;
    }
}

/// Takes the whole DGSM message, then the media that waited for it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_control(
    receiver: *mut DgsReceiver,
    message: *const u8,
    message_len: usize,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        // SAFETY: promises 1 and 3.
        let receiver = unsafe { open_receiver(receiver)? };
        receiver.apart(message, message_len, "message")?;
        // SAFETY: promise 1.
        let message = unsafe { list(message, message_len, "message")? };
        Ok(receiver.receiver.control(message)?)
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// Takes one DGSP packet, in any order. `arrival` may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_media(
    receiver: *mut DgsReceiver,
    packet: *const u8,
    packet_len: usize,
    arrival: *mut DgsArrival,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        // SAFETY: promise 3.
        let receiver = unsafe { open_receiver(receiver)? };
        receiver.apart(packet, packet_len, "packet")?;
        // SAFETY: promise 1.
        let packet = unsafe { list(packet, packet_len, "packet")? };
        let found = match receiver.receiver.media(packet)? {
            Arrival::Buffered => DgsArrival::waiting(),
            Arrival::Accepted { id, recovered } => DgsArrival::accepted(id, recovered.as_slice()),
        };
        // SAFETY: promise 2.
        unsafe { put(arrival, found, "arrival") }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// Writes to `counters` what happened to packets so far.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_count(
    receiver: *mut DgsReceiver,
    counters: *mut DgsCounters,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        usable(counters, "counters")?;
        // SAFETY: promises 2 and 3.
        unsafe { put(counters, open_receiver(receiver)?.receiver.counters().into(), "counters") }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// Writes to `stream` what the manifest says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_describe(
    receiver: *mut DgsReceiver,
    stream: *mut DgsStream,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        usable(stream, "stream")?;
        // SAFETY: promise 3.
        let manifest = unsafe { open_receiver(receiver)?.manifest()? };
        let head = manifest.head();
        let found = DgsStream {
            frames: head.frames,
            rate_frames: head.rate_frames,
            rate_seconds: head.rate_seconds,
            packets: head.packets,
            gaussians: manifest.epochs().map(|e| e.gaussians).max().unwrap_or(0),
            sh_rest: manifest.sh_degree().rest_len() as u32,
        };
        // SAFETY: promise 2.
        unsafe { put(stream, found, "stream") }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// Decodes `frame` in the state that has arrived: Gaussians to the front of `out`, higher bands
/// (`dgs_stream.sh_rest` values per Gaussian) to `sh_rest`, which may be null where there are none.
/// `decoded` may be null. What was in `out` and `sh_rest` is lost even if the call fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_frame(
    receiver: *mut DgsReceiver,
    frame: u32,
    out: *mut DgsGaussian,
    out_len: usize,
    sh_rest: *mut f32,
    sh_rest_len: usize,
    decoded: *mut DgsDecoded,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        // SAFETY: promise 3.
        let receiver = unsafe { open_receiver(receiver)? };
        receiver.apart(out, out_len, "out")?;
        receiver.apart(sh_rest, sh_rest_len, "sh_rest")?;
        let manifest = receiver.manifest()?;
        let epoch = manifest.epoch_at(frame).and_then(|id| manifest.epoch(id));
        // No more is touched than the frame takes.
        let gaussians = epoch.map_or(0, |e| e.gaussians as usize);
        let rest = gaussians.saturating_mul(manifest.sh_degree().rest_len());
        // SAFETY: promise 1. `DgsGaussian` and `Gaussian` are the same in memory (asserted where
        // the former is declared).
        let (out, sh_rest) = unsafe {
            let out: &mut [Gaussian] = target(out.cast(), out_len.min(gaussians), "out")?;
            (out, target(sh_rest, sh_rest_len.min(rest), "sh_rest")?)
        };
        let DgsReceiver { receiver, decoder, epoch, .. } = receiver;
        let content = receiver.content().ok_or(DgsError::argument(DGS_NO_MANIFEST, "manifest"))?;
        let memory = decode::Memory { canonical: decoder.canonical, known: decoder.known };
        let mut decoder = Decoder::resume(memory, *epoch);
        let shown = decoder.frame(&content, frame, out, sh_rest);
        *epoch = decoder.epoch();
        // SAFETY: promise 2.
        unsafe { put(decoded, shown?.into(), "decoded") }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

/// FNV-1a, 64 bits, over the bytes of a decoded frame, going on from `state`
/// (DGS_DIGEST_START, or what an earlier call gave). A null list counts as empty.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_digest(
    state: u64,
    gaussians: *const DgsGaussian,
    gaussians_len: usize,
    sh_rest: *const f32,
    sh_rest_len: usize,
) -> u64 {
    // SAFETY: promise 1; the structs are the same in memory.
    let lists = unsafe {
        let gaussians = list::<Gaussian>(gaussians.cast(), gaussians_len, "gaussians");
        gaussians.and_then(|g| Ok((g, list(sh_rest, sh_rest_len, "sh_rest")?)))
    };
    let (gaussians, sh_rest) = lists.unwrap_or_default();
    Digest::resume(state).frame(gaussians, sh_rest).get()
}

/// Writes a receipt (DGSF) that acknowledges what arrived or was recovered, the newest 128 runs
/// of packets of it, to the front of `out` (DGS_RECEIPT_BYTES are enough). `pose` may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_receipt(
    receiver: *mut DgsReceiver,
    sequence: u32,
    playout_us: u64,
    pose: *const DgsPose,
    out: *mut u8,
    out_len: usize,
    written: *mut usize,
    error: *mut DgsError,
) -> i32 {
    let run = || {
        usable(written, "written")?;
        // SAFETY: promise 3.
        let receiver = unsafe { open_receiver(receiver)? };
        receiver.apart(out, out_len, "out")?;
        let packets = receiver.manifest()?.head().packets;
        // SAFETY: promises 1 and 2.
        let (out, pose) = unsafe {
            let pose = if pose.is_null() { None } else { Some(list(pose, 1, "pose")?) };
            (target(out, out_len, "out")?, pose.and_then(<[DgsPose]>::first))
        };
        let mut ranges = [IdRange::default(); 128];
        let mut first = ranges.len();
        for id in (0..packets).rev().filter_map(PacketId::new).filter(|&id| receiver.receiver.has(id)) {
            match ranges.get_mut(first) {
                Some((low, _)) if low.get() == id.get() + 1 => *low = id,
                _ => {
                    let Some(next) = first.checked_sub(1) else { break };
                    first = next;
                    ranges.iter_mut().skip(first).take(1).for_each(|range| *range = (id, id));
                }
            }
        }
        let value = Value {
            sequence,
            playout_us,
            pose: pose.map(|p| ViewerPose { position: p.position, rotation: p.rotation }),
            acknowledged: ranges.get(first..).unwrap_or(&[]),
            recovered: &[],
            completed: &[],
        };
        let len = value.write(out)?;
        // SAFETY: promise 2.
        unsafe { put(written, len, "written") }
    };
    // SAFETY: promise 2.
    unsafe { report(error, run()) }
}

#[cfg(test)]
mod tests;
