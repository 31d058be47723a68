/* The four stages. Sorting and binning are plain C11; projecting and compositing are templates,
 * instantiated for each instruction set by the headers vec_*.h, one of which is chosen at run time.
 * Geometry is double, colour sums and pixels are float. -ffp-contract=off matters: depth must be
 * rounded as in every other backend, without FMA. */
#include "kernel.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#ifdef _OPENMP
#include <omp.h>
#endif

#include "constants.h"

/* Waking threads costs some 10 us, more on a busy machine: less work than this stays on one. */
enum { WORTH = 8192 };

enum {
    TILE = TSPLAT_TILE,
    RECORD = TSPLAT_RECORD,
    CHUNK = TSPLAT_CHUNK,
    CLUSTER = TSPLAT_CLUSTER,
    RADIX = TSPLAT_RADIX,
    FEW = 64 /* pairs that are sorted by comparing each with each */
};

int tsplat_has_openmp(void) {
#ifdef _OPENMP
    return 1;
#else
    return 0;
#endif
}

#define PREFETCH(p) __builtin_prefetch(p)

static inline int64_t min64(int64_t a, int64_t b) { return a < b ? a : b; }
static inline double min_(double a, double b) { return a < b ? a : b; }
static inline double max_(double a, double b) { return a > b ? a : b; }

/* --- what the templates share --------------------------------------------------------------- */

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
#endif
#include "tile.h"
#include "order.h"

/* The tiles of a splat: its first and its last, as column + row * 65536. */
typedef struct {
    int32_t first, last;
} box;

/* A camera and its parameters, with what follows from them alone. */
typedef struct {
    double rotation[9], centre[3], fx, fy, cx, cy, near_, far_;
    double slope_min[2], slope_max[2]; /* x/z and y/z are clamped to these for the Jacobian */
    double threshold, low_pass;
    float depth_split;
    int32_t width, height, sh_degree, antialias;
} lens;

static lens make_lens(const tsplat_camera *c, const tsplat_params *p) {
    double margin_x = CLAMP_MARGIN * c->width / (2 * c->fx);
    double margin_y = CLAMP_MARGIN * c->height / (2 * c->fy);
    lens out = {.fx = c->fx, .fy = c->fy, .cx = c->cx, .cy = c->cy, .near_ = c->near_,
                .far_ = c->far_, .width = c->width, .height = c->height,
                .slope_min = {-c->cx / c->fx - margin_x, -c->cy / c->fy - margin_y},
                .slope_max = {(c->width - c->cx) / c->fx + margin_x,
                              (c->height - c->cy) / c->fy + margin_y},
                .threshold = max_(p->alpha_threshold, ALPHA_FLOOR), .low_pass = p->low_pass,
                .depth_split = p->depth_split, .sh_degree = p->sh_degree, .antialias = p->antialias};
    memcpy(out.rotation, c->rotation, sizeof out.rotation);
    memcpy(out.centre, c->centre, sizeof out.centre);
    return out;
}

static int bad_degree(int32_t degree, int32_t coefficients) {
    return degree < 0 || degree > SH_DEGREE_MAX || (degree + 1) * (degree + 1) > coefficients;
}

