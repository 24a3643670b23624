//! What can be checked is refused: null, misaligned, overlapping, short, closed, moved.

use std::{vec, vec::Vec};

use super::*;

/// Memory of an alignment that suits every part.
#[derive(Clone, Copy)]
#[repr(C, align(16))]
struct Line([u8; 16]);

fn sizes() -> DgsSizes {
    DgsSizes { manifest: 64, cells: 1, early: 40, gaussians: 2, ..DgsSizes::default() }
}

fn block(sizes: &DgsSizes) -> Vec<Line> {
    // SAFETY: a reference is a good pointer.
    let bytes = unsafe { dgs_memory_bytes(sizes) };
    vec![Line([0xa5; 16]); bytes / 16]
}

fn none() -> DgsError {
    DgsError::argument(-1, "")
}

fn field(error: &DgsError) -> &str {
    // SAFETY: `field` is a constant of `field_len` bytes.
    core::str::from_utf8(unsafe { slice::from_raw_parts(error.field, error.field_len) }).unwrap()
}

fn open(memory: &mut [Line], sizes: &DgsSizes) -> Result<*mut DgsReceiver, DgsError> {
    let (mut receiver, mut error) = (ptr::null_mut(), none());
    let len = size_of_val(memory);
    // SAFETY: pointers from references, the length of the slice.
    let status = unsafe { dgs_open(memory.as_mut_ptr().cast(), len, sizes, &mut receiver, &mut error) };
    if status == DGS_OK { Ok(receiver) } else { Err(error) }
}

#[test]
fn a_receiver_opens_buffers_early_media_and_closes() {
    let sizes = sizes();
    let mut memory = block(&sizes);
    let receiver = open(&mut memory, &sizes).unwrap();
    // "123456789" and its CRC-32: a packet as far as anybody can tell before the manifest.
    let packet = *b"123456789\x26\x39\xf4\xcb";
    let (mut arrival, mut counters, mut error) = (DgsArrival::waiting(), DgsCounters::default(), none());
    // SAFETY: the receiver is open and its memory lives; pointers from references.
    unsafe {
        assert_eq!(dgs_media(receiver, packet.as_ptr(), packet.len(), &mut arrival, &mut error), DGS_OK);
        assert_eq!(arrival, DgsArrival::waiting());
        let cut = packet.len() - 1;
        assert_eq!(dgs_media(receiver, packet.as_ptr(), cut, ptr::null_mut(), &mut error), DGS_CHECKSUM);
        assert_eq!((error.status, field(&error)), (DGS_CHECKSUM, "packet.crc"));
        for _ in 0..3 {
            let _ = dgs_media(receiver, packet.as_ptr(), packet.len(), ptr::null_mut(), ptr::null_mut());
        }
        assert_eq!(dgs_count(receiver, &mut counters, ptr::null_mut()), DGS_OK);
        assert_eq!((counters.early, counters.refused), (2, [0, 0, 0, 1, 0, 0, 2]));
        assert_eq!(dgs_control(receiver, packet.as_ptr(), packet.len(), &mut error), DGS_UNKNOWN);
        assert_eq!(field(&error), "manifest.magic");
        let mut stream = DgsStream::default();
        assert_eq!(dgs_describe(receiver, &mut stream, &mut error), DGS_NO_MANIFEST);
        let mut out = [DgsGaussian::from(Gaussian::ABSENT); 2];
        let (none, nowhere) = (ptr::null_mut(), ptr::null_mut());
        assert_eq!(
            dgs_frame(receiver, 0, out.as_mut_ptr(), 2, none, 0, nowhere, &mut error),
            DGS_NO_MANIFEST
        );
        let (mut bytes, mut written) = ([0u8; 8], 0);
        let bytes = bytes.as_mut_ptr();
        assert_eq!(
            dgs_receipt(receiver, 0, 0, ptr::null(), bytes, 8, &mut written, &mut error),
            DGS_NO_MANIFEST
        );
        dgs_close(receiver);
        assert_eq!(dgs_count(receiver, &mut counters, &mut error), DGS_MISUSE);
        dgs_close(receiver);
        dgs_close(ptr::null_mut());
    }
}

