/* The four stages in portable C11. Geometry is double, colour sums and pixels are float.
 * -ffp-contract=off matters: depth must be rounded as in every other backend, without FMA. */
#include "kernel.h"

#include <math.h>
#include <string.h>
#ifdef _OPENMP
#include <omp.h>
#endif

#include "constants.h"

/* Waking threads costs some 10 us, more on a busy machine: less work than this stays on one. */
enum { WORTH = 8192 };

enum { TILE = TSPLAT_TILE, RECORD = TSPLAT_RECORD, CHUNK = TSPLAT_CHUNK, RADIX = TSPLAT_RADIX };

int tsplat_has_openmp(void) {
#ifdef _OPENMP
    return 1;
#else
    return 0;
#endif
}

static inline int64_t min64(int64_t a, int64_t b) { return a < b ? a : b; }
static inline double min_(double a, double b) { return a < b ? a : b; }
static inline double max_(double a, double b) { return a > b ? a : b; }
static inline double clamp(double v, double low, double high) { return max_(low, min_(v, high)); }

/* --- project -------------------------------------------------------------------------------- */

/* Colour of one Gaussian seen along the unit direction x, y, z; see reference.sh_basis. */
static void sh_color(const float *sh, int degree, double x, double y, double z, float *color) {
    double basis[16];
    int terms = (degree + 1) * (degree + 1);
    basis[0] = SH_C0;
    if (degree >= 1) {
        basis[1] = -SH_C1 * y;
        basis[2] = SH_C1 * z;
        basis[3] = -SH_C1 * x;
    }
    if (degree >= 2) {
        double xx = x * x, yy = y * y, zz = z * z;
        basis[4] = SH_C2_0 * (x * y);
        basis[5] = SH_C2_1 * (y * z);
        basis[6] = SH_C2_2 * (2 * zz - xx - yy);
        basis[7] = SH_C2_3 * (x * z);
        basis[8] = SH_C2_4 * (xx - yy);
        if (degree >= 3) {
            basis[9] = SH_C3_0 * y * (3 * xx - yy);
            basis[10] = SH_C3_1 * (x * y) * z;
            basis[11] = SH_C3_2 * y * (4 * zz - xx - yy);
            basis[12] = SH_C3_3 * z * (2 * zz - 3 * xx - 3 * yy);
            basis[13] = SH_C3_4 * x * (4 * zz - xx - yy);
            basis[14] = SH_C3_5 * z * (xx - yy);
            basis[15] = SH_C3_6 * x * (xx - 3 * yy);
        }
    }
    double r = 0.5, g = 0.5, b = 0.5;
    for (int k = 0; k < terms; k++) {
        r += basis[k] * sh[3 * k];
        g += basis[k] * sh[3 * k + 1];
        b += basis[k] * sh[3 * k + 2];
    }
    color[0] = (float)max_(r, 0);
    color[1] = (float)max_(g, 0);
    color[2] = (float)max_(b, 0);
}

/* One Gaussian -> one record of TSPLAT_RECORD floats, the fields of tsplat_splats in order.
 * Returns 1 if it is visible, 0 if not, -1 if it overflows. */
