/* Packed numbers of N Gaussians -> columns of a table of float32. Read by the compiler and by cffi alike
 * (which skips # lines). The caller owns every buffer; nothing is allocated, kept or shared, so threads may
 * call at once. */
#ifndef TSPLAT_UNPACK_H
#define TSPLAT_UNPACK_H
#include <stdint.h>

enum { TSPLAT_BYTE = 256 };

typedef struct {
    const uint8_t *from;      /* row i begins at from + i * stride, aligned or not */
    float *to;                /* and is written from to + i * width on */
    int64_t count;            /* N */
    int64_t stride, width;    /* bytes; floats */
} tsplat_columns;

/* Each of a row's first bytes by its table: tables [bytes, TSPLAT_BYTE], or [1, TSPLAT_BYTE] for all. */
void tsplat_look_up(const tsplat_columns *rows, int32_t bytes, const float *tables, int32_t one);

/* Three little-endian integers of 24 bits with a sign, times factor. */
void tsplat_fixed_24(const tsplat_columns *rows, float factor);

/* Quaternions: of a uint32, bits bits from each of shifts [3] on are a component, which values
 * [1 << bits] has; a fourth makes them one long, or is 0 if they are that already. What is left from bit
 * tag on says where in w, x, y, z the three go and then the fourth: places [1 << (32 - tag), 4]; or
 * begins with -1 there, for a quaternion of zeros. */
void tsplat_smallest_three(const tsplat_columns *rows, const int32_t *shifts, int32_t bits,
                           const double *values, int32_t tag, const int8_t *places);

/* Three parts of a uint32, bits [3] bits from shifts [3] on each, of ranges of their own: low + step * part
 * with the low and step [C, 3] of chunk chunks [N], each below C; e to that power if exponent. Where
 * wide [N, 3] is given, doubles are written there instead. */
void tsplat_in_ranges(const tsplat_columns *rows, const int32_t *shifts, const int32_t *bits,
                      const int64_t *chunks, const double *low, const double *step,
                      int32_t exponent, double *wide);
#endif
