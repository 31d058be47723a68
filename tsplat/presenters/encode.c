/* What dither.py and sixel.py do with NumPy, to the same bits; the tests compare. Whole numbers
 * but for a frame's values, the spread of a group and the cost of a mixture; of those the operations
 * are in NumPy's order, and nothing is contracted (setup.py). */
#include "encode.h"

#include <stddef.h>
#include <string.h>

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

#if defined(__x86_64__) && defined(__GNUC__)
#define FAST __attribute__((target("avx2")))
#define HAS_FAST __builtin_cpu_supports("avx2")
#endif

enum { BAND = 6, EMPTY = 0x3f, SPELLED = 3, COLUMNS = 9999 };

INLINE void to_levels(const float *values, int64_t n, uint8_t *out) {
    for (int64_t i = 0; i < n; i++) {
        float value = values[i] > 0 ? values[i] : 0;
        value = value < 1 ? value : 1;
        out[i] = (uint8_t)(int32_t)(value * 255 + 0.5f);
    }
}

#ifdef FAST
FAST static void levels_fast(const float *values, int64_t n, uint8_t *out) {
    to_levels(values, n, out);
}
#endif

void tsplat_levels(const float *values, int64_t n, uint8_t *out) {
#ifdef FAST
    if (HAS_FAST) {
        levels_fast(values, n, out);
        return;
    }
#endif
    to_levels(values, n, out);
}

INLINE int32_t bin_of(const uint8_t *pixel) {
    return pixel[0] >> 3 << 10 | pixel[1] >> 3 << 5 | pixel[2] >> 3;
}

int32_t tsplat_distinct(const uint8_t *image, int64_t n, int32_t *bins, uint8_t *colors,
                        int64_t *counts, int64_t *sums) {
    memset(sums, 0, sizeof *sums * 4 * TSPLAT_BINS);
    for (int64_t i = 0; i < n; i++, image += 3) {
        int64_t *sum = sums + 4 * bin_of(image);
        for (int c = 0; c < 3; c++) sum[c] += image[c];
        sum[3]++;
    }
    int32_t used = 0;
    for (int32_t bin = 0; bin < TSPLAT_BINS; bin++) {
        const int64_t *sum = sums + 4 * bin;
        if (!sum[3]) continue;
        for (int c = 0; c < 3; c++)
            colors[3 * used + c] = (uint8_t)((2 * sum[c] + sum[3]) / (2 * sum[3]));
        counts[used] = sum[3];
        bins[used++] = bin;
    }
    return used;
}

/* --- a palette */

typedef struct {
    int64_t weight, sum[3], square[3];
} moments;

/* Adds count pixels of a colour to a group; with a negative count, takes them away. */
INLINE void add(const uint8_t *color, int64_t count, moments *m) {
    m->weight += count;
    for (int c = 0; c < 3; c++) {
        int64_t sum = count * color[c];
        m->sum[c] += sum;
        m->square[c] += sum * color[c];
    }
}

static void gather(const uint8_t *colors, const int64_t *counts, int32_t count,
                   const uint8_t *groups, moments *of) {
    memset(of, 0, sizeof *of * TSPLAT_PALETTE);
    for (int32_t i = 0; i < count; i++) add(colors + 3 * i, counts[i], of + groups[i]);
}

/* The colour of a group, to the nearest; black where it has none. */
static void round_mean(const moments *m, uint8_t *color) {
    for (int c = 0; c < 3; c++)
        color[c] = m->weight ? (uint8_t)((2 * m->sum[c] + m->weight) / (2 * m->weight)) : 0;
}

