/* Player of dynamic Gaussian splat streams (dgs): packets in, Gaussians out.
 *
 * Written from src/types.rs and src/ffi.rs by tests/header.rs: do not edit.
 *
 * Memory   One block per player, the caller's: dgs_memory_bytes says how large one is that holds every
 *          stream within caps, dgs_required what one stream needs. dgs_open makes a player in the block,
 *          which stays where it is, touched by nobody else, until dgs_close. Nothing is allocated.
 * Pointers are used during the call only, the block excepted. dgs_error.field is a constant; what
 *          dgs_frame points to lies in the block and is good until the next call with the player.
 * Streams  Those of the profile paper-context are played by libraries with the feature of that name, which
 *          is on by default; others refuse them with DGS_UNKNOWN.
 * Threads  A player may move between threads; no two calls with one player at once.
 * Errors   Calls return DGS_OK or another status and fill *error, which may be NULL. Pointers that are
 *          null or misaligned, buffers that are short or overlap the block are refused (DGS_MISUSE, and
 *          no *error, where it is error itself that is misaligned or overlaps); lengths that lie cannot
 *          be. A refused packet leaves the player usable.
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
/* The caller's memory is too small for it, or it is over a bound of dgs_caps. */
#define DGS_CAPACITY 7
/* A pointer is null that must not be. */
#define DGS_NULL 8
/* A pointer is misaligned, overlaps the player's block, or is no player. */
#define DGS_MISUSE 9
/* The manifest has not arrived. */
#define DGS_NO_MANIFEST 10
/* Alignment of a player's block, bytes. */
#define DGS_ALIGN 16
/* No packet. */
#define DGS_NONE 0xffffffffu
/* Most packets that one arrival recovers. */
#define DGS_MAX_RECOVERED 8
/* Number of refusal counters: statuses 1 to 7, in that order. */
#define DGS_REFUSALS 7
/* Number of levels. */
#define DGS_LEVELS 4
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
    /* The value found; bytes there are, for DGS_SHORT. For DGS_CAPACITY what there is of the caller's
     * memory, if it is below least, or else a count that is over a bound of dgs_caps. */
    uint64_t found;
    /* Smallest allowed value; what is needed, for DGS_SHORT and for memory. */
    uint64_t least;
    /* Largest allowed value; what is needed, for DGS_SHORT and for memory. */
    uint64_t most;
    /* Name of the field or argument, ASCII, field_len bytes without a final zero; a constant. */
    uint8_t const *field;
    /* Bytes of field. */
    size_t field_len;
} dgs_error;

/* The most that a player takes on; every field is a largest allowed value. See codec-core's Caps. */
typedef struct dgs_caps {
    /* Gaussians of one epoch. */
    uint32_t gaussians_per_epoch;
    /* Frames of the stream. */
    uint32_t frames;
    /* Cells: clusters of all epochs, and again of every window. */
    uint32_t cells;
    /* Symbols of all cells. */
    uint32_t symbols;
    /* Blocks of all cells. */
    uint32_t blocks;
    /* Packets of the stream. */
    uint32_t packets;
    /* Entropy tables. */
    uint32_t tables;
    /* Bytes of the unpacked manifest. */
    uint32_t manifest_bytes;
    /* Bytes of repair; what lies beyond is not repaired. */
    uint32_t parity_bytes;
    /* Bytes for packets before the manifest; each takes 2 more than its length. */
    uint32_t early_bytes;
    /* Blocks that the extents of one packet span. */
    uint32_t blocks_per_packet;
    /* Values of one packet. */
    uint32_t values_per_packet;
} dgs_caps;

/* What became of a packet. */
typedef struct dgs_pushed {
    /* Its id, or DGS_NONE while it waits for the manifest. */
    uint32_t id;
    /* Packets that repair recovered with it. */
    uint32_t recovered;
    /* Their ids, ascending; the rest is DGS_NONE. */
    uint32_t recovered_ids[DGS_MAX_RECOVERED];
} dgs_pushed;

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
    /* How Gaussians are drawn: 0 variance 0.3 pixels² is added; 1 the same, and dimmed as much; 2 0.1
     * pixels², and dimmed as much. */
    uint32_t footprint;
    /* Which axis of the scene points up: 0 +y, 1 +x, 2 +z, 3 −x, 4 −y, 5 −z. */
    uint32_t up;
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

