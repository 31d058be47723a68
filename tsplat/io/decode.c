/* One pass over rows, each read once and written once. What ply.py, table.py, clean.py and half.py do with
 * NumPy, operation by operation, so that the bits are the same; the tests compare. */
#include "decode.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Bits of FLT_MAX / 16: clean.SH_MAX, beyond which a colour may overflow. */
enum { COEFFICIENT_MAX = 0x7d7fffff };

enum {
    MOST = 48,  /* numbers of 16 coefficients */
    AHEAD = 12  /* rows: places are fetched while others are worked on */
};

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define FETCH(p) __builtin_prefetch(p, 1)
#else
#define INLINE static inline
#define FETCH(p) ((void)(p))
#endif

/* half.py: RELATIVE and LEAST_STEP, times SLACK for what float32 sums to. */
static const float RELATIVE = (float)(0x1p-11 * (1 + 1e-5));
static const float LEAST_STEP = 0x1p-24f;

INLINE float number(const uint8_t *row, int32_t offset) {
    float value;
    memcpy(&value, row + offset, sizeof value);
    return value;
}

typedef union {
    float value[MOST];
    int32_t bits[MOST];
} numbers;

/* To nearest, ties to even; what is beyond the largest half becomes infinite. See half.py. */
INLINE void round_all(const numbers *in, uint16_t *halves, int most) {
    numbers small;
    for (int i = 0; i < most; i++) /* 0.5's last bit is the least half */
        small.value[i] = fabsf(in->value[i]) + 0.5f;
    for (int i = 0; i < most; i++) {
        int32_t size = in->bits[i] & 0x7fffffff;
        int32_t large = (size - 0x38000000 + 0xfff + (size >> 13 & 1)) >> 13;
        large = large > 0x7c00 ? 0x7c00 : large;
        int32_t half = size < 0x38800000 ? small.bits[i] - 0x3f000000 : large;
        halves[i] = (uint16_t)(half | (in->bits[i] >> 16 & 0x8000));
    }
}

/* Sums of most / 2 numbers by channel, in pairs; the largest of them. most is 6, 12 or MOST. */
#define SUM_CHANNELS(sums, most)                                  \
    do {                                                          \
        if ((most) == MOST) {                                     \
            for (int i = 0; i < 12; i++) sums[i] += sums[12 + i]; \
            for (int i = 0; i < 6; i++) sums[i] += sums[6 + i];   \
        }                                                         \
        if ((most) >= 12)                                         \
            for (int i = 0; i < 3; i++) sums[i] += sums[3 + i];   \
        sums[0] = sums[0] > sums[1] ? sums[0] : sums[1];          \
        sums[0] = sums[0] > sums[2] ? sums[0] : sums[2];          \
    } while (0)

/* What rounding has done to a channel's colour, at most. A half's distance from what it was rounded from
 * is a float. */
INLINE double exact_error(const float *values, const uint16_t *halves, const float *peaks, int most) {
    numbers wide;
    float off[MOST];
    double sums[MOST / 2];
    int beyond = 0;
    for (int i = 0; i < most; i++) {
        int32_t size = halves[i] & 0x7fff;
        float small = (float)size * 0x1p-24f; /* below the normal halves */
        wide.bits[i] = (size << 13) + (112 << 23);
        wide.value[i] = size < 0x400 ? small : wide.value[i];
        beyond |= size >= 0x7c00;
        off[i] = fabsf(wide.value[i] - fabsf(values[i]));
    }
    if (beyond) return INFINITY;
    for (int i = 0; i < most / 2; i++)
        sums[i] = (double)off[i] * peaks[i] + (double)off[most / 2 + i] * peaks[most / 2 + i];
    SUM_CHANNELS(sums, most);
    return sums[0];
}

/* The same without looking at what has been rounded: not below it. */
INLINE float quick_error(const float *values, const float *peaks, float steps, int most) {
    float sums[MOST / 2];
    for (int i = 0; i < most / 2; i++)
        sums[i] = fabsf(values[i]) * peaks[i] + fabsf(values[most / 2 + i]) * peaks[most / 2 + i];
    SUM_CHANNELS(sums, most);
    return sums[0] * RELATIVE + steps;
}

