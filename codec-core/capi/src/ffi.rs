//! Opens the player of codec-core to C: the functions of `include/dgs.h`, and all `unsafe` of this crate.
//!
//! What cannot be checked is the caller's promise, the same for every function:
//!
//! 1. a pointer with a length points to that many readable (`*mut`: writable) elements, and nobody
//!    else writes (`*mut`: reads or writes) them during the call;
//! 2. a pointer to one struct is null, where that is allowed, or points to one;
//! 3. a [`DgsPlayer`] comes from [`dgs_open`], its block is where it was and as the library left
//!    it, and no other call with it is going on.
//!
//! Null, alignment, room and overlap with the block are checked. Memory that the caller need not
//! have initialised is zeroed before a slice of it is made.

#![allow(unsafe_code, reason = "pointers come from C; every block says what it relies on")]
#![allow(clippy::missing_safety_doc, reason = "one list of promises, above, for all functions")]

use core::{ffi::c_void, mem, ptr, slice};

use codec_core::{
    Caps, Error, ErrorKind, Gaussian,
    internals::{
        digest::Digest,
        wire::{manifest, receipt::ViewerPose},
    },
    player::{Player, Waiting},
};

use crate::types::*;

type Checked<T> = Result<T, DgsError>;

/// A player at the front of its block. Opaque to C.
pub struct DgsPlayer {
    /// [`TAG`] and this struct's address: a player that is closed or was moved is found.
    tag: usize,
    /// Bytes of the block.
    len: usize,
    state: State,
}

/// What a player waits for.
#[expect(clippy::large_enum_variant, reason = "it lies in the caller's block; there is no heap to box it on")]
enum State {
    Waiting(Waiting<'static>),
    Playing(Player<'static>),
    /// While a manifest is being taken.
    Between,
}

const TAG: usize = 0x6467_7331;

/// Bytes of a block in front of the arena.
const HEAD: usize = size_of::<DgsPlayer>().next_multiple_of(DGS_ALIGN);

/// Bytes of a block with an arena of `words`; 0 if no address space holds it.
const fn block_bytes(words: usize) -> usize {
    match words.saturating_mul(size_of::<u64>()).checked_add(HEAD + DGS_ALIGN) {
        Some(bytes) if bytes <= isize::MAX as usize => (bytes - DGS_ALIGN).next_multiple_of(DGS_ALIGN),
        _ => 0,
    }
}

fn usable<T>(pointer: *const T, argument: &'static str) -> Checked<()> {
    match () {
        () if pointer.is_null() => Err(DgsError::argument(DGS_NULL, argument)),
        () if !pointer.is_aligned() => Err(DgsError::argument(DGS_MISUSE, argument)),
        () => Ok(()),
    }
}

/// Refuses a buffer of `count` elements that reaches into the `len` bytes at `block`.
fn apart<T>(block: (usize, usize), pointer: *const T, count: usize, argument: &'static str) -> Checked<()> {
    let (start, len) = block;
    let end = pointer.addr().saturating_add(count.saturating_mul(size_of::<T>()));
    let overlaps = count > 0 && pointer.addr() < start.saturating_add(len) && end > start;
    if overlaps { Err(DgsError::argument(DGS_MISUSE, argument)) } else { Ok(()) }
}

/// Runs a call that starts without a player and puts its outcome into the caller's error and the
/// status; `block` is memory that the error must not lie in.
unsafe fn report(block: (usize, usize), error: *mut DgsError, run: impl FnOnce() -> Checked<()>) -> i32 {
    if !error.is_null() && (!error.is_aligned() || apart(block, error, 1, "error").is_err()) {
        return DGS_MISUSE;
    }
    match run() {
        Ok(()) => DGS_OK,
        // SAFETY: null, or aligned and outside the block; promise 2.
        Err(found) => unsafe { explain(error, &found) },
    }
}

/// Puts `found` into the caller's error, unless that is null, and gives the status. Apart from [`report`],
/// which is compiled into every call.
#[cold]
#[inline(never)]
unsafe fn explain(error: *mut DgsError, found: &DgsError) -> i32 {
    if !error.is_null() {
        // SAFETY: not null; the rest as the caller promises.
        unsafe { error.write(*found) };
    }
    found.status
}

/// As [`report`], of a call with a player.
unsafe fn call(
    player: *mut DgsPlayer,
    error: *mut DgsError,
    run: impl FnOnce(&mut DgsPlayer) -> Checked<()>,
) -> i32 {
    // SAFETY: promise 3.
    match unsafe { opened(player) } {
        // SAFETY: promise 2.
        Ok(player) => unsafe { report(player.block(), error, || run(player)) },
        // SAFETY: promise 2.
        Err(found) => unsafe { report((0, 0), error, || Err(found)) },
    }
}

unsafe fn opened<'a>(pointer: *mut DgsPlayer) -> Checked<&'a mut DgsPlayer> {
    usable(pointer, "player")?;
    // SAFETY: not null, aligned; promise 3. The tag is a plain number in initialised memory.
    let tag = unsafe { (&raw const (*pointer).tag).read() };
    if tag != TAG ^ pointer.addr() {
        return Err(DgsError::argument(DGS_MISUSE, "player"));
    }
    // SAFETY: the tag says that `dgs_open` wrote it here; promise 3 that nobody else uses it.
    Ok(unsafe { &mut *pointer })
}

impl DgsPlayer {
    /// Address and bytes of the block.
    fn block(&self) -> (usize, usize) {
        (ptr::from_ref(self).addr(), self.len)
    }

    fn playing(&mut self) -> Checked<&mut Player<'static>> {
        match &mut self.state {
            State::Playing(player) => Ok(player),
            State::Waiting(_) | State::Between => Err(DgsError::argument(DGS_NO_MANIFEST, "manifest")),
        }
    }

    fn waiting(&mut self) -> Checked<&mut Waiting<'static>> {
        match &mut self.state {
            State::Waiting(waiting) => Ok(waiting),
            // There is a manifest, and one is allowed.
            State::Playing(_) | State::Between => {
                Err(Error::illegal("manifest", 0, 2, (1, 1)).kind(ErrorKind::Duplicate).into())
            }
        }
    }

