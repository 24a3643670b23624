//! What can be checked is refused: null, misaligned, overlapping, short, closed, moved.

use std::{vec, vec::Vec};

use codec_core::{file, internals::wire::crc::crc32};

use super::*;

/// Memory of an alignment that suits every part.
#[derive(Clone, Copy)]
#[repr(C, align(16))]
struct Line([u8; 16]);

fn caps() -> DgsCaps {
    DgsCaps { early_bytes: 40, ..Caps::SMALL.into() }
}

/// A block with an arena of early packets and a little more.
fn block() -> Vec<Line> {
    vec![Line([0xa5; 16]); (HEAD + 512) / 16]
}

fn none() -> DgsError {
    DgsError::argument(-1, "")
}

fn field(error: &DgsError) -> &str {
    // SAFETY: `field` is a constant of `field_len` bytes.
    core::str::from_utf8(unsafe { slice::from_raw_parts(error.field, error.field_len) }).unwrap()
}

fn open(memory: &mut [Line], caps: &DgsCaps) -> Result<*mut DgsPlayer, DgsError> {
    let (mut player, mut error) = (ptr::null_mut(), none());
    let len = size_of_val(memory);
    // SAFETY: pointers from references, the length of the slice.
    let status = unsafe { dgs_open(memory.as_mut_ptr().cast(), len, caps, &mut player, &mut error) };
    if status == DGS_OK { Ok(player) } else { Err(error) }
}

/// A golden stream: its manifest message and its packets.
fn stream() -> (&'static [u8], Vec<&'static [u8]>) {
    let (message, packets) = file::parts(include_bytes!("../../../tests/conformance/one.dgs")).unwrap();
    (message, packets.collect())
}

/// A block that is just enough for [`stream`], and a player in it that waits.
fn exact_block() -> Vec<Line> {
    let (message, _) = stream();
    let mut scratch = vec![Line([0; 16]); 1 << 12];
    let player = open(&mut scratch, &caps()).unwrap();
    let mut bytes = 0;
    // SAFETY: the player is open and its memory lives; pointers from references.
    let status =
        unsafe { dgs_required(player, message.as_ptr(), message.len(), &mut bytes, ptr::null_mut()) };
    assert_eq!((status, bytes % 16), (DGS_OK, 0));
    vec![Line([0xa5; 16]); bytes / 16]
}

#[test]
fn a_player_opens_keeps_early_packets_and_closes() {
    let mut memory = block();
    let packet = stream().1[0];
    let caps = DgsCaps { early_bytes: 2 * (packet.len() as u32 + 2) + 1, ..caps() };
    let player = open(&mut memory, &caps).unwrap();
    let (mut pushed, mut counters, mut error) = (DgsPushed::waiting(), DgsCounters::default(), none());
    // SAFETY: the player is open and its memory lives; pointers from references.
    unsafe {
        assert_eq!(dgs_push(player, packet.as_ptr(), packet.len(), &mut pushed, &mut error), DGS_OK);
        assert_eq!(pushed, DgsPushed::waiting());
        let cut = packet.len() - 1;
        assert_eq!(dgs_push(player, packet.as_ptr(), cut, ptr::null_mut(), &mut error), DGS_CHECKSUM);
        assert_eq!((error.status, field(&error)), (DGS_CHECKSUM, "packet.crc"));
        for _ in 0..3 {
            let _ = dgs_push(player, packet.as_ptr(), packet.len(), ptr::null_mut(), ptr::null_mut());
        }
        assert_eq!(dgs_count(player, &mut counters, ptr::null_mut()), DGS_OK);
        assert_eq!((counters.early, counters.refused), (2, [0, 0, 0, 1, 0, 0, 2]));
        assert_eq!(dgs_manifest(player, packet.as_ptr(), packet.len(), &mut error), DGS_UNKNOWN);
        assert_eq!(field(&error), "manifest.magic");
        let mut stream = DgsStream::default();
        assert_eq!(dgs_describe(player, &mut stream, &mut error), DGS_NO_MANIFEST);
        let mut shown = mem::zeroed();
        assert_eq!(dgs_show(player, 0, &mut shown, &mut error), DGS_NO_MANIFEST);
        let (mut usable, mut written, mut bytes) = (DgsUsable::default(), 0, [0u8; 8]);
        assert_eq!(dgs_count_usable(player, 0, &mut usable, &mut error), DGS_NO_MANIFEST);
        let bytes = bytes.as_mut_ptr();
        let status = dgs_receipt(player, 0, 0, ptr::null(), bytes, 8, &mut written, &mut error);
        assert_eq!(status, DGS_NO_MANIFEST);
        dgs_close(player);
        assert_eq!(dgs_count(player, &mut counters, &mut error), DGS_MISUSE);
        dgs_close(player);
        dgs_close(ptr::null_mut());
    }
}