static inline float half_to_float(uint16_t half) {
    uint32_t magnitude = half & 0x7fff, bits = (uint32_t)(half & 0x8000) << 16;
    float value = (float)magnitude * 0x1p-24f; /* below the normal halves */
    if (magnitude < 0x400) return bits ? -value : value;
    bits |= (magnitude << 13) + (112u << 23);
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Colour of Gaussian i as band 0 alone makes it. */
static void plain_color(const tsplat_scene *s, int64_t i, float *color) {
    int64_t at = 3 * i * s->coefficients;
    for (int c = 0; c < 3; c++) {
        float sh = s->half ? half_to_float(((const uint16_t *)s->sh)[at + c]) : ((const float *)s->sh)[at + c];
        color[c] = (float)max_(0.5f + (float)SH_C0 * sh, 0);
    }
}

/* Fetches the coefficients of packed Gaussians ahead of their use. */
static inline void fetch_sh(const tsplat_scene *s, const tsplat_packed *packed, int64_t first,
                            int64_t count) {
    int64_t bytes = 3LL * s->coefficients * (s->half ? 2 : 4);
    for (int64_t i = first; i < min64(first + count, packed->count); i++) {
        int32_t id;
        memcpy(&id, packed->columns + (i / 16 * packed->width + 11) * 16 + i % 16, sizeof id);
        for (int64_t k = 0; k < bytes; k += 64) PREFETCH((const char *)s->sh + id * bytes + k);
    }
}

/* project_group(scene, lens, first, count, out, overflowed): projects at most LANES Gaussians into
 * rows of TSPLAT_RECORD floats, as tsplat_gather reads them; returns how many are visible and adds
 * those that overflow. */
typedef int project_function(const tsplat_scene *, const lens *, int64_t, int, float *, int64_t *);

/* pack_group(splats, first, count, floor, out): the records of at most LANES splats. */
typedef void pack_function(const tsplat_splats *, int64_t, int, float, record *);

/* project_chunk(packed, scene, lens, floor, first, count, space, steps, totals): projects count
 * packed Gaussians into slots from first on and counts their boxes; returns the slots used and adds
 * to totals[0] the visible, to totals[1] the overflowed, to totals[2] the colours kept. */
typedef int chunk_function(const tsplat_packed *, const tsplat_scene *, const lens *, float, int64_t,
                           int, const tsplat_space *, int32_t *, int64_t *);

/* composite_tile(out, records, slots, ids, count, x0, y0, columns, rows): the pixels of one block
 * of columns x rows, at most TILE each, with its top left at x0, y0; whether any is open still, or -1
 * if an id is out of range. */
typedef int composite_function(const picture *, const record *, int64_t, const int32_t *, int64_t,
                               int32_t, int32_t, int32_t, int32_t);

/* sort_tile(pairs, scratch, count, ties, ids): the slots of count pairs, near to far. */
typedef void sort_function(uint64_t *, uint64_t *, int64_t, const ties *, int32_t *);

#include "vec_generic.h"
#if defined(__x86_64__) && defined(__GNUC__)
#include "vec_avx2.h"
#include "vec_avx512.h"
#endif

/* --- instruction sets ----------------------------------------------------------------------- */

typedef struct {
    int lanes;
    project_function *project_group;
    pack_function *pack_group;
    chunk_function *project_chunk;
    composite_function *composite_tile;
    sort_function *sort_tile;
} templates;

static const templates GENERIC = {4, project_group_generic, pack_group_generic,
                                  project_chunk_generic, composite_tile_generic, sort_tile_generic};
#if defined(__x86_64__) && defined(__GNUC__)
static const templates AVX2 = {8, project_group_avx2, pack_group_avx2, project_chunk_avx2,
                               composite_tile_avx2, sort_tile_avx2};
static const templates AVX512 = {16, project_group_avx512, pack_group_avx512, project_chunk_avx512,
                                 composite_tile_avx512, sort_tile_avx512};
#endif
static const templates *best = &GENERIC;

int tsplat_isas(void) {
    int found = TSPLAT_GENERIC;
#if defined(__x86_64__) && defined(__GNUC__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
        __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt") &&
        __builtin_cpu_supports("f16c"))
        found |= TSPLAT_AVX2; /* with lzcnt, which every such CPU has */
    if (found & TSPLAT_AVX2 && __builtin_cpu_supports("avx512f") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512vl"))
        found |= TSPLAT_AVX512;
#endif
    return found;
}

int tsplat_use_isa(int isa) {
    if (!(isa & tsplat_isas())) return TSPLAT_BAD_ISA;
    best = &GENERIC;
#if defined(__x86_64__) && defined(__GNUC__)
    if (isa == TSPLAT_AVX2) best = &AVX2;
    if (isa == TSPLAT_AVX512) best = &AVX512;
#endif
    return 0;
}

/* --- project -------------------------------------------------------------------------------- */

int tsplat_project(const tsplat_scene *scene, const tsplat_camera *camera,
                   const tsplat_params *params, float *scratch, int32_t *chunk_counts,
                   int64_t *totals, int threads) {
    int64_t n = scene->count, chunks = (n + CHUNK - 1) / CHUNK, visible = 0, overflowed = 0;
    if (n < 0 || n > INT32_MAX || threads < 1) return TSPLAT_BAD_SIZE;
    if (bad_degree(params->sh_degree, scene->coefficients)) return TSPLAT_BAD_SIZE;
    lens lens = make_lens(camera, params);
    int group = best->lanes;
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads) if (n > WORTH) \
    reduction(+ : visible, overflowed)
    for (int64_t c = 0; c < chunks; c++) {
        int64_t end = min64(n, (c + 1) * CHUNK);
        float *out = scratch + c * CHUNK * RECORD;
        int32_t count = 0;
        for (int64_t i = c * CHUNK; i < end; i += group)
            count += best->project_group(scene, &lens, i, (int)min64(group, end - i),
                                         out + (int64_t)count * RECORD, &overflowed);
        chunk_counts[c] = count;
        visible += count;
    }
    totals[0] = visible;
    totals[1] = overflowed;
    return 0;
}