/* A decoded frame, in the player's block until the next call with the player. */
typedef struct dgs_frame {
    /* The Gaussians of the frame's epoch. */
    dgs_gaussian const *gaussians;
    /* Number of them. */
    size_t gaussians_len;
    /* Their higher harmonic coefficients: Gaussian by Gaussian, then coefficient, then channel. */
    float const *sh_rest;
    /* Number of all of them. */
    size_t sh_rest_len;
    /* The epoch shown. */
    uint32_t epoch;
    /* Blocks whose base is there. */
    uint32_t present_blocks;
    /* Blocks of the epoch. */
    uint32_t blocks;
} dgs_frame;

/* How many blocks of a frame are usable up to each level. */
typedef struct dgs_usable {
    /* Blocks of the frame's epoch. */
    uint32_t blocks;
    /* Blocks whose canonical attributes are usable up to the level. */
    uint32_t canonical[DGS_LEVELS];
    /* Blocks that are present and whose motion is usable up to the level. */
    uint32_t motion[DGS_LEVELS];
} dgs_usable;

/* A player at the front of its block. Opaque to C. */
typedef struct dgs_player dgs_player;

/* The version of DGSM that this library reads. */
uint32_t dgs_version(void);

/* Fills caps with bounds for computers and telephones; a null pointer is left alone. A block that holds
 * every stream within them is under 3 GiB. */
void dgs_caps_host(dgs_caps *caps);

/* Fills caps with bounds for microcontrollers; a null pointer is left alone. A block that holds every
 * stream within them is under 2.25 MiB. */
void dgs_caps_small(dgs_caps *caps);

/* Bytes of a block that holds every stream within caps; 0 if there is no such block or caps is
 * null. A smaller block takes the streams that fit: see dgs_required. */
size_t dgs_memory_bytes(dgs_caps const *caps);

/* Makes a player that accepts streams within caps, and waits for a manifest, in memory, which must
 * be aligned to DGS_ALIGN. The block belongs to the player until dgs_close. */
int32_t dgs_open(void *memory, size_t memory_len, dgs_caps const *caps, dgs_player **player, dgs_error *error);

/* Ends a player; its block is the caller's again. Null and closed players are left alone. */
void dgs_close(dgs_player *player);

/* Writes to bytes how large the block of a player must be for the stream of the DGSM message
 * message. The player waits for its manifest, and its block is large enough for that alone. */
int32_t dgs_required(dgs_player *player, uint8_t const *message, size_t message_len, size_t *bytes, dgs_error *error);

/* Takes the whole DGSM message, then the packets that came early. */
int32_t dgs_manifest(dgs_player *player, uint8_t const *message, size_t message_len, dgs_error *error);

/* Takes one DGSP packet, in any order; before the manifest it is kept. pushed may be null. */
int32_t dgs_push(dgs_player *player, uint8_t const *packet, size_t packet_len, dgs_pushed *pushed, dgs_error *error);

/* Writes to counters what happened to packets so far. */
int32_t dgs_count(dgs_player *player, dgs_counters *counters, dgs_error *error);

/* Writes to stream what the manifest says. */
int32_t dgs_describe(dgs_player *player, dgs_stream *stream, dgs_error *error);

/* Decodes frame from what has arrived and writes to shown where it lies: in the player's block,
 * until the next call with the player. */
int32_t dgs_show(dgs_player *player, uint32_t frame, dgs_frame *shown, dgs_error *error);

/* Writes to usable how much of frame can be shown. */
int32_t dgs_count_usable(dgs_player *player, uint32_t frame, dgs_usable *usable, dgs_error *error);

/* FNV-1a, 64 bits, over the bytes of a decoded frame, going on from state
 * (DGS_DIGEST_START, or what an earlier call gave). A null list counts as empty. */
uint64_t dgs_digest(uint64_t state, dgs_gaussian const *gaussians, size_t gaussians_len, float const *sh_rest, size_t sh_rest_len);

/* Writes a receipt (DGSF) that acknowledges what arrived or was recovered, the newest 128 ranges
 * of packets of it, to the front of out (DGS_RECEIPT_BYTES are enough). pose may be null. */
int32_t dgs_receipt(dgs_player *player, uint32_t sequence, uint64_t playout_us, dgs_pose const *pose, uint8_t *out, size_t out_len, size_t *written, dgs_error *error);

#ifdef __cplusplus
}
#endif

#endif
