/* Receiver and decoder of dynamic Gaussian splat streams (dgs).
 *
 * Written from src/types.rs and src/ffi.rs by tests/header.rs: do not edit.
 *
 * Memory   One block per receiver, the caller's: dgs_manifest_bytes and dgs_sizes_of read the sizes
 *          out of a manifest, dgs_memory_bytes adds them up, dgs_open makes a receiver in the block.
 *          The block stays where it is, touched by nobody else, until dgs_close. Nothing is allocated.
 * Pointers are used during the call only, the block excepted. dgs_error.field is a constant.
 * Threads  A receiver may move between threads; no two calls with one receiver at once.
 * Errors   Calls return DGS_OK or another status and fill *error, which may be NULL. Null, misaligned,
 *          short and overlapping buffers are refused; lengths that lie cannot be. A refused packet
 *          leaves the receiver usable.
 */
#ifndef DGS_H
#define DGS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Done. */
#define DGS_OK 0
/* The bytes end before the field does. */
#define DGS_SHORT 1
/* The field holds a value the format forbids. */
#define DGS_ILLEGAL 2
/* A magic, version or profile that this library does not know. */
#define DGS_UNKNOWN 3
/* A CRC does not match. */
#define DGS_CHECKSUM 4
/* At odds with the manifest or with what already arrived. */
#define DGS_CONTRADICTION 5
/* Arrived before; nothing new in it. */
#define DGS_DUPLICATE 6
/* The caller's memory is too small for it. */
#define DGS_CAPACITY 7
/* A pointer is null that must not be. */
#define DGS_NULL 8
/* A pointer is misaligned, overlaps the receiver's block, or is no receiver. */
#define DGS_MISUSE 9
/* The manifest has not arrived. */
#define DGS_NO_MANIFEST 10
/* Alignment of a receiver's block, bytes. */
#define DGS_ALIGN 16
/* No packet. */
#define DGS_NONE 0xffffffffu
/* Most packets that one arrival recovers. */
#define DGS_MAX_RECOVERED 8
/* Number of refusal counters: statuses 1 to 7, in that order. */
#define DGS_REFUSALS 7
/* Digest of nothing, where dgs_digest starts. */
#define DGS_DIGEST_START UINT64_C(0xcbf29ce484222325)
/* Largest receipt, bytes. */
#define DGS_RECEIPT_BYTES 1200

/* What is wrong, in which field, where, what was found and what is allowed. */
typedef struct dgs_error {
    /* Status of the call. */
    int32_t status;
    /* Byte offset of the field in the input. */
    uint32_t offset;
    /* The value found; bytes there are, for DGS_SHORT and DGS_CAPACITY. */
    uint64_t found;
    /* Smallest allowed value. */
    uint64_t least;
    /* Largest allowed value; bytes needed, for DGS_SHORT and DGS_CAPACITY. */
    uint64_t most;
    /* Name of the field or argument, ASCII, field_len bytes without a final zero; a constant. */
    uint8_t const *field;
    /* Bytes of field. */
    size_t field_len;
} dgs_error;

/* Sizes of everything in a receiver's block, in elements. */
typedef struct dgs_sizes {
    /* Bytes of the unpacked manifest. */
    size_t manifest;
    /* Cells of the lattice, and one. */
    size_t cells;
    /* Symbols. */
    size_t symbols;
    /* Blocks of all cells. */
    size_t blocks;
    /* Words of the packet bitmap. */
    size_t seen;
    /* Entropy decode slots. */
    size_t slots;
    /* Group counters (profile paper). */
    size_t progress;
    /* Bytes of repair; 0 repairs nothing. */
    size_t parity;
    /* Bytes for media that arrives before the manifest; each packet takes 2 more than its length. */
    size_t early;
    /* Gaussians of the largest epoch. */
    size_t gaussians;
} dgs_sizes;

/* What became of a packet. */
typedef struct dgs_arrival {
    /* Its id, or DGS_NONE while it waits for the manifest. */
    uint32_t id;
    /* Packets that repair recovered with it. */
    uint32_t recovered;
    /* Their ids, ascending; the rest is DGS_NONE. */
    uint32_t recovered_ids[DGS_MAX_RECOVERED];
} dgs_arrival;

/* What happened to packets. */
typedef struct dgs_counters {
    /* Media packets accepted. */
    uint32_t media;
    /* Parity packets accepted. */
    uint32_t parity;
    /* Packets that waited for the manifest. */
    uint32_t early;
    /* Packets recovered by repair. */
    uint32_t recovered;
    /* Repaired packets that failed their own checks. */
    uint32_t repair_failed;
    /* Packets refused, by status less one. */
    uint32_t refused[DGS_REFUSALS];
} dgs_counters;