int tsplat_gather(const float *scratch, const int32_t *chunk_counts, int64_t gaussians,
                  const tsplat_splats *splats, int threads) {
    int64_t chunks = (gaussians + CHUNK - 1) / CHUNK, total = 0;
    for (int64_t c = 0; c < chunks; c++) total += chunk_counts[c];
    if (total != splats->count || threads < 1) return TSPLAT_BAD_SIZE;
#pragma omp parallel num_threads(threads) if (total > WORTH)
    {
        int part = 0, parts = 1;
#ifdef _OPENMP
        part = omp_get_thread_num(), parts = omp_get_num_threads();
#endif
        int64_t first = chunks * part / parts, last = chunks * (part + 1) / parts, k = 0;
        for (int64_t c = 0; c < first; c++) k += chunk_counts[c];
        for (int64_t c = first; c < last; c++) {
            const float *in = scratch + c * CHUNK * RECORD;
            for (int32_t i = 0; i < chunk_counts[c]; i++, k++, in += RECORD) {
                memcpy(splats->means2d + 2 * k, in, 2 * sizeof(double));
                memcpy(splats->factors + 3 * k, in + 4, 3 * sizeof *in);
                splats->opacities[k] = in[7];
                memcpy(splats->radii + 2 * k, in + 8, 2 * sizeof *in);
                splats->depths[k] = in[10];
                memcpy(splats->colors + 3 * k, in + 11, 3 * sizeof *in);
                memcpy(splats->gaussian_ids + k, in + 14, sizeof(int32_t));
            }
        }
    }
    return 0;
}

/* --- sort ----------------------------------------------------------------------------------- */

/* Depths are positive, so their bits order as they do: a radix sort of 11 + 11 + 10 bits. Each
 * thread owns a run of the input and, by the prefix sums, its own places in the output. */