#[test]
fn a_block_that_is_short_crooked_or_moved_is_refused() {
    let sizes = sizes();
    let mut memory = block(&sizes);
    let lines = memory.len();
    let error = open(&mut memory[..lines - 1], &sizes).unwrap_err();
    assert_eq!((error.status, field(&error)), (DGS_CAPACITY, "memory"));
    assert_eq!((error.found, error.most), (16 * (lines as u64 - 1), 16 * lines as u64));
    let (mut receiver, mut error) = (ptr::null_mut(), none());
    // SAFETY: a byte into the block is still inside; no more than the block is said to be there.
    let crooked = unsafe { memory.as_mut_ptr().cast::<u8>().add(4) };
    // SAFETY: as above, pointers from references.
    let status = unsafe { dgs_open(crooked.cast(), 16, &sizes, &mut receiver, &mut error) };
    assert_eq!((status, field(&error), receiver.is_null()), (DGS_MISUSE, "memory", true));
    let endless = DgsSizes { symbols: usize::MAX, ..sizes };
    assert_eq!(open(&mut memory, &endless).unwrap_err().status, DGS_CAPACITY);
    // SAFETY: a reference is a good pointer, null is allowed.
    unsafe {
        assert_eq!(dgs_memory_bytes(&endless), 0);
        assert_eq!(dgs_memory_bytes(ptr::null()), 0);
    }
    open(&mut memory, &sizes).unwrap();
    let mut moved = memory.clone();
    // SAFETY: as large as a receiver and readable; that it was not opened here is what is tested.
    let status = unsafe { dgs_control(moved.as_mut_ptr().cast(), ptr::null(), 0, &mut error) };
    assert_eq!((status, field(&error)), (DGS_MISUSE, "receiver"));
}

#[test]
fn null_pointers_and_buffers_inside_the_block_are_refused() {
    let sizes = sizes();
    let mut memory = block(&sizes);
    let receiver = open(&mut memory, &sizes).unwrap();
    let mut error = none();
    // SAFETY: null is checked before it is used; the other pointers are to the open receiver.
    unsafe {
        assert_eq!(dgs_media(receiver, ptr::null(), 5, ptr::null_mut(), &mut error), DGS_NULL);
        assert_eq!(field(&error), "packet");
        assert_eq!(dgs_media(receiver, ptr::null(), 0, ptr::null_mut(), ptr::null_mut()), DGS_ILLEGAL);
        assert_eq!(dgs_media(receiver, receiver.cast(), 5, ptr::null_mut(), &mut error), DGS_MISUSE);
        let inside = receiver.cast::<DgsGaussian>();
        let (none, nowhere) = (ptr::null_mut(), ptr::null_mut());
        assert_eq!(dgs_frame(receiver, 0, inside, 1, none, 0, nowhere, &mut error), DGS_MISUSE);
        assert_eq!(field(&error), "out");
        assert_eq!(dgs_control(ptr::null_mut(), ptr::null(), 0, &mut error), DGS_NULL);
        assert_eq!(dgs_count(receiver, ptr::null_mut(), ptr::null_mut()), DGS_NULL);
        assert_eq!(dgs_manifest_bytes(ptr::null(), 0, ptr::null_mut(), &mut error), DGS_NULL);
        let mut bytes = 0;
        assert_eq!(dgs_manifest_bytes(ptr::null(), 0, &mut bytes, &mut error), DGS_SHORT);
        let mut found = DgsSizes::default();
        let (message, scratch) = (b"DGSM", ptr::null_mut());
        assert_eq!(dgs_sizes_of(message.as_ptr(), 4, scratch, 0, &mut found, &mut error), DGS_SHORT);
        assert_eq!(dgs_open(ptr::null_mut(), 0, &sizes, ptr::null_mut(), &mut error), DGS_NULL);
        assert_eq!(dgs_digest(7, ptr::null(), 3, ptr::null(), 0), 7);
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