    /// What `error` of reading a manifest is to the caller, who has a block and knows of no arena in it.
    #[cold]
    #[inline(never)]
    fn refused(&self, error: &Error) -> DgsError {
        let mut refused = DgsError::from(*error);
        if error.kind == ErrorKind::Capacity && error.field == "arena" {
            let lacking = refused.least.saturating_sub(refused.found) as usize;
            refused.found = self.len as u64;
            // What no memory holds stays out of reach.
            let least = self.len.saturating_add(lacking).checked_next_multiple_of(DGS_ALIGN);
            refused.least = least.unwrap_or(usize::MAX) as u64;
            refused.most = refused.least;
        }
        refused
    }

    /// A caller's list outside the block; null is an empty one.
    unsafe fn list<'a, T>(&self, pointer: *const T, len: usize, argument: &'static str) -> Checked<&'a [T]> {
        apart(self.block(), pointer, len, argument)?;
        // SAFETY: promise 1.
        unsafe { list(pointer, len, argument) }
    }

    /// Writes `value` where the caller wants it.
    unsafe fn put<T>(&self, pointer: *mut T, value: T, argument: &'static str) -> Checked<()> {
        self.place(pointer, argument)?;
        // SAFETY: not null, aligned, outside the block; promise 2.
        unsafe { pointer.write(value) };
        Ok(())
    }

    /// Refuses a place that is null, crooked or inside the block.
    fn place<T>(&self, pointer: *const T, argument: &'static str) -> Checked<()> {
        usable(pointer, argument)?;
        apart(self.block(), pointer, 1, argument)
    }
}

/// A caller's list; null is an empty one.
unsafe fn list<'a, T>(pointer: *const T, len: usize, argument: &'static str) -> Checked<&'a [T]> {
    if len == 0 {
        return Ok(&[]);
    }
    usable(pointer, argument)?;
    let bytes = len.checked_mul(size_of::<T>()).filter(|&bytes| bytes <= isize::MAX as usize);
    bytes.ok_or(DgsError::argument(DGS_MISUSE, argument))?;
    // SAFETY: not null, aligned, no longer than an address space; promise 1.
    Ok(unsafe { slice::from_raw_parts(pointer, len) })
}

/// The version of DGSM that this library reads.
#[unsafe(no_mangle)]
pub extern "C" fn dgs_version() -> u32 {
    manifest::VERSION.into()
}

/// Fills `caps` with bounds for computers and telephones; a null pointer is left alone. A block that holds
/// every stream within them is under 3 GiB.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_caps_host(caps: *mut DgsCaps) {
    if usable(caps, "caps").is_ok() {
        // SAFETY: not null, aligned; promise 2.
        unsafe { caps.write(Caps::HOST.into()) };
    }
}