int tsplat_sort(const float *depths, int64_t count, int32_t *order, uint64_t *scratch,
                uint32_t *histograms, int threads) {
    if (count < 0 || count > INT32_MAX || threads < 1) return TSPLAT_BAD_SIZE;
    uint64_t *from = scratch, *to = scratch + count;
    for (int64_t i = 0; i < count; i++) {
        uint32_t key;
        memcpy(&key, depths + i, sizeof key);
        from[i] = (uint64_t)key << 32 | (uint32_t)i;
    }
    for (int shift = 32; shift < 64; shift += 11) {
        memset(histograms, 0, sizeof(uint32_t) * RADIX * threads);
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (count > WORTH)
        for (int t = 0; t < threads; t++) {
            uint32_t *h = histograms + (int64_t)t * RADIX;
            for (int64_t i = count * t / threads; i < count * (t + 1) / threads; i++)
                h[from[i] >> shift & (RADIX - 1)]++;
        }
        uint32_t at = 0;
        int64_t most = 0;
        for (int d = 0; d < RADIX; d++) {
            uint32_t start = at;
            for (int t = 0; t < threads; t++) {
                uint32_t *h = histograms + (int64_t)t * RADIX + d, n = *h;
                *h = at;
                at += n;
            }
            if (at - start > most) most = at - start;
        }
        if (most == count) continue; /* one digit for all: nothing to do */
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (count > WORTH)
        for (int t = 0; t < threads; t++) {
            uint32_t *h = histograms + (int64_t)t * RADIX;
            for (int64_t i = count * t / threads; i < count * (t + 1) / threads; i++)
                to[h[from[i] >> shift & (RADIX - 1)]++] = from[i];
        }
        uint64_t *swap = from;
        from = to;
        to = swap;
    }
    for (int64_t i = 0; i < count; i++) order[i] = (int32_t)(uint32_t)from[i];
    return 0;
}

/* --- bin ------------------------------------------------------------------------------------ */

/* First and last tile that hold a pixel centre within low..high (px) of a side of size pixels;
 * first > last where there is none. */
static inline void tile_span(double low, double high, int32_t size, int32_t *first, int32_t *last) {
    double from = max_(low - 0.5, 0), to = min_(high - 0.5, size - 1);
    if (!(from <= to)) {
        *first = 0, *last = -1;
        return;
    }
    int32_t pixel = (int32_t)from;
    pixel += pixel < from; /* the next centre, if not on one */
    *first = pixel / TILE;
    *last = pixel <= (int32_t)to ? (int32_t)to / TILE : -1;
}

int tsplat_bin_count(const tsplat_splats *splats, const int32_t *order, int32_t *boxes,
                     int64_t *tile_offsets, int64_t *cursors, int threads) {
    int64_t across = ((int64_t)splats->width + TILE - 1) / TILE;
    int64_t down = ((int64_t)splats->height + TILE - 1) / TILE;
    int64_t tiles = across * down, m = splats->count;
    int bad = 0;
    if (tiles < 1 || m < 0 || m > INT32_MAX || threads < 1) return TSPLAT_BAD_SIZE;
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (m > WORTH) reduction(| : bad)
    for (int t = 0; t < threads; t++) {
        int64_t *counts = cursors + t * tiles;
        memset(counts, 0, sizeof *counts * tiles);
        for (int64_t i = m * t / threads; i < m * (t + 1) / threads; i++) {
            int64_t k = order[i], ahead = order[min64(i + 24, m - 1)];
            PREFETCH(splats->means2d + 2 * ahead); /* a wrong one does no harm */
            PREFETCH(splats->radii + 2 * ahead);
            if (k < 0 || k >= m) {
                bad = 1;
                break;
            }
            double x = splats->means2d[2 * k], y = splats->means2d[2 * k + 1];
            double rx = splats->radii[2 * k], ry = splats->radii[2 * k + 1];
            int32_t *box = boxes + 4 * i;
            tile_span(x - rx, x + rx, splats->width, box, box + 2);
            tile_span(y - ry, y + ry, splats->height, box + 1, box + 3);
            for (int32_t v = box[1]; v <= box[3]; v++)
                for (int32_t u = box[0]; u <= box[2]; u++) counts[v * across + u]++;
        }
    }
    if (bad) return TSPLAT_BAD_ID;
    int64_t at = 0;
    for (int64_t k = 0; k < tiles; k++) {
        tile_offsets[k] = at;
        for (int t = 0; t < threads; t++) {
            int64_t n = cursors[t * tiles + k];
            cursors[t * tiles + k] = at;
            at += n;
        }
    }
    tile_offsets[tiles] = at;
    return 0;
}

