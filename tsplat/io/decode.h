/* Rows of Gaussians -> a scene's arrays, read by the compiler and by cffi alike (which
 * skips # lines). The caller owns every buffer; nothing is allocated, kept or shared, so threads may
 * call at once. N rows, C capacity of the arrays, K coefficients. */
#ifndef TSPLAT_DECODE_H
#define TSPLAT_DECODE_H
#include <stdint.h>

enum {
    TSPLAT_SHAPE = 11,        /* numbers of a row beside its coefficients */
    TSPLAT_UNSOUND = 1,       /* a row that cannot be drawn: nothing is said of the others */
    TSPLAT_BAD_ROWS = 2       /* a count, a place or an offset is out of range */
};

typedef struct {
    const uint8_t *rows;      /* [N, stride] */
    int64_t count, stride;    /* N; bytes of a row */
    const int32_t *offsets;   /* [TSPLAT_SHAPE + 3 K] bytes to little-endian floats of a row: mean 3,
                                 quaternion 4, log scale 3, logit; coefficient 0 of each channel, ... */
    int32_t coefficients;     /* K: 1, 4, 9 or 16 */
    int32_t linear;           /* 1: the scales are no logarithms, the opacity is no logit */
    int32_t plain;            /* 1: the instructions that every CPU of its kind has; same results */
} tsplat_rows;

typedef struct {
    const int32_t *places;    /* [N] where each row goes, or NULL: row after row from first on */
    int64_t first, capacity;  /* C */
    float *means;             /* [C, 3] */
    float *quats;             /* [C, 4] unit */
    float *scales;            /* [C, 3] */
    float *opacities;         /* [C] */
    void *sh;                 /* [C, K, 3] IEEE half if half is 1, else float */
    int32_t half;
    const float *peaks;       /* [3 K] largest size of each coefficient's basis function */
    double close;             /* a bound below this of what half does to a colour needs no closer look */
} tsplat_arrays;

/* Decodes all rows. Returns 0, TSPLAT_UNSOUND or TSPLAT_BAD_ROWS; *error is a bound of what half does
 * to a colour. */
int tsplat_decode(const tsplat_rows *rows, const tsplat_arrays *arrays, double *error);

/* Where means [N, 3] are along the curve: curve_keys of core/curve.py. low, scale [3]; keys [N]. */
void tsplat_curve_keys(const float *means, int64_t count, const float *low, const float *scale,
                       uint64_t *keys);
#endif
