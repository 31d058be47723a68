/* Pictures in few colours and as sixels, read by the compiler and by cffi alike (which skips # lines).
 * The caller owns every buffer; nothing is allocated, kept or shared, so threads may call at once.
 * Images are [H, W, 3] bytes without gaps. Functions return a count, or TSPLAT_REFUSED where an
 * argument is out of range. The same in NumPy, to the same bits: dither.py and sixel.py. */
#ifndef TSPLAT_ENCODE_H
#define TSPLAT_ENCODE_H
#include <stdint.h>

enum {
    TSPLAT_BINS = 32768,      /* colours told apart: 5 bits a channel */
    TSPLAT_PALETTE = 256,     /* colours of a palette, at most */
    TSPLAT_SIDE = 8,          /* of the thresholds' square */
    TSPLAT_SCRATCH = 24,      /* numbers of scratch a column of a picture: six runs of four */
    TSPLAT_REFUSED = -1,
    TSPLAT_FULL = -2          /* there is no room for what comes out */
};

/* n values as Frame.to_uint8 makes them: floor(clip(value, 0, 1) * 255 + 0.5). */
void tsplat_levels(const float *values, int64_t n, uint8_t *levels);

/* The bins used of n pixels, increasing; mean [C, 3] of each, to the nearest, and pixels [C]. sums is
 * scratch [BINS, 4]. Returns C. */
int32_t tsplat_distinct(const uint8_t *image, int64_t n, int32_t *bins, uint8_t *colors,
                        int64_t *counts, int64_t *sums);

/* At most most colours, doubles [K, 3], for C of them that stand for counts pixels each. groups is
 * scratch [C]. Returns K. */
int32_t tsplat_adaptive_palette(const uint8_t *colors, const int64_t *counts, int32_t count,
                                int32_t most, uint8_t *groups, double *palette);

/* For each of C colours the nearest of a palette [K, 3]. */
int32_t tsplat_nearest(const uint8_t *colors, int32_t count, const uint8_t *palette, int32_t k,
                       uint8_t *first);

/* And the one to mix it with. */
int32_t tsplat_partners(const uint8_t *colors, int32_t count, const uint8_t *palette, int32_t k,
                        float grain, const uint8_t *first, uint8_t *second);

/* Rows of a palette [H, W]. table [BINS]: first | second << 8 | level << 16. A pixel takes the second
 * where the threshold of its place, [8, 8], is below the level. Returns 0. */
int32_t tsplat_mixed(const uint8_t *image, int32_t height, int32_t width, const uint32_t *table,
                     const uint8_t *thresholds, uint8_t *rows);

/* Rows of a palette [256, 3]: the first, or that of the pixel to the left where the squared distance
 * is larger by no more than tolerance. Returns 0. */
int32_t tsplat_steady(const uint8_t *image, int32_t height, int32_t width, const uint32_t *table,
                      const uint8_t *palette, int32_t tolerance, uint8_t *rows);

/* Sixel data of a picture [H, .]. from [H] says which of the lines of rows [., W] each row of it is,
 * columns [W + 1] where each column begins and the last ends, 9999 at most. scratch [W, SCRATCH].
 * used [256]: 1 for the colours that are. Returns bytes, or TSPLAT_FULL. */
int64_t tsplat_lines(const uint8_t *rows, int32_t lines, int32_t width, const int32_t *from,
                     int32_t height, const int32_t *columns, int32_t *scratch, uint8_t *used,
                     uint8_t *out, int64_t room);
#endif