int tsplat_bin_fill(const tsplat_splats *splats, const int32_t *order, const int32_t *boxes,
                    int64_t *cursors, int32_t *splat_ids, int threads) {
    int64_t across = ((int64_t)splats->width + TILE - 1) / TILE;
    int64_t down = ((int64_t)splats->height + TILE - 1) / TILE;
    int64_t tiles = across * down, m = splats->count;
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (m > WORTH)
    for (int t = 0; t < threads; t++) {
        int64_t *cursor = cursors + t * tiles;
        for (int64_t i = m * t / threads; i < m * (t + 1) / threads; i++) {
            const int32_t *box = boxes + 4 * i;
            for (int32_t v = box[1]; v <= box[3]; v++)
                for (int32_t u = box[0]; u <= box[2]; u++)
                    splat_ids[cursor[v * across + u]++] = order[i];
        }
    }
    return 0;
}

/* --- composite ------------------------------------------------------------------------------ */

static picture make_picture(const tsplat_params *params, int32_t width, float *rgb,
                            float *transmittance, float *depth) {
    double threshold = max_(params->alpha_threshold, ALPHA_FLOOR);
    uintptr_t rows = (uintptr_t)rgb | (uintptr_t)transmittance | (uintptr_t)width * 4;
    int stream = rows % 64 == 0 ? 64 : rows % 16 == 0 ? 16 : 0;
    return (picture){rgb, transmittance, depth, width, stream, (float)log2(threshold),
                     (float)params->transmittance_min, 0, 1};
}

int tsplat_composite(const tsplat_splats *splats, const int64_t *tile_offsets,
                     const int32_t *splat_ids, int32_t tile_size, const tsplat_params *params,
                     float *records, float *rgb, float *transmittance, float *depth, int threads) {
    int32_t width = splats->width, height = splats->height;
    if (width < 1 || height < 1 || tile_size < 1 || threads < 1) return TSPLAT_BAD_SIZE;
    int64_t across = ((int64_t)width + tile_size - 1) / tile_size, m = splats->count;
    int64_t down = ((int64_t)height + tile_size - 1) / tile_size;
    picture out = make_picture(params, width, rgb, transmittance, depth);
    if (tile_size % TILE) out.stream = 0; /* their blocks begin anywhere */
    record *packed = (record *)records;
    int bad = 0;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int64_t k = 0; k < m; k += best->lanes)
            best->pack_group(splats, k, (int)min64(best->lanes, m - k), out.floor, packed + k);
#pragma omp for schedule(dynamic, 4) reduction(| : bad)
        for (int64_t k = 0; k < across * down; k++) {
            int32_t x0 = (int32_t)(k % across) * tile_size, y0 = (int32_t)(k / across) * tile_size;
            int32_t x1 = (int32_t)min64((int64_t)x0 + tile_size, width);
            int32_t y1 = (int32_t)min64((int64_t)y0 + tile_size, height);
            const int32_t *ids = splat_ids + tile_offsets[k];
            int64_t count = tile_offsets[k + 1] - tile_offsets[k];
            for (int32_t y = y0; y < y1; y += TILE) /* one block unless the tiles are large */
                for (int32_t x = x0; x < x1; x += TILE)
                    bad |= best->composite_tile(&out, packed, m, ids, count, x, y,
                                                (int32_t)min64(TILE, x1 - x),
                                                (int32_t)min64(TILE, y1 - y)) < 0;
        }
        STREAMED();
    }
    return bad ? TSPLAT_BAD_ID : 0;
}

#include "pack.h"
#include "frame.h"
#include "upscale.h"