#[test]
fn a_stream_plays_in_a_block_of_the_size_that_it_requires_and_in_none_shorter() {
    let (message, packets) = stream();
    let mut memory = exact_block();
    let mut error = none();
    let mut short = block();
    let player = open(&mut short, &caps()).unwrap();
    // SAFETY: the players are open and their memory lives; pointers from references and slices.
    unsafe {
        assert_eq!(dgs_manifest(player, message.as_ptr(), message.len(), &mut error), DGS_CAPACITY);
        assert_eq!(field(&error), "arena");
        dgs_close(player);
        let player = open(&mut memory, &caps()).unwrap();
        assert_eq!(dgs_manifest(player, message.as_ptr(), message.len(), &mut error), DGS_OK);
        assert_eq!(dgs_manifest(player, message.as_ptr(), message.len(), &mut error), DGS_DUPLICATE);
        for packet in &packets {
            let mut pushed = DgsPushed::waiting();
            assert_eq!(dgs_push(player, packet.as_ptr(), packet.len(), &mut pushed, &mut error), DGS_OK);
            assert_ne!(pushed.id, DGS_NONE);
        }
        let mut shown: DgsFrame = mem::zeroed();
        assert_eq!(dgs_show(player, 0, &mut shown, &mut error), DGS_OK);
        let gaussians = slice::from_raw_parts(shown.gaussians, shown.gaussians_len);
        assert!(gaussians.iter().any(|gaussian| gaussian.opacity > 0.0));
        assert_eq!(shown.present_blocks, shown.blocks);
        let mut usable = DgsUsable::default();
        assert_eq!(dgs_count_usable(player, 0, &mut usable, &mut error), DGS_OK);
        assert_eq!((usable.blocks, usable.canonical[0]), (shown.blocks, shown.blocks));
        assert_eq!(dgs_show(player, u32::MAX, &mut shown, &mut error), DGS_ILLEGAL);
        assert_eq!(field(&error), "frame");
        let (mut receipt, mut written) = ([0u8; DGS_RECEIPT_BYTES], 0);
        let out = receipt.as_mut_ptr();
        let status = dgs_receipt(player, 1, 5, ptr::null(), out, receipt.len(), &mut written, &mut error);
        assert_eq!(status, DGS_OK);
        assert!(codec_core::internals::wire::receipt::Receipt::parse(&receipt[..written], crc32).is_ok());
        let needed = written;
        for there in [0, 1, needed - 1] {
            let status = dgs_receipt(player, 1, 5, ptr::null(), out, there, &mut written, &mut error);
            assert_eq!((status, field(&error), error.offset), (DGS_CAPACITY, "receipt", 0));
            assert_eq!((error.found, error.least, error.most), (there as u64, needed as u64, needed as u64));
        }
        let pose = DgsPose { position: [0.0, f32::NAN, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] };
        let status = dgs_receipt(player, 1, 5, &pose, out, receipt.len(), &mut written, &mut error);
        assert_eq!((status, field(&error)), (DGS_ILLEGAL, "receipt.pose"));
    }
}

/// A caller that knows nothing but what errors say, and begins with a block that holds neither the packets
/// that come early, nor the manifest, nor the frames.
#[test]
fn memory_that_grows_by_what_errors_say_is_soon_enough() {
    let (message, _) = stream();
    let exact = exact_block().len();
    for plays in [false, true] {
        let (mut lines, mut refusals) = (1, 0);
        loop {
            let mut memory = vec![Line([0xa5; 16]); lines];
            let (mut bytes, mut error) = (0, none());
            let status = match open(&mut memory, &caps()) {
                // SAFETY: the player is open and its memory lives; pointers from references.
                Ok(player) => unsafe {
                    if plays {
                        dgs_manifest(player, message.as_ptr(), message.len(), &mut error)
                    } else {
                        dgs_required(player, message.as_ptr(), message.len(), &mut bytes, &mut error)
                    }
                },
                Err(found) => {
                    error = found;
                    found.status
                }
            };
            if status == DGS_OK {
                break;
            }
            refusals += 1;
            assert_eq!((status, error.status), (DGS_CAPACITY, DGS_CAPACITY), "{}", field(&error));
            assert_eq!((error.found, error.most), (16 * lines as u64, error.least), "{}", field(&error));
            assert!(error.least > error.found && error.least.is_multiple_of(16), "{error:?}");
            lines = (error.least / 16) as usize;
        }
        // The block for early packets, the manifest, the frames; nothing is asked for twice or in vain.
        assert_eq!(refusals, if plays { 3 } else { 2 });
        assert!(lines <= exact, "{lines} lines of {exact}");
    }
}

