/* Decodes a stream through dgs.h and prints what came of it:
 *
 *     decode MANIFEST PACKETS FRAME...
 *
 * PACKETS holds packets in order of arrival, each after its length (two bytes, little-endian). The
 * first one is given before the manifest. Lines are `key value`; the digest is over all frames.
 * Exit status: 0, or 1 after a line that says which call refused what. */

#include "dgs.h"

#include <stdio.h>
#include <stdlib.h>

static void *whole(const char *path, size_t *len)
{
    FILE *file = fopen(path, "rb");
    long end;
    void *bytes;
    if (!file || fseek(file, 0, SEEK_END) || (end = ftell(file)) < 0 || fseek(file, 0, SEEK_SET)) {
        fprintf(stderr, "%s: cannot read\n", path);
        exit(1);
    }
    *len = (size_t)end;
    bytes = malloc(*len + 1);
    if (!bytes || fread(bytes, 1, *len, file) != *len) {
        fprintf(stderr, "%s: cannot read\n", path);
        exit(1);
    }
    fclose(file);
    return bytes;
}

static void check(int32_t status, const char *call, const dgs_error *error)
{
    if (status == DGS_OK) {
        return;
    }
    printf("%s refused: status %d, %.*s at byte %u: found %llu, allowed %llu to %llu\n", call, (int)status,
           (int)error->field_len, (const char *)error->field, (unsigned)error->offset,
           (unsigned long long)error->found, (unsigned long long)error->least,
           (unsigned long long)error->most);
    exit(1);
}

/* A call that must be refused. */
static void refused(int32_t status, int32_t wanted, const char *call)
{
    if (status != wanted) {
        printf("%s gave status %d, not %d\n", call, (int)status, (int)wanted);
        exit(1);
    }
}

/* Memory for a player; this program frees nothing. */
static uint8_t *aligned_block(size_t len)
{
    uint8_t *block = malloc(len + DGS_ALIGN);
    if (!block) {
        printf("no memory\n");
        exit(1);
    }
    return block + (DGS_ALIGN - (uintptr_t)block % DGS_ALIGN) % DGS_ALIGN;
}

int main(int argc, char **argv)
{
    dgs_error error;
    dgs_caps caps;
    dgs_stream stream;
    dgs_counters counters;
    dgs_pushed pushed;
    dgs_frame shown;
    dgs_usable usable;
    dgs_player *player;
    size_t message_len, packets_len, block_len, at, written, k;
    uint32_t kept = 0, refusals = 0, recovered = 0;
    uint64_t digest = DGS_DIGEST_START;
    uint8_t *message, *packets, *block;
    uint8_t receipt[DGS_RECEIPT_BYTES];
    int i;

    if (argc < 4) {
        fprintf(stderr, "decode MANIFEST PACKETS FRAME...\n");
        return 1;
    }
    message = whole(argv[1], &message_len);
    packets = whole(argv[2], &packets_len);

    /* Bounds, and a first block that holds the unpacked manifest: it says what the stream needs. */
    dgs_caps_host(&caps);
    caps.early_bytes = 4096;
    block_len = 1 << 18;
    block = aligned_block(block_len);
    check(dgs_open(block, block_len, &caps, &player, &error), "dgs_open", &error);
    refused(dgs_required(player, message, message_len - 1, &block_len, &error), DGS_SHORT, "dgs_required of less");
    check(dgs_required(player, message, message_len, &block_len, &error), "dgs_required", &error);
    dgs_close(player);
    refused(dgs_open(block, 4096, &caps, &player, &error), DGS_CAPACITY, "dgs_open with a short block");
    block = aligned_block(block_len);
    check(dgs_open(block, block_len, &caps, &player, &error), "dgs_open", &error);

    for (at = 0, k = 0; at + 2 <= packets_len; k++) {
        size_t len = packets[at] | (size_t)packets[at + 1] << 8;
        at += 2;
        if (dgs_push(player, packets + at, len, &pushed, &error) == DGS_OK) {
            kept++;
            recovered += pushed.recovered;
        } else {
            refusals++;
        }
        at += len;
        if (k == 0) {
            refused(dgs_describe(player, &stream, &error), DGS_NO_MANIFEST, "dgs_describe too early");
            check(dgs_manifest(player, message, message_len, &error), "dgs_manifest", &error);
        }
    }
    refused(dgs_manifest(player, message, message_len, &error), DGS_DUPLICATE, "dgs_manifest twice");
    refused(dgs_push(player, NULL, 9, NULL, NULL), DGS_NULL, "dgs_push of nothing");
    refused(dgs_push(player, block, 9, NULL, NULL), DGS_MISUSE, "dgs_push of the block");
    check(dgs_describe(player, &stream, &error), "dgs_describe", &error);
    check(dgs_count(player, &counters, &error), "dgs_count", &error);

    refused(dgs_show(player, stream.frames, &shown, &error), DGS_ILLEGAL, "dgs_show past the end");
    for (i = 3; i < argc; i++) {
        uint32_t frame = (uint32_t)strtoul(argv[i], NULL, 10);
        check(dgs_show(player, frame, &shown, &error), "dgs_show", &error);
        check(dgs_count_usable(player, frame, &usable, &error), "dgs_count_usable", &error);
        if (usable.blocks != shown.blocks || usable.canonical[0] != shown.present_blocks) {
            printf("%u of %u blocks are usable, %u of %u are shown\n", (unsigned)usable.canonical[0],
                   (unsigned)usable.blocks, (unsigned)shown.present_blocks, (unsigned)shown.blocks);
            return 1;
        }
        digest = dgs_digest(digest, shown.gaussians, shown.gaussians_len, shown.sh_rest, shown.sh_rest_len);
    }
    check(dgs_receipt(player, 1, 40000, NULL, receipt, sizeof receipt, &written, &error), "dgs_receipt", &error);
    dgs_close(player);
    refused(dgs_manifest(player, message, message_len, &error), DGS_MISUSE, "dgs_manifest after dgs_close");

    printf("block_bytes %lu\n", (unsigned long)block_len);
    printf("kept %u\nrefused %u\nrecovered %u\n", (unsigned)kept, (unsigned)refusals, (unsigned)recovered);
    printf("count.media %u\ncount.parity %u\ncount.recovered %u\n", (unsigned)counters.media,
           (unsigned)counters.parity, (unsigned)counters.recovered);
    printf("receipt_bytes %lu\n", (unsigned long)written);
    printf("digest %016llx\n", (unsigned long long)digest);
    return 0;
}