int32_t tsplat_adaptive_palette(const uint8_t *colors, const int64_t *counts, int32_t count,
                                int32_t most, uint8_t *groups, double *palette) {
    moments of[TSPLAT_PALETTE];
    uint8_t middle[3 * TSPLAT_PALETTE];
    int32_t n = 1;
    if (count < 1 || most < 1 || most > TSPLAT_PALETTE) return TSPLAT_REFUSED;
    memset(groups, 0, (size_t)count);
    gather(colors, counts, count, groups, of);
    while (n < most) {
        double widest[TSPLAT_PALETTE];
        int axis[TSPLAT_PALETTE], into[TSPLAT_PALETTE], splits = 0;
        int64_t weight[TSPLAT_PALETTE], sum[TSPLAT_PALETTE]; /* before any colour moves */
        for (int g = 0; g < n; g++) {
            into[g] = -1;
            axis[g] = 0;
            for (int c = 0; c < 3; c++) {
                double total = (double)of[g].sum[c];
                double pixels = (double)(of[g].weight ? of[g].weight : 1);
                double spread = (double)of[g].square[c] - total * total / pixels;
                if (!c || spread > widest[g]) {
                    widest[g] = spread;
                    axis[g] = c;
                }
            }
        }
        int limit = most - n < (n + 1) / 2 ? most - n : (n + 1) / 2;
        while (splits < limit) { /* the widest, of equal ones the first */
            int best = -1;
            for (int g = 0; g < n; g++)
                if (into[g] < 0 && (best < 0 || widest[g] > widest[best])) best = g;
            if (best < 0 || widest[best] < 0.25) break;
            into[best] = n + splits++;
        }
        if (!splits) break;
        for (int g = 0; g < n; g++) {
            weight[g] = of[g].weight;
            sum[g] = of[g].sum[axis[g]];
        }
        for (int32_t i = 0; i < count; i++) {
            const uint8_t *color = colors + 3 * i;
            int g = groups[i];
            if (into[g] < 0 || color[axis[g]] * weight[g] <= sum[g]) continue;
            groups[i] = (uint8_t)into[g];
            add(color, -counts[i], of + g);
            add(color, counts[i], of + into[g]);
        }
        n += splits;
    }
    for (int g = 0; g < n; g++) {
        round_mean(of + g, middle + 3 * g);
        for (int c = 0; c < 3; c++)
            palette[3 * g + c] =
                (double)of[g].sum[c] / (double)(of[g].weight ? of[g].weight : 1);
    }
    tsplat_nearest(colors, count, middle, n, groups);
    gather(colors, counts, count, groups, of);
    for (int g = 0; g < n; g++)
        for (int c = 0; c < 3 && of[g].weight; c++)
            palette[3 * g + c] = (double)of[g].sum[c] / (double)of[g].weight;
    return n;
}

/* --- pairs of colours. Sums of products of bytes are exact in floats: below 2^24 */

typedef struct {
    float r[TSPLAT_PALETTE], g[TSPLAT_PALETTE], b[TSPLAT_PALETTE], size[TSPLAT_PALETTE];
} planes;

static void to_planes(const uint8_t *palette, int32_t k, planes *to) {
    for (int32_t i = 0; i < k; i++) {
        const uint8_t *color = palette + 3 * i;
        to->r[i] = color[0], to->g[i] = color[1], to->b[i] = color[2];
        to->size[i] = (float)(color[0] * color[0] + color[1] * color[1] + color[2] * color[2]);
    }
}

INLINE void nearest(const uint8_t *colors, int32_t count, const planes *p, int32_t k,
                    uint8_t *first) {
    for (int32_t i = 0; i < count; i++, colors += 3) {
        float r = 2 * colors[0], g = 2 * colors[1], b = 2 * colors[2];
        int32_t least = INT32_MAX;
        for (int32_t j = 0; j < k; j++) { /* the row below the distance: of equal ones the first */
            int32_t key = (int32_t)(p->size[j] - r * p->r[j] - g * p->g[j] - b * p->b[j]) * 256 + j;
            least = key < least ? key : least;
        }
        first[i] = (uint8_t)least;
    }
}

INLINE void partners(const uint8_t *colors, int32_t count, const planes *p, int32_t k, float grain,
                     const uint8_t *first, uint8_t *second) {
    const float linear = grain, square = 1 + grain;
    for (int32_t i = 0; i < count; i++, colors += 3) {
        int32_t o = first[i];
        float r0 = p->r[o], g0 = p->g[o], b0 = p->b[o];
        float er = colors[0] - r0, eg = colors[1] - g0, eb = colors[2] - b0;
        int32_t gains[TSPLAT_PALETTE] = {0}, most = 0;
        for (int32_t j = 0; j < k; j++) {
            float r = p->r[j] - r0, g = p->g[j] - g0, b = p->b[j] - b0;
            float a = er * r + eg * g + eb * b, l = r * r + g * g + b * b;
            float inside = square * (a * a / (l > 0 ? l : 1)) - linear * a;
            float gain = a >= l ? 2 * a - l : inside;
            gain = a > 0 ? gain : 0;
            gain = gain > 0 ? gain : 0;
            memcpy(gains + j, &gain, sizeof gain); /* floats from 0 on are in order as numbers, too */
            most = gains[j] > most ? gains[j] : most;
        }
        int32_t j = 0;
        while (j < k - 1 && gains[j] != most) j++;
        second[i] = (uint8_t)(most > 0 ? j : o);
    }
}

