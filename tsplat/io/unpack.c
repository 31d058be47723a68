/* One pass over the rows each. What unpack.py does with NumPy, operation by operation, so that the bits are
 * the same; the tests compare. */
#include "unpack.h"

#include <math.h>
#include <string.h>

static inline uint32_t word(const uint8_t *row) {
    return row[0] | (uint32_t)row[1] << 8 | (uint32_t)row[2] << 16 | (uint32_t)row[3] << 24;
}

void tsplat_look_up(const tsplat_columns *rows, int32_t bytes, const float *tables, int32_t one) {
    const uint8_t *from = rows->from;
    float *to = rows->to;
    int32_t next = one ? 0 : TSPLAT_BYTE;
    for (int64_t i = 0; i < rows->count; i++, from += rows->stride, to += rows->width) {
        const float *table = tables;
        for (int32_t k = 0; k < bytes; k++, table += next) to[k] = table[from[k]];
    }
}

void tsplat_fixed_24(const tsplat_columns *rows, float factor) {
    const uint8_t *from = rows->from;
    float *to = rows->to;
    for (int64_t i = 0; i < rows->count; i++, from += rows->stride, to += rows->width)
        for (int k = 0; k < 3; k++) {
            int32_t size = from[3 * k] | from[3 * k + 1] << 8 | from[3 * k + 2] << 16;
            to[k] = (float)((size ^ 0x800000) - 0x800000) * factor;
        }
}

void tsplat_smallest_three(const tsplat_columns *rows, const int32_t *shifts, int32_t bits,
                           const double *values, int32_t tag, const int8_t *places) {
    const uint8_t *from = rows->from;
    float *to = rows->to;
    uint32_t mask = (1u << bits) - 1;
    for (int64_t i = 0; i < rows->count; i++, from += rows->stride, to += rows->width) {
        uint32_t packed = word(from);
        const int8_t *place = places + 4 * (int64_t)(packed >> tag);
        double parts[3], sum = 0;
        for (int k = 0; k < 3; k++) {
            parts[k] = values[packed >> shifts[k] & mask];
            sum += parts[k] * parts[k];
        }
        if (place[0] < 0) {
            memset(to, 0, 4 * sizeof *to);
            continue;
        }
        for (int k = 0; k < 3; k++) to[place[k]] = (float)parts[k];
        to[place[3]] = (float)sqrt(sum < 1 ? 1 - sum : 0);
    }
}

void tsplat_in_ranges(const tsplat_columns *rows, const int32_t *shifts, const int32_t *bits,
                      const int64_t *chunks, const double *low, const double *step,
                      int32_t exponent, double *wide) {
    const uint8_t *from = rows->from;
    float *to = rows->to;
    for (int64_t i = 0; i < rows->count; i++, from += rows->stride, to += rows->width) {
        uint32_t packed = word(from);
        int64_t chunk = 3 * chunks[i];
        for (int k = 0; k < 3; k++) {
            uint32_t part = packed >> shifts[k] & ((1u << bits[k]) - 1);
            double value = part * step[chunk + k] + low[chunk + k];
            if (exponent) value = exp(value);
            if (wide)
                wide[3 * i + k] = value;
            else
                to[k] = (float)value;
        }
    }
}