/* What the manifest says of the stream. */
typedef struct dgs_stream {
    /* Frames. */
    uint32_t frames;
    /* Frame rate, numerator: frames. */
    uint32_t rate_frames;
    /* Frame rate, denominator: seconds. */
    uint32_t rate_seconds;
    /* Packets, parity included. */
    uint32_t packets;
    /* Gaussians of the largest epoch. */
    uint32_t gaussians;
    /* Higher harmonic coefficients per Gaussian, all channels: 0, 9, 24 or 45. */
    uint32_t sh_rest;
} dgs_stream;

/* One Gaussian of one frame. */
typedef struct dgs_gaussian {
    /* Centre, scene units. */
    float position[3];
    /* Standard deviations along the local axes, scene units. */
    float scale[3];
    /* Unit quaternion, w x y z, local axes to world. */
    float rotation[4];
    /* Peak opacity, 0 to 1; 0 draws nothing. */
    float opacity;
    /* Harmonic band 0: colour is 0.5 + 0.28209479 sh0. */
    float sh0[3];
} dgs_gaussian;

/* Viewer's pose in a receipt. */
typedef struct dgs_pose {
    /* Camera centre, scene units. */
    float position[3];
    /* Camera to world, unit quaternion, w x y z. */
    float rotation[4];
} dgs_pose;

/* What a decoded frame holds. */
typedef struct dgs_decoded {
    /* The epoch shown. */
    uint32_t epoch;
    /* Gaussians written. */
    uint32_t gaussians;
    /* Blocks whose base is there. */
    uint32_t present_blocks;
    /* Blocks of the epoch. */
    uint32_t blocks;
} dgs_decoded;

/* A receiver and decoder at the front of its block. Opaque to C. */
typedef struct dgs_receiver dgs_receiver;

/* The version of DGSM that this library reads. */
uint32_t dgs_version(void);

/* Writes to bytes how large the manifest in message is unpacked: the scratch memory of
 * dgs_sizes_of. */
int32_t dgs_manifest_bytes(uint8_t const *message, size_t message_len, size_t *bytes, dgs_error *error);

/* Writes to sizes what the stream of the manifest in message needs; early is left 0.
 * scratch holds the unpacked manifest for the time of the call. */
int32_t dgs_sizes_of(uint8_t const *message, size_t message_len, uint8_t *scratch, size_t scratch_len, dgs_sizes *sizes, dgs_error *error);

/* Bytes of the block for a receiver of sizes; 0 if there is no such block or sizes is null. */
size_t dgs_memory_bytes(dgs_sizes const *sizes);

/* Makes a receiver of sizes in memory, which must be aligned to DGS_ALIGN and at least
 * dgs_memory_bytes long. The block belongs to the receiver until dgs_close. */
int32_t dgs_open(void *memory, size_t memory_len, dgs_sizes const *sizes, dgs_receiver **receiver, dgs_error *error);

/* Ends a receiver; its block is the caller's again. Null and closed receivers are left alone. */
void dgs_close(dgs_receiver *receiver);

/* Takes the whole DGSM message, then the media that waited for it. */
int32_t dgs_control(dgs_receiver *receiver, uint8_t const *message, size_t message_len, dgs_error *error);

/* Takes one DGSP packet, in any order. arrival may be null. */
int32_t dgs_media(dgs_receiver *receiver, uint8_t const *packet, size_t packet_len, dgs_arrival *arrival, dgs_error *error);

/* Writes to counters what happened to packets so far. */
int32_t dgs_count(dgs_receiver *receiver, dgs_counters *counters, dgs_error *error);

/* Writes to stream what the manifest says. */
int32_t dgs_describe(dgs_receiver *receiver, dgs_stream *stream, dgs_error *error);

/* Decodes frame in the state that has arrived: Gaussians to the front of out, higher bands
 * (dgs_stream.sh_rest values per Gaussian) to sh_rest, which may be null where there are none.
 * decoded may be null. What was in out and sh_rest is lost even if the call fails. */
int32_t dgs_frame(dgs_receiver *receiver, uint32_t frame, dgs_gaussian *out, size_t out_len, float *sh_rest, size_t sh_rest_len, dgs_decoded *decoded, dgs_error *error);

/* FNV-1a, 64 bits, over the bytes of a decoded frame, going on from state
 * (DGS_DIGEST_START, or what an earlier call gave). A null list counts as empty. */
uint64_t dgs_digest(uint64_t state, dgs_gaussian const *gaussians, size_t gaussians_len, float const *sh_rest, size_t sh_rest_len);

/* Writes a receipt (DGSF) that acknowledges what arrived or was recovered, the newest 128 runs
 * of packets of it, to the front of out (DGS_RECEIPT_BYTES are enough). pose may be null. */
int32_t dgs_receipt(dgs_receiver *receiver, uint32_t sequence, uint64_t playout_us, dgs_pose const *pose, uint8_t *out, size_t out_len, size_t *written, dgs_error *error);

#ifdef __cplusplus
}
#endif

#endif