#ifdef FAST
FAST static void nearest_fast(const uint8_t *colors, int32_t count, const planes *p, int32_t k,
                              uint8_t *first) {
    nearest(colors, count, p, k, first);
}
FAST static void partners_fast(const uint8_t *colors, int32_t count, const planes *p, int32_t k,
                               float grain, const uint8_t *first, uint8_t *second) {
    partners(colors, count, p, k, grain, first, second);
}
#endif

int32_t tsplat_nearest(const uint8_t *colors, int32_t count, const uint8_t *palette, int32_t k,
                       uint8_t *first) {
    planes p;
    if (count < 0 || k < 1 || k > TSPLAT_PALETTE) return TSPLAT_REFUSED;
    to_planes(palette, k, &p);
#ifdef FAST
    if (HAS_FAST) return nearest_fast(colors, count, &p, k, first), count;
#endif
    return nearest(colors, count, &p, k, first), count;
}

int32_t tsplat_partners(const uint8_t *colors, int32_t count, const uint8_t *palette, int32_t k,
                        float grain, const uint8_t *first, uint8_t *second) {
    planes p;
    if (count < 0 || k < 1 || k > TSPLAT_PALETTE || !(grain >= 0)) return TSPLAT_REFUSED;
    for (int32_t i = 0; i < count; i++)
        if (first[i] >= k) return TSPLAT_REFUSED;
    to_planes(palette, k, &p);
#ifdef FAST
    if (HAS_FAST) return partners_fast(colors, count, &p, k, grain, first, second), count;
#endif
    return partners(colors, count, &p, k, grain, first, second), count;
}

/* --- pixels */

int32_t tsplat_mixed(const uint8_t *image, int32_t height, int32_t width, const uint32_t *table,
                     const uint8_t *thresholds, uint8_t *rows) {
    if (height < 0 || width < 0) return TSPLAT_REFUSED;
    for (int32_t y = 0; y < height; y++) {
        const uint8_t *line = thresholds + y % TSPLAT_SIDE * TSPLAT_SIDE;
        for (int32_t x = 0; x < width; x++, image += 3) {
            uint32_t entry = table[bin_of(image)];
            *rows++ = (uint8_t)(line[x % TSPLAT_SIDE] < entry >> 16 ? entry >> 8 : entry);
        }
    }
    return 0;
}

INLINE int32_t distance(const uint8_t *a, const uint8_t *b) {
    int32_t r = a[0] - b[0], g = a[1] - b[1], c = a[2] - b[2];
    return r * r + g * g + c * c;
}

int32_t tsplat_steady(const uint8_t *image, int32_t height, int32_t width, const uint32_t *table,
                      const uint8_t *palette, int32_t tolerance, uint8_t *rows) {
    if (height < 0 || width < 0) return TSPLAT_REFUSED;
    for (int32_t y = 0; y < height; y++) {
        int32_t left = -1;
        for (int32_t x = 0; x < width; x++, image += 3) {
            int32_t row = (int32_t)(table[bin_of(image)] & 255);
            if (left >= 0 && left != row &&
                distance(image, palette + 3 * left) <= distance(image, palette + 3 * row) + tolerance)
                row = left;
            *rows++ = (uint8_t)row;
            left = row;
        }
    }
    return 0;
}

/* --- sixels */

typedef struct {
    int32_t column, width, bits, next;
} run; /* of a line: neighbours with the same character */

INLINE uint8_t *put_number(uint8_t *out, int32_t n) {
    if (n >= 1000) *out++ = (uint8_t)('0' + n / 1000 % 10);
    if (n >= 100) *out++ = (uint8_t)('0' + n / 100 % 10);
    if (n >= 10) *out++ = (uint8_t)('0' + n / 10 % 10);
    *out++ = (uint8_t)('0' + n % 10);
    return out;
}

INLINE uint8_t *put_run(uint8_t *out, int32_t n, int32_t bits) {
    uint8_t character = (uint8_t)(EMPTY + bits);
    if (n > SPELLED) {
        *out++ = '!';
        out = put_number(out, n);
        n = 1;
    }
    while (n-- > 0) *out++ = character;
    return out;
}