/// Fills `caps` with bounds for microcontrollers; a null pointer is left alone. A block that holds every
/// stream within them is under 2.25 MiB.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_caps_small(caps: *mut DgsCaps) {
    if usable(caps, "caps").is_ok() {
        // SAFETY: not null, aligned; promise 2.
        unsafe { caps.write(Caps::SMALL.into()) };
    }
}

/// Bytes of a block that holds every stream within `caps`; 0 if there is no such block or `caps` is
/// null. A smaller block takes the streams that fit: see dgs_required.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_memory_bytes(caps: *const DgsCaps) -> usize {
    if usable(caps, "caps").is_err() {
        return 0;
    }
    // SAFETY: not null, aligned; promise 2.
    block_bytes(Caps::from(unsafe { caps.read() }).arena_words())
}

/// Makes a player that accepts streams within `caps`, and waits for a manifest, in `memory`, which must
/// be aligned to DGS_ALIGN. The block belongs to the player until `dgs_close`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_open(
    memory: *mut c_void,
    memory_len: usize,
    caps: *const DgsCaps,
    player: *mut *mut DgsPlayer,
    error: *mut DgsError,
) -> i32 {
    let block = (memory.addr(), memory_len);
    let run = || {
        usable(memory, "memory")?;
        usable(caps, "caps")?;
        usable(player, "player")?;
        apart(block, caps, 1, "caps")?;
        apart(block, player, 1, "player")?;
        if !memory.addr().is_multiple_of(DGS_ALIGN) || align_of::<DgsPlayer>() > DGS_ALIGN {
            return Err(DgsError::argument(DGS_MISUSE, "memory"));
        }
        // SAFETY: not null, aligned; promise 2.
        let caps = Caps::from(unsafe { caps.read() });
        let words = memory_len.min(isize::MAX as usize).saturating_sub(HEAD) / size_of::<u64>();
        let early = (caps.early_bytes as usize).div_ceil(size_of::<u64>());
        if memory_len < HEAD || words < early {
            let needed = block_bytes(early) as u64;
            let short = DgsError::argument(DGS_CAPACITY, "memory");
            return Err(DgsError { found: memory_len as u64, least: needed, most: needed, ..short });
        }
        let start: *mut u8 = memory.cast();
        // SAFETY: the block is there, aligned, and the player's until `dgs_close` (promises 1 and 3);
        // zeroes are words. The head lies before the arena and is written afterwards.
        let arena: &'static mut [u64] = unsafe {
            ptr::write_bytes(start, 0, HEAD + words * size_of::<u64>());
            slice::from_raw_parts_mut(start.add(HEAD).cast(), words)
        };
        let state = State::Waiting(Waiting::new(arena, caps)?);
        let handle: *mut DgsPlayer = start.cast();
        let tag = TAG ^ handle.addr();
        // SAFETY: the block begins with `HEAD` bytes, aligned for it; `player` is not null, aligned and
        // outside the block (promise 2).
        unsafe {
            handle.write(DgsPlayer { tag, len: HEAD + words * size_of::<u64>(), state });
            player.write(handle);
        }
        Ok(())
    };
    // SAFETY: promise 2.
    unsafe { report(block, error, run) }
}

/// Ends a player; its block is the caller's again. Null and closed players are left alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_close(player: *mut DgsPlayer) {
    // SAFETY: promise 3. Nothing in it needs dropping.
    if let Ok(player) = unsafe { opened(player) } {
        player.tag = 0;
    }
}

/// Writes to `bytes` how large the block of a player must be for the stream of the DGSM message
/// `message`. The player waits for its manifest, and its block is large enough for that alone.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_required(
    player: *mut DgsPlayer,
    message: *const u8,
    message_len: usize,
    bytes: *mut usize,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 1 to 3.
    unsafe {
        call(player, error, |player| {
            player.place(bytes, "bytes")?;
            let message = player.list(message, message_len, "message")?;
            let required = player.waiting()?.required(message).map_err(|error| player.refused(&error))?;
            player.put(bytes, block_bytes(required.words), "bytes")
        })
    }
}