INLINE int decode_rows(const tsplat_rows *in, const tsplat_arrays *out, double *error, int coefficients) {
    const int32_t *offsets = in->offsets;
    const int count = 3 * coefficients, most = count <= 3 ? 6 : count <= 12 ? 12 : MOST;
    size_t bytes = (size_t)count * (out->half ? 2 : 4);
    float peaks[MOST] = {0}, steps = 0;
    numbers sh = {{0}};
    uint16_t halves[MOST];
    for (int i = 0; i < count; i++) peaks[i] = out->peaks[i];
    for (int i = 0; i < count; i += 3) steps += peaks[i];
    steps *= LEAST_STEP;
    int in_order = 1;
    for (int k = 0; k < count; k++)
        in_order &= offsets[TSPLAT_SHAPE + k] == offsets[TSPLAT_SHAPE] + 4 * k;
    for (int64_t i = 0; i < in->count; i++) {
        const uint8_t *row = in->rows + i * in->stride;
        int64_t at = out->places ? out->places[i] : out->first + i;
        if (at < 0 || at >= out->capacity) return TSPLAT_BAD_ROWS;
        if (out->places && i + AHEAD < in->count) {
            int64_t next = out->places[i + AHEAD];
            char *there = (char *)out->sh + next * (int64_t)bytes;
            for (size_t line = 0; line < bytes; line += 64) FETCH(there + line);
            FETCH(there + bytes - 1);
            FETCH(out->means + 3 * next);
            FETCH(out->quats + 4 * next);
            FETCH(out->scales + 3 * next);
            FETCH(out->opacities + next);
        }
        /* first, and looked at last: a vector of what was just stored one by one has to wait */
        if (in_order)
            memcpy(sh.value, row + offsets[TSPLAT_SHAPE], 4 * (size_t)count);
        else
            for (int k = 0; k < count; k++) sh.value[k] = number(row, offsets[TSPLAT_SHAPE + k]);

        float mean[3], scale[3], quat[4];
        double wide[4], sum = 0;
        int sound = 1;
        for (int k = 0; k < 3; k++) {
            mean[k] = number(row, offsets[k]);
            sound &= fabsf(mean[k]) <= FLT_MAX;
            scale[k] = number(row, offsets[7 + k]);
            if (!in->linear) scale[k] = (float)exp(scale[k]);
            sound &= scale[k] >= 0 && scale[k] <= FLT_MAX;
        }
        for (int k = 0; k < 4; k++) {
            wide[k] = number(row, offsets[3 + k]);
            sum += wide[k] * wide[k];
        }
        double length = sqrt(sum);
        sound &= length > 0 && length < INFINITY;
        for (int k = 0; k < 4; k++) quat[k] = (float)(wide[k] / length);
        double opacity = number(row, offsets[10]);
        if (!in->linear) opacity = 1 / (1 + exp(-opacity));
        sound &= opacity >= 0 && opacity <= 1;

        int32_t largest = 0;
        for (int k = 0; k < most; k++) {
            int32_t size = sh.bits[k] & 0x7fffffff;
            largest = size > largest ? size : largest;
        }
        if (!sound || largest > COEFFICIENT_MAX) return TSPLAT_UNSOUND;

        memcpy(out->means + 3 * at, mean, sizeof mean);
        memcpy(out->quats + 4 * at, quat, sizeof quat);
        memcpy(out->scales + 3 * at, scale, sizeof scale);
        out->opacities[at] = (float)opacity;
        char *there = (char *)out->sh + at * (int64_t)bytes;
        if (!out->half) {
            memcpy(there, sh.value, bytes);
            continue;
        }
        round_all(&sh, halves, most);
        memcpy(there, halves, bytes);
        double bound = quick_error(sh.value, peaks, steps, most);
        if (!(bound < out->close)) bound = exact_error(sh.value, halves, peaks, most);
        if (bound > *error) *error = bound;
    }
    return 0;
}

INLINE int decode(const tsplat_rows *in, const tsplat_arrays *out, double *error) {
    switch (in->coefficients) { /* known to the compiler, which unrolls */
        case 1: return decode_rows(in, out, error, 1);
        case 4: return decode_rows(in, out, error, 4);
        case 9: return decode_rows(in, out, error, 9);
        default: return decode_rows(in, out, error, 16);
    }
}

static int decode_plain(const tsplat_rows *in, const tsplat_arrays *out, double *error) {
    return decode(in, out, error);
}

#if defined(__x86_64__) && defined(__GNUC__)
__attribute__((target("avx2")))
static int decode_avx2(const tsplat_rows *in, const tsplat_arrays *out, double *error) {
    return decode(in, out, error);
}
#endif

int tsplat_decode(const tsplat_rows *in, const tsplat_arrays *out, double *error) {
    int32_t k = in->coefficients;
    *error = 0;
    if (in->count < 0 || (k != 1 && k != 4 && k != 9 && k != 16)) return TSPLAT_BAD_ROWS;
    for (int i = 0; i < TSPLAT_SHAPE + 3 * k; i++)
        if (in->offsets[i] < 0 || in->offsets[i] > in->stride - 4) return TSPLAT_BAD_ROWS;
#if defined(__x86_64__) && defined(__GNUC__)
    if (!in->plain && __builtin_cpu_supports("avx2")) return decode_avx2(in, out, error);
#endif
    return decode_plain(in, out, error);
}

/* Ten bits, two zeros after each. */
static inline uint32_t spread(uint32_t cell) {
    cell = (cell | cell << 16) & 0x030000ff;
    cell = (cell | cell << 8) & 0x0300f00f;
    cell = (cell | cell << 4) & 0x030c30c3;
    return (cell | cell << 2) & 0x09249249;
}

void tsplat_curve_keys(const float *means, int64_t count, const float *low, const float *scale,
                       uint64_t *keys) {
    for (int64_t i = 0; i < count; i++) {
        uint32_t code = 0;
        for (int k = 0; k < 3; k++) {
            float cell = (means[3 * i + k] - low[k]) * scale[k];
            cell = cell > 0 ? cell : 0; /* not a number: 0 too */
            cell = cell < 1023 ? cell : 1023;
            code |= spread((uint32_t)cell) << k;
        }
        keys[i] = (uint64_t)code << 32 | (uint64_t)i;
    }
}
