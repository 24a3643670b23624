/* Plays a .dgs file and prints how many Gaussians its first frame has: play FILE */
#include "dgs.h"
#include <stdio.h>
#include <stdlib.h>

static _Alignas(DGS_ALIGN) uint8_t block[8 << 20]; /* 8 MiB of static memory; C11 */
static uint8_t file[1 << 20];

int main(int argc, char **argv)
{
    FILE *in = argc > 1 ? fopen(argv[1], "rb") : NULL;
    size_t len = in ? fread(file, 1, sizeof file, in) : 0, at;
    dgs_error error;
    dgs_caps caps;
    dgs_player *player;
    dgs_frame shown;
    if (len < 8) return 1;
    /* "DGS\1", length of the manifest message (4 bytes), message; then per packet its length (2 bytes). */
    at = 8 + (file[4] | (size_t)file[5] << 8 | (size_t)file[6] << 16);
    dgs_caps_small(&caps);
    if (at > len || dgs_open(block, sizeof block, &caps, &player, &error) != DGS_OK
        || dgs_manifest(player, file + 8, at - 8, &error) != DGS_OK) return 1;
    while (at + 2 <= len) {
        size_t packet_len = file[at] | (size_t)file[at + 1] << 8;
        if (packet_len == 0 || packet_len > len - at - 2) break;
        dgs_push(player, file + at + 2, packet_len, NULL, NULL); /* refusals are counted */
        at += 2 + packet_len;
    }
    if (dgs_show(player, 0, &shown, &error) != DGS_OK) return 1;
    printf("%lu Gaussians\n", (unsigned long)shown.gaussians_len);
    return 0;
}