/// Takes the whole DGSM message, then the packets that came early.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_manifest(
    player: *mut DgsPlayer,
    message: *const u8,
    message_len: usize,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 1 to 3.
    unsafe {
        call(player, error, |player| {
            let message = player.list(message, message_len, "message")?;
            player.waiting()?;
            let State::Waiting(waiting) = mem::replace(&mut player.state, State::Between) else {
                return Err(DgsError::argument(DGS_MISUSE, "player"));
            };
            match waiting.manifest(message) {
                Ok(playing) => player.state = State::Playing(playing),
                Err((waiting, refused)) => {
                    player.state = State::Waiting(waiting);
                    return Err(player.refused(&refused));
                }
            }
            Ok(())
        })
    }
}

/// Takes one DGSP packet, in any order; before the manifest it is kept. `pushed` may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_push(
    player: *mut DgsPlayer,
    packet: *const u8,
    packet_len: usize,
    pushed: *mut DgsPushed,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 1 to 3.
    unsafe {
        call(player, error, |player| {
            if !pushed.is_null() {
                player.place(pushed, "pushed")?;
            }
            let packet = player.list(packet, packet_len, "packet")?;
            let found = match &mut player.state {
                State::Playing(playing) => playing.push(packet)?.into(),
                State::Waiting(waiting) => waiting.push(packet).map(|()| DgsPushed::waiting())?,
                State::Between => return Err(DgsError::argument(DGS_NO_MANIFEST, "manifest")),
            };
            if pushed.is_null() { Ok(()) } else { player.put(pushed, found, "pushed") }
        })
    }
}

/// Writes to `counters` what happened to packets so far.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_count(
    player: *mut DgsPlayer,
    counters: *mut DgsCounters,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 2 and 3.
    unsafe {
        call(player, error, |player| {
            let found = match &player.state {
                State::Playing(playing) => *playing.counters(),
                State::Waiting(waiting) => *waiting.counters(),
                State::Between => return Err(DgsError::argument(DGS_NO_MANIFEST, "manifest")),
            };
            player.put(counters, found.into(), "counters")
        })
    }
}

/// Writes to `stream` what the manifest says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_describe(
    player: *mut DgsPlayer,
    stream: *mut DgsStream,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 2 and 3.
    unsafe {
        call(player, error, |player| {
            let found = player.playing()?.info().into();
            player.put(stream, found, "stream")
        })
    }
}

/// Decodes `frame` from what has arrived and writes to `shown` where it lies: in the player's block,
/// until the next call with the player.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_show(
    player: *mut DgsPlayer,
    frame: u32,
    shown: *mut DgsFrame,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 2 and 3.
    unsafe {
        call(player, error, |player| {
            player.place(shown, "shown")?;
            let found = player.playing()?.frame(frame)?.into();
            player.put(shown, found, "shown")
        })
    }
}

/// Writes to `usable` how much of `frame` can be shown.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_count_usable(
    player: *mut DgsPlayer,
    frame: u32,
    usable: *mut DgsUsable,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 2 and 3.
    unsafe {
        call(player, error, |player| {
            let found = player.playing()?.usable(frame)?.into();
            player.put(usable, found, "usable")
        })
    }
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

/// Writes a receipt (DGSF) that acknowledges what arrived or was recovered, the newest 128 ranges
/// of packets of it, to the front of `out` (DGS_RECEIPT_BYTES are enough). `pose` may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn dgs_receipt(
    player: *mut DgsPlayer,
    sequence: u32,
    playout_us: u64,
    pose: *const DgsPose,
    out: *mut u8,
    out_len: usize,
    written: *mut usize,
    error: *mut DgsError,
) -> i32 {
    // SAFETY: promises 1 to 3. No more of `out` is written than the receipt, which fits.
    unsafe {
        call(player, error, |player| {
            player.place(written, "written")?;
            let pose = player.list(pose, usize::from(!pose.is_null()), "pose")?.first().copied();
            usable(out, "out")?;
            apart(player.block(), out, out_len, "out")?;
            let pose = pose.map(|p| ViewerPose { position: p.position, rotation: p.rotation });
            let mut receipt = [0; DGS_RECEIPT_BYTES];
            let len = player.playing()?.receipt(sequence, playout_us, pose, &mut receipt)?;
            if out_len < len {
                return Err(Error::short("receipt", 0, out_len, len).kind(ErrorKind::Capacity).into());
            }
            ptr::copy_nonoverlapping(receipt.as_ptr(), out, len);
            player.put(written, len, "written")
        })
    }
}

#[cfg(test)]
mod tests;