/// As codec-core does by default.
#[cfg(feature = "paper-context")]
#[test]
fn a_stream_of_the_context_coder_plays() {
    let file = include_bytes!("../../../tests/conformance/made-paper-context.dgs");
    let (message, packets) = file::parts(file).unwrap();
    let mut memory = vec![Line([0; 16]); 1 << 18];
    let mut error = none();
    let player = open(&mut memory, &DgsCaps::from(Caps::SMALL)).unwrap();
    // SAFETY: the player is open and its memory lives; pointers from references and slices.
    unsafe {
        assert_eq!(dgs_manifest(player, message.as_ptr(), message.len(), &mut error), DGS_OK, "{error:?}");
        for packet in packets {
            let status = dgs_push(player, packet.as_ptr(), packet.len(), ptr::null_mut(), &mut error);
            assert_eq!(status, DGS_OK, "{error:?}");
        }
        let mut shown = mem::zeroed();
        assert_eq!(dgs_show(player, 0, &mut shown, &mut error), DGS_OK);
        assert!(shown.gaussians_len > 0);
        dgs_close(player);
    }
}

#[test]
fn a_block_that_is_short_crooked_or_moved_is_refused() {
    let caps = caps();
    let mut memory = block();
    let error = open(&mut memory[..HEAD / 16 + 1], &caps).unwrap_err();
    assert_eq!((error.status, field(&error)), (DGS_CAPACITY, "memory"));
    assert_eq!((error.found, error.most), (HEAD as u64 + 16, HEAD as u64 + 48));
    let (mut player, mut error) = (ptr::null_mut(), none());
    // SAFETY: a byte into the block is still inside; no more than the block is said to be there.
    let crooked = unsafe { memory.as_mut_ptr().cast::<u8>().add(4) };
    // SAFETY: as above, pointers from references.
    let status = unsafe { dgs_open(crooked.cast(), 16, &caps, &mut player, &mut error) };
    assert_eq!((status, field(&error), player.is_null()), (DGS_MISUSE, "memory", true));
    // SAFETY: a reference is a good pointer, null is allowed.
    unsafe {
        let (mut small, mut host) = (DgsCaps::default(), DgsCaps::default());
        dgs_caps_small(&mut small);
        dgs_caps_host(&mut host);
        dgs_caps_host(ptr::null_mut());
        assert_eq!((Caps::from(small), Caps::from(host)), (Caps::SMALL, Caps::HOST));
        let bytes = dgs_memory_bytes(&small);
        assert!(bytes > HEAD && bytes < dgs_memory_bytes(&host));
        assert_eq!(dgs_memory_bytes(ptr::null()), 0);
        if size_of::<usize>() == 4 {
            assert_eq!(dgs_memory_bytes(&DgsCaps { symbols: u32::MAX, ..host }), 0);
        }
    }
    open(&mut memory, &caps).unwrap();
    let mut moved = memory.clone();
    // SAFETY: as large as a player and readable; that it was not opened here is what is tested.
    let status = unsafe { dgs_manifest(moved.as_mut_ptr().cast(), ptr::null(), 0, &mut error) };
    assert_eq!((status, field(&error)), (DGS_MISUSE, "player"));
}

#[test]
fn null_and_crooked_pointers_are_refused() {
    let mut memory = block();
    let player = open(&mut memory, &caps()).unwrap();
    let mut error = none();
    // SAFETY: null and alignment are checked before use; the other pointers are to the open player.
    unsafe {
        assert_eq!(dgs_push(player, ptr::null(), 5, ptr::null_mut(), &mut error), DGS_NULL);
        assert_eq!(field(&error), "packet");
        assert_eq!(dgs_push(player, ptr::null(), 0, ptr::null_mut(), ptr::null_mut()), DGS_ILLEGAL);
        assert_eq!(dgs_manifest(ptr::null_mut(), ptr::null(), 0, &mut error), DGS_NULL);
        assert_eq!(dgs_count(player, ptr::null_mut(), ptr::null_mut()), DGS_NULL);
        assert_eq!(dgs_open(ptr::null_mut(), 0, &caps(), ptr::null_mut(), &mut error), DGS_NULL);
        let mut bytes = 0;
        assert_eq!(dgs_required(player, ptr::null(), 0, ptr::null_mut(), &mut error), DGS_NULL);
        assert_eq!(dgs_required(player, ptr::null(), 0, &mut bytes, &mut error), DGS_SHORT);
        assert_eq!(dgs_digest(7, ptr::null(), 3, ptr::null(), 0), 7);
        // An error that cannot be written is refused before anything is done.
        let crooked = (&raw mut error).cast::<u8>().add(1).cast::<DgsError>();
        error.status = -1;
        assert_eq!(dgs_push(player, ptr::null(), 5, ptr::null_mut(), crooked), DGS_MISUSE);
        assert_eq!(
            dgs_open(memory.as_mut_ptr().cast(), 0, ptr::null(), ptr::null_mut(), crooked),
            DGS_MISUSE
        );
        assert_eq!(error.status, -1);
    }
}

