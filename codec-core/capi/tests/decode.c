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

int main(int argc, char **argv)
{
    dgs_error error;
    dgs_sizes sizes;
    dgs_stream stream;
    dgs_counters counters;
    dgs_arrival arrival;
    dgs_decoded decoded;
    dgs_receiver *receiver;
    size_t message_len, packets_len, raw_len, block_len, at, written, k;
    uint32_t kept = 0, refusals = 0, recovered = 0;
    uint64_t digest = DGS_DIGEST_START;
    uint8_t *message, *packets, *scratch, *block, *aligned;
    uint8_t receipt[DGS_RECEIPT_BYTES];
    dgs_gaussian *gaussians;
    float *rest;
    int i;

    if (argc < 4) {
        fprintf(stderr, "decode MANIFEST PACKETS FRAME...\n");
        return 1;
    }
    message = whole(argv[1], &message_len);
    packets = whole(argv[2], &packets_len);

    check(dgs_manifest_bytes(message, message_len, &raw_len, &error), "dgs_manifest_bytes", &error);
    scratch = malloc(raw_len);
    refused(dgs_sizes_of(message, message_len, scratch, raw_len - 1, &sizes, &error), DGS_CAPACITY,
            "dgs_sizes_of with short scratch");
    check(dgs_sizes_of(message, message_len, scratch, raw_len, &sizes, &error), "dgs_sizes_of", &error);
    free(scratch);
    sizes.early = 4096;
    block_len = dgs_memory_bytes(&sizes);
    block = malloc(block_len + DGS_ALIGN);
    aligned = block + (DGS_ALIGN - (uintptr_t)block % DGS_ALIGN) % DGS_ALIGN;
    refused(dgs_open(aligned, block_len - 1, &sizes, &receiver, &error), DGS_CAPACITY, "dgs_open with a short block");
    check(dgs_open(aligned, block_len, &sizes, &receiver, &error), "dgs_open", &error);

    for (at = 0, k = 0; at + 2 <= packets_len; k++) {
        size_t len = packets[at] | (size_t)packets[at + 1] << 8;
        at += 2;
        if (dgs_media(receiver, packets + at, len, &arrival, &error) == DGS_OK) {
            kept++;
            recovered += arrival.recovered;
        } else {
            refusals++;
        }
        at += len;
        if (k == 0) {
            refused(dgs_describe(receiver, &stream, &error), DGS_NO_MANIFEST, "dgs_describe too early");
            check(dgs_control(receiver, message, message_len, &error), "dgs_control", &error);
        }
    }
    refused(dgs_control(receiver, message, message_len, &error), DGS_DUPLICATE, "dgs_control twice");
    refused(dgs_media(receiver, NULL, 9, NULL, NULL), DGS_NULL, "dgs_media of nothing");
    refused(dgs_media(receiver, aligned, 9, NULL, NULL), DGS_MISUSE, "dgs_media of the block");
    check(dgs_describe(receiver, &stream, &error), "dgs_describe", &error);
    check(dgs_count(receiver, &counters, &error), "dgs_count", &error);

    gaussians = malloc(sizeof *gaussians * stream.gaussians);
    rest = malloc(sizeof *rest * stream.gaussians * stream.sh_rest + 1);
    refused(dgs_frame(receiver, stream.frames, gaussians, stream.gaussians, rest, 0, NULL, &error), DGS_ILLEGAL,
            "dgs_frame past the end");
    refused(dgs_frame(receiver, 0, gaussians, stream.gaussians - 1, rest, 0, NULL, &error), DGS_CAPACITY,
            "dgs_frame into too little");
    for (i = 3; i < argc; i++) {
        uint32_t frame = (uint32_t)strtoul(argv[i], NULL, 10);
        check(dgs_frame(receiver, frame, gaussians, stream.gaussians, rest,
                        (size_t)stream.gaussians * stream.sh_rest, &decoded, &error),
              "dgs_frame", &error);
        digest = dgs_digest(digest, gaussians, decoded.gaussians, rest,
                            (size_t)decoded.gaussians * stream.sh_rest);
    }
    check(dgs_receipt(receiver, 1, 40000, NULL, receipt, sizeof receipt, &written, &error), "dgs_receipt", &error);
    dgs_close(receiver);
    refused(dgs_control(receiver, message, message_len, &error), DGS_MISUSE, "dgs_control after dgs_close");

    printf("block_bytes %lu\n", (unsigned long)block_len);
    printf("kept %u\nrefused %u\nrecovered %u\n", (unsigned)kept, (unsigned)refusals, (unsigned)recovered);
    printf("count.media %u\ncount.parity %u\ncount.recovered %u\n", (unsigned)counters.media,
           (unsigned)counters.parity, (unsigned)counters.recovered);
    printf("receipt_bytes %lu\n", (unsigned long)written);
    printf("digest %016llx\n", (unsigned long long)digest);
    free(message);
    free(packets);
    free(block);
    free(gaussians);
    free(rest);
    return 0;
}