static int project_one(const tsplat_scene *s, const tsplat_camera *cam, const tsplat_params *p,
                       double threshold, int64_t i, float *out) {
    const double *R = cam->rotation;
    const float *m = s->means + 3 * i, *q = s->quats + 4 * i, *scale = s->scales + 3 * i;
    double opacity = s->opacities[i];
    double dx = m[0] - cam->centre[0], dy = m[1] - cam->centre[1], dz = m[2] - cam->centre[2];
    double pz = (R[6] * dx + R[7] * dy) + R[8] * dz;
    if (!(pz > cam->near_ && pz < cam->far_ && opacity >= threshold)) return 0;
    double px = (R[0] * dx + R[1] * dy) + R[2] * dz;
    double py = (R[3] * dx + R[4] * dy) + R[5] * dz;
    double slope_x = px / pz, slope_y = py / pz;
    double mean_x = cam->fx * slope_x + cam->cx, mean_y = cam->fy * slope_y + cam->cy;

    /* The Jacobian's slopes are held near the picture; see reference._project_rows. */
    double margin_x = CLAMP_MARGIN * cam->width / (2 * cam->fx);
    double margin_y = CLAMP_MARGIN * cam->height / (2 * cam->fy);
    double u = clamp(slope_x, -cam->cx / cam->fx - margin_x,
                     (cam->width - cam->cx) / cam->fx + margin_x);
    double v = clamp(slope_y, -cam->cy / cam->fy - margin_y,
                     (cam->height - cam->cy) / cam->fy + margin_y);

    double qw = q[0], qx = q[1], qy = q[2], qz = q[3];
    double turn[9] = {
        1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy),
        2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx),
        2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)};
    double a1[3], a2[3];
    for (int k = 0; k < 3; k++) {
        double x = (R[0] * turn[k] + R[1] * turn[3 + k] + R[2] * turn[6 + k]) * scale[k];
        double y = (R[3] * turn[k] + R[4] * turn[3 + k] + R[5] * turn[6 + k]) * scale[k];
        double z = (R[6] * turn[k] + R[7] * turn[3 + k] + R[8] * turn[6 + k]) * scale[k];
        a1[k] = cam->fx / pz * (x - u * z);
        a2[k] = cam->fy / pz * (y - v * z);
    }
    double xx = a1[0] * a1[0] + a1[1] * a1[1] + a1[2] * a1[2];
    double yy = a2[0] * a2[0] + a2[1] * a2[1] + a2[2] * a2[2];
    double xy = a1[0] * a2[0] + a1[1] * a2[1] + a1[2] * a2[2];
    double c0 = a1[1] * a2[2] - a1[2] * a2[1], c1 = a1[2] * a2[0] - a1[0] * a2[2],
           c2 = a1[0] * a2[1] - a1[1] * a2[0];
    if (!(xx + yy <= VARIANCE_MAX && fabs(mean_x) <= OFFSCREEN_MAX && fabs(mean_y) <= OFFSCREEN_MAX))
        return -1;
    double det_sharp = c0 * c0 + c1 * c1 + c2 * c2;
    double det = det_sharp + EPS2D * (xx + yy) + EPS2D * EPS2D;
    if (p->antialias) opacity *= sqrt(det_sharp / det);
    if (!(opacity >= threshold)) return 0;
    double var_x = xx + EPS2D, var_y = yy + EPS2D;
    double reach = 2 * log(opacity / threshold);
    double radius_x = sqrt(reach * var_x) * (1 + RADIUS_SLACK) + RADIUS_PAD;
    double radius_y = sqrt(reach * var_y) * (1 + RADIUS_SLACK) + RADIUS_PAD;
    if (!(mean_x + radius_x >= 0.5 && mean_x - radius_x <= cam->width - 0.5 &&
          mean_y + radius_y >= 0.5 && mean_y - radius_y <= cam->height - 0.5))
        return 0;

    out[0] = (float)mean_x;
    out[1] = (float)mean_y;
    out[2] = (float)sqrt(var_y / det);
    out[3] = (float)(-xy / sqrt(var_y * det));
    out[4] = (float)(1 / sqrt(var_y));
    out[5] = (float)pz;
    out[6] = (float)opacity;
    double inv = 1 / sqrt(dx * dx + dy * dy + dz * dz);
    sh_color(s->sh + 3 * i * s->coefficients, p->sh_degree, dx * inv, dy * inv, dz * inv, out + 7);
    out[10] = (float)radius_x;
    out[11] = (float)radius_y;
    int32_t id = (int32_t)i;
    memcpy(out + 12, &id, sizeof id);
    return 1;
}