/// Every pointer that a function takes beside its player's, at the block's first and last bytes.
#[test]
fn every_buffer_that_reaches_into_the_block_is_refused() {
    let (message, packets) = stream();
    let mut memory = exact_block();
    let bytes = size_of_val(memory.as_slice());
    let start: *mut u8 = memory.as_mut_ptr().cast();
    let player = open(&mut memory, &caps()).unwrap();
    let mut error = none();
    let named = |call: &dyn Fn(*mut u8, *mut DgsError) -> i32, argument: &str| {
        for at in [0, HEAD, bytes - 64] {
            let mut error = none();
            // SAFETY: inside the block.
            let inside = unsafe { start.add(at) };
            assert_eq!((call(inside, &mut error), field(&error)), (DGS_MISUSE, argument), "at byte {at}");
        }
    };
    // SAFETY: the player is open; pointers into its block are what is refused, the others are good.
    unsafe {
        named(&|p, e| dgs_required(player, message.as_ptr(), message.len(), p.cast(), e), "bytes");
        named(&|p, e| dgs_required(player, p, 5, &mut 0, e), "message");
        named(&|p, e| dgs_manifest(player, p, 5, e), "message");
        assert_eq!(dgs_manifest(player, message.as_ptr(), message.len(), &mut error), DGS_OK);
        named(&|p, e| dgs_push(player, p, 5, ptr::null_mut(), e), "packet");
        named(&|p, e| dgs_push(player, packets[0].as_ptr(), packets[0].len(), p.cast(), e), "pushed");
        named(&|p, e| dgs_count(player, p.cast(), e), "counters");
        named(&|p, e| dgs_describe(player, p.cast(), e), "stream");
        named(&|p, e| dgs_show(player, 0, p.cast(), e), "shown");
        named(&|p, e| dgs_count_usable(player, 0, p.cast(), e), "usable");
        let (mut out, mut written) = ([0u8; DGS_RECEIPT_BYTES], 0usize);
        let (out, len, written) = (out.as_mut_ptr(), out.len(), &raw mut written);
        named(&|p, e| dgs_receipt(player, 0, 0, p.cast(), out, len, written, e), "pose");
        named(&|p, e| dgs_receipt(player, 0, 0, ptr::null(), p, 64, written, e), "out");
        named(&|p, e| dgs_receipt(player, 0, 0, ptr::null(), out, len, p.cast(), e), "written");
        named(&|p, e| dgs_open(start.cast(), bytes, p.cast(), &mut ptr::null_mut(), e), "caps");
        named(&|p, e| dgs_open(start.cast(), bytes, &caps(), p.cast(), e), "player");
        // The error itself: refused, and nothing of the block is written.
        let inside: *mut DgsError = start.add(HEAD).cast();
        let mut counters = DgsCounters::default();
        assert_eq!(dgs_push(player, ptr::null(), 5, ptr::null_mut(), inside), DGS_MISUSE);
        assert_eq!(dgs_open(start.cast(), bytes, ptr::null(), ptr::null_mut(), inside), DGS_MISUSE);
        assert_eq!(dgs_count(player, &mut counters, &mut error), DGS_OK);
        assert_eq!((counters.media, counters.refused), (0, [0; DGS_REFUSALS]));
        // Just outside on either side is fine.
        let mut apart = vec![0u8; 64];
        assert_ne!(dgs_push(player, apart.as_mut_ptr(), 64, ptr::null_mut(), &mut error), DGS_MISUSE);
    }
}

#[test]
fn a_digest_is_that_of_codec_core() {
    let frame = [Gaussian::ABSENT, Gaussian { position: [1.0, 2.0, 3.0], ..Gaussian::ABSENT }];
    let theirs = frame.map(DgsGaussian::from);
    // SAFETY: pointers and lengths of arrays.
    let digest = unsafe { dgs_digest(DGS_DIGEST_START, theirs.as_ptr(), 2, [0.5].as_ptr(), 1) };
    assert_eq!(digest, Digest::new().frame(&frame, &[0.5]).get());
}