/* A band's runs, column by column; first and last [256] of each colour, -1 for none. Returns how many
 * colours there are, in the order of their first columns, and of their numbers. */
INLINE int32_t find_runs(const uint8_t *const band[BAND], int32_t high, int32_t width, run *runs,
                         int32_t *first, int32_t *colors) {
    int32_t last[TSPLAT_PALETTE], seen[TSPLAT_PALETTE], bits[TSPLAT_PALETTE], here[BAND];
    int32_t used = 0, count = 0, n = 0;
    for (int i = 0; i < TSPLAT_PALETTE; i++) first[i] = last[i] = seen[i] = -1;
    for (int32_t x = 0; x < width; x++) {
        int same = x > 0;
        for (int32_t y = 0; y < high && same; y++) same = band[y][x] == band[y][x - 1];
        if (same) { /* as the column to the left: its runs go on */
            for (int32_t i = 0; i < n; i++) runs[last[here[i]]].width++;
            continue;
        }
        n = 0;
        for (int32_t y = 0; y < high; y++) {
            int32_t c = band[y][x];
            if (seen[c] != x) {
                seen[c] = x;
                bits[c] = 0;
                here[n++] = c;
            }
            bits[c] |= 1 << y;
        }
        for (int32_t i = 0; i < n; i++) {
            int32_t c = here[i], before = last[c];
            run *r = before < 0 ? NULL : runs + before;
            if (r && r->bits == bits[c] && r->column + r->width == x) {
                r->width++;
                continue;
            }
            runs[count] = (run){x, 1, bits[c], -1};
            if (r) {
                r->next = count;
            } else {
                int32_t at = used++;
                first[c] = count;
                while (at && runs[first[colors[at - 1]]].column == x && colors[at - 1] > c) {
                    colors[at] = colors[at - 1];
                    at--;
                }
                colors[at] = c;
            }
            last[c] = count++;
        }
    }
    return used;
}

int64_t tsplat_lines(const uint8_t *rows, int32_t lines, int32_t width, const int32_t *from,
                     int32_t height, const int32_t *columns, int32_t *scratch, uint8_t *used,
                     uint8_t *out, int64_t room) {
    enum { MOST = 5 + 6 + 6 }; /* -#255 !9999? !9999~ */
    const uint8_t *begin = out, *end = out + room;
    run *runs = (run *)scratch;
    int32_t first[TSPLAT_PALETTE], colors[TSPLAT_PALETTE];
    if (width < 1 || height < 1 || columns[0] != 0 || columns[width] > COLUMNS) return TSPLAT_REFUSED;
    for (int32_t x = 0; x < width; x++)
        if (columns[x] >= columns[x + 1]) return TSPLAT_REFUSED;
    for (int32_t y = 0; y < height; y++)
        if (from[y] < 0 || from[y] >= lines) return TSPLAT_REFUSED;
    memset(used, 0, TSPLAT_PALETTE);
    for (int32_t top = 0; top < height; top += BAND) {
        const uint8_t *band[BAND];
        int32_t high = height - top < BAND ? height - top : BAND;
        for (int32_t y = 0; y < high; y++) band[y] = rows + (int64_t)from[top + y] * width;
        int32_t left = find_runs(band, high, width, runs, first, colors);
        for (int32_t i = 0; i < left; i++) used[colors[i]] = 1;
        int separator = top ? '-' : 0;
        while (left) { /* once over the band: each time the first colour that begins further on */
            int32_t at = 0, kept = 0;
            for (int32_t i = 0; i < left; i++) {
                int32_t color = colors[i], r = first[color];
                if (columns[runs[r].column] < at) {
                    colors[kept++] = color;
                    continue;
                }
                if (end - out < 5) return TSPLAT_FULL;
                if (separator) *out++ = (uint8_t)separator;
                separator = 0;
                *out++ = '#';
                out = put_number(out, color);
                for (; r >= 0; r = runs[r].next) {
                    int32_t a = columns[runs[r].column];
                    int32_t b = columns[runs[r].column + runs[r].width];
                    if (end - out < MOST) return TSPLAT_FULL;
                    out = put_run(out, a - at, 0);
                    out = put_run(out, b - a, runs[r].bits);
                    at = b;
                }
            }
            left = kept;
            separator = '$';
        }
    }
    return out - begin;
}