int tsplat_project(const tsplat_scene *scene, const tsplat_camera *camera,
                   const tsplat_params *params, float *scratch, int32_t *chunk_counts,
                   int64_t *totals, int threads) {
    int64_t n = scene->count, chunks = (n + CHUNK - 1) / CHUNK, visible = 0, overflowed = 0;
    if (n < 0 || n > INT32_MAX || threads < 1) return TSPLAT_BAD_SIZE;
    if ((params->sh_degree + 1) * (params->sh_degree + 1) > scene->coefficients)
        return TSPLAT_BAD_SIZE;
    double threshold = max_(params->alpha_threshold, ALPHA_FLOOR);
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads) if (n > WORTH) \
    reduction(+ : visible, overflowed)
    for (int64_t c = 0; c < chunks; c++) {
        int64_t end = min64(n, (c + 1) * CHUNK);
        float *out = scratch + c * CHUNK * RECORD;
        int32_t count = 0;
        for (int64_t i = c * CHUNK; i < end; i++) {
            int seen = project_one(scene, camera, params, threshold, i, out + (int64_t)count * RECORD);
            count += seen > 0;
            overflowed += seen < 0;
        }
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
                memcpy(splats->means2d + 2 * k, in, 2 * sizeof *in);
                memcpy(splats->factors + 3 * k, in + 2, 3 * sizeof *in);
                splats->depths[k] = in[5];
                splats->opacities[k] = in[6];
                memcpy(splats->colors + 3 * k, in + 7, 3 * sizeof *in);
                memcpy(splats->radii + 2 * k, in + 10, 2 * sizeof *in);
                memcpy(splats->gaussian_ids + k, in + 12, sizeof(int32_t));
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

typedef struct { int32_t x0, y0, x1, y1; } box; /* inclusive; empty where x0 > x1 */

/* Tiles whose pixel centres the splat's box holds. */
static inline box tile_box(const tsplat_splats *s, int32_t k) {
    double mx = s->means2d[2 * (int64_t)k], my = s->means2d[2 * (int64_t)k + 1];
    double rx = s->radii[2 * (int64_t)k], ry = s->radii[2 * (int64_t)k + 1];
    double x0 = max_(ceil(mx - rx - 0.5), 0), x1 = min_(floor(mx + rx - 0.5), s->width - 1);
    double y0 = max_(ceil(my - ry - 0.5), 0), y1 = min_(floor(my + ry - 0.5), s->height - 1);
    if (!(x0 <= x1 && y0 <= y1)) return (box){0, 0, -1, -1};
    return (box){(int32_t)x0 / TILE, (int32_t)y0 / TILE, (int32_t)x1 / TILE, (int32_t)y1 / TILE};
}

int tsplat_bin_count(const tsplat_splats *splats, const int32_t *order, int64_t *tile_offsets,
                     int64_t *cursors, int threads) {
    int64_t across = (splats->width + TILE - 1) / TILE, down = (splats->height + TILE - 1) / TILE;
    int64_t tiles = across * down, m = splats->count;
    int bad = 0;
    if (tiles < 1 || m < 0 || m > INT32_MAX || threads < 1) return TSPLAT_BAD_SIZE;
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (m > WORTH) reduction(| : bad)
    for (int t = 0; t < threads; t++) {
        int64_t *counts = cursors + t * tiles;
        memset(counts, 0, sizeof *counts * tiles);
        for (int64_t i = m * t / threads; i < m * (t + 1) / threads; i++) {
            if (order[i] < 0 || order[i] >= m) {
                bad = 1;
                break;
            }
            box b = tile_box(splats, order[i]);
            for (int32_t y = b.y0; y <= b.y1; y++)
                for (int32_t x = b.x0; x <= b.x1; x++) counts[y * across + x]++;
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

int tsplat_bin_fill(const tsplat_splats *splats, const int32_t *order, int64_t *cursors,
                    int32_t *splat_ids, int threads) {
    int64_t across = (splats->width + TILE - 1) / TILE, down = (splats->height + TILE - 1) / TILE;
    int64_t tiles = across * down, m = splats->count;
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (m > WORTH)
    for (int t = 0; t < threads; t++) {
        int64_t *cursor = cursors + t * tiles;
        for (int64_t i = m * t / threads; i < m * (t + 1) / threads; i++) {
            box b = tile_box(splats, order[i]);
            for (int32_t y = b.y0; y <= b.y1; y++)
                for (int32_t x = b.x0; x <= b.x1; x++) splat_ids[cursor[y * across + x]++] = order[i];
        }
    }
    return 0;
}

/* --- composite ------------------------------------------------------------------------------ */

/* exp(-sigma) for sigma >= 0, within 2e-7 relative where alpha can matter (sigma < 6); 0 from 87
 * on, so nothing is denormal. exp = 2^n * 2^f with f in [-1/2, 1/2]. */
static inline float exp_minus(float sigma) {
    float x = sigma * -1.44269504f;
    x = x > -126.0f ? x : -126.0f;
    float shifted = x + 12582912.0f; /* 1.5 * 2^23: rounds to the nearest integer */
    float n = shifted - 12582912.0f, f = x - n;
    float e = (float)EXP2_POLY_6;
    e = e * f + (float)EXP2_POLY_5;
    e = e * f + (float)EXP2_POLY_4;
    e = e * f + (float)EXP2_POLY_3;
    e = e * f + (float)EXP2_POLY_2;
    e = e * f + (float)EXP2_POLY_1;
    e = e * f + (float)EXP2_POLY_0;
    int32_t bits = ((int32_t)n + 127) << 23;
    float power;
    memcpy(&power, &bits, sizeof power);
    return sigma < 87.0f ? e * power : 0.0f;
}

typedef struct {
    float r[TILE][TILE], g[TILE][TILE], b[TILE][TILE], z[TILE][TILE];
    float t[TILE][TILE];     /* transmittance while the pixel is open, 0 once it has stopped */
    float final[TILE][TILE]; /* transmittance after the last splat drawn */
} tile_state;

static inline int32_t span_first(float mean, float radius, int32_t origin) {
    float first = ceilf(mean - radius - 0.5f) - (float)origin;
    return first > 0 ? (int32_t)min_(first, TILE) : 0;
}

static inline int32_t span_last(float mean, float radius, int32_t origin) {
    float last = floorf(mean + radius - 0.5f) - (float)origin;
    return last < TILE - 1 ? (int32_t)max_(last, -1) : TILE - 1;
}

/* Draws splat k on one tile, whose top left pixel is x0, y0. A row is always TILE lanes wide. */
static void draw(const tsplat_splats *s, int32_t k, int32_t x0, int32_t y0, float threshold,
                 float stop, int want_depth, tile_state *tile) {
    const float *mean = s->means2d + 2 * (int64_t)k, *u = s->factors + 3 * (int64_t)k;
    const float *color = s->colors + 3 * (int64_t)k, *radius = s->radii + 2 * (int64_t)k;
    float opacity = s->opacities[k], z = s->depths[k];
    int32_t first = span_first(mean[1], radius[1], y0), last = span_last(mean[1], radius[1], y0);
    float dx[TILE];
    for (int x = 0; x < TILE; x++) dx[x] = (float)(x0 + x) + 0.5f - mean[0];
    for (int32_t y = first; y <= last; y++) {
        float dy = (float)(y0 + y) + 0.5f - mean[1];
        float skew = u[1] * dy, v = u[2] * dy, base = v * v;
        float *t = tile->t[y], *final = tile->final[y];
        float weight[TILE];
        for (int x = 0; x < TILE; x++) {
            float w = u[0] * dx[x] + skew;
            float alpha = opacity * exp_minus(0.5f * (w * w + base));
            alpha = alpha < (float)ALPHA_MAX ? alpha : (float)ALPHA_MAX;
            alpha = alpha >= threshold ? alpha : 0.0f; /* then next == t: nothing happens */
            float next = t[x] * (1.0f - alpha);
            int open = next > stop;
            weight[x] = open ? t[x] * alpha : 0.0f;
            t[x] = open ? next : 0.0f;
            final[x] = open ? next : final[x];
        }
        float *r = tile->r[y], *g = tile->g[y], *b = tile->b[y];
        for (int x = 0; x < TILE; x++) {
            r[x] += weight[x] * color[0];
            g[x] += weight[x] * color[1];
            b[x] += weight[x] * color[2];
        }
        if (want_depth)
            for (int x = 0; x < TILE; x++) tile->z[y][x] += weight[x] * z;
    }
}

static int any_open(const tile_state *tile) {
    float most = 0;
    for (int y = 0; y < TILE; y++)
        for (int x = 0; x < TILE; x++) most = most > tile->t[y][x] ? most : tile->t[y][x];
    return most > 0;
}

/* Makes the pixels of one block of at most TILE x TILE from one tile's list. */
static int block(const tsplat_splats *splats, const int32_t *ids, int64_t count, int32_t x0,
                 int32_t y0, int32_t columns, int32_t rows, const tsplat_params *params,
                 float *rgb, float *transmittance, float *depth) {
    float threshold = (float)params->alpha_threshold, stop = (float)params->transmittance_min;
    tile_state tile;
    memset(&tile, 0, sizeof tile);
    for (int y = 0; y < rows; y++) /* lanes outside the picture stay closed */
        for (int x = 0; x < columns; x++) tile.t[y][x] = tile.final[y][x] = 1.0f;
    for (int64_t i = 0; i < count; i++) {
        if (ids[i] < 0 || ids[i] >= splats->count) return 1;
        draw(splats, ids[i], x0, y0, threshold, stop, depth != NULL, &tile);
        if (i % 16 == 15 && !any_open(&tile)) break;
    }
    for (int y = 0; y < rows; y++) {
        int64_t at = (int64_t)(y0 + y) * splats->width + x0;
        for (int x = 0; x < columns; x++) {
            rgb[3 * (at + x)] = tile.r[y][x];
            rgb[3 * (at + x) + 1] = tile.g[y][x];
            rgb[3 * (at + x) + 2] = tile.b[y][x];
        }
        memcpy(transmittance + at, tile.final[y], sizeof(float) * columns);
        if (depth) memcpy(depth + at, tile.z[y], sizeof(float) * columns);
    }
    return 0;
}

int tsplat_composite(const tsplat_splats *splats, const int64_t *tile_offsets,
                     const int32_t *splat_ids, int32_t tile_size, const tsplat_params *params,
                     float *rgb, float *transmittance, float *depth, int threads) {
    int32_t width = splats->width, height = splats->height;
    if (width < 1 || height < 1 || tile_size < 1 || threads < 1) return TSPLAT_BAD_SIZE;
    int64_t across = ((int64_t)width + tile_size - 1) / tile_size;
    int64_t down = ((int64_t)height + tile_size - 1) / tile_size;
    int bad = 0;
#pragma omp parallel for schedule(dynamic, 4) num_threads(threads) reduction(| : bad)
    for (int64_t k = 0; k < across * down; k++) {
        int32_t x0 = (int32_t)(k % across) * tile_size, y0 = (int32_t)(k / across) * tile_size;
        int32_t x1 = (int32_t)min64((int64_t)x0 + tile_size, width);
        int32_t y1 = (int32_t)min64((int64_t)y0 + tile_size, height);
        const int32_t *ids = splat_ids + tile_offsets[k];
        int64_t count = tile_offsets[k + 1] - tile_offsets[k];
        for (int32_t y = y0; y < y1; y += TILE) /* one block unless the tiles are large */
            for (int32_t x = x0; x < x1; x += TILE)
                bad |= block(splats, ids, count, x, y, (int32_t)min64(TILE, x1 - x),
                             (int32_t)min64(TILE, y1 - y), params, rgb, transmittance, depth);
    }
    return bad ? TSPLAT_BAD_ID : 0;
}
