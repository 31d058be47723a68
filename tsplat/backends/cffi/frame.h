/* The whole frame: clusters are skipped or projected, straight into records; each tile sorts its
 * own splats just before it draws them. Same picture as the four stages, to the bit. */

enum { SQUARE = 4 };

/* Largest of n . p over the means of a cluster, p in camera space. */
static double furthest(const lens *lens, const double *bounds, double nx, double ny, double nz) {
    const double *R = lens->rotation;
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        double slope = nx * R[k] + ny * R[3 + k] + nz * R[6 + k];
        sum += slope * ((slope > 0 ? bounds[3 + k] : bounds[k]) - lens->centre[k]);
    }
    return sum;
}

/* Whether no Gaussian of a cluster can reach a pixel. Its reach in x is at most
 * reach * (fx / z * sqrt(1 + u^2) * scale + sqrt(eps2d)), with u clamped as for the Jacobian: times
 * z > 0 this is linear in the mean, so a box of means needs one look per side of the picture. */
static int out_of_sight(const lens *lens, const double *bounds) {
    double edge = sqrt(lens->low_pass) * bounds[7] * (1 + RADIUS_SLACK) + 2 * RADIUS_PAD;
    double focal[2] = {lens->fx, lens->fy}, middle[2] = {lens->cx, lens->cy};
    double size[2] = {lens->width, lens->height};
    if (furthest(lens, bounds, 0, 0, 1) <= lens->near_) return 1;
    if (-furthest(lens, bounds, 0, 0, -1) >= lens->far_) return 1;
    for (int k = 0; k < 2; k++) {
        double u = max_(fabs(lens->slope_min[k]), fabs(lens->slope_max[k])), f = focal[k];
        double reach = f * sqrt(1 + u * u) * bounds[6] * (1 + RADIUS_SLACK);
        double nx = k ? 0 : f, ny = k ? f : 0;
        if (furthest(lens, bounds, nx, ny, middle[k] + edge) + reach < 0) return 1;
        if (furthest(lens, bounds, -nx, -ny, size[k] - middle[k] + edge) + reach < 0) return 1;
    }
    return 0;
}

static inline uint32_t depth_bits(const tsplat_space *space, int64_t slot) {
    uint32_t bits;
    memcpy(&bits, space->depths + slot, sizeof bits);
    return bits;
}

/* Turns counts of threads and tiles into places; totals: all, and those of the fullest tile. Returns
 * how many tiles are empty. */
static int64_t place_tiles(const tsplat_space *space, int64_t tiles, int threads, int64_t *totals) {
    int64_t at = 0, longest = 0, empty = 0;
    for (int64_t k = 0; k < tiles; k++) {
        space->tile_offsets[k] = at;
        for (int t = 0; t < threads; t++) {
            int64_t count = space->cursors[t * tiles + k];
            space->cursors[t * tiles + k] = at;
            at += count;
        }
        empty += at == space->tile_offsets[k];
        longest = at - space->tile_offsets[k] > longest ? at - space->tile_offsets[k] : longest;
    }
    space->tile_offsets[tiles] = at;
    totals[0] = at, totals[1] = longest;
    return empty;
}

int tsplat_frame_project(const tsplat_packed *packed, const tsplat_scene *scene,
                         const tsplat_camera *camera, const tsplat_params *params, int skip,
                         const tsplat_space *space, int64_t *totals, int threads) {
    int64_t n = packed->count, clusters = (n + CLUSTER - 1) / CLUSTER;
    int64_t across = ((int64_t)camera->width + TILE - 1) / TILE;
    int64_t down = ((int64_t)camera->height + TILE - 1) / TILE, tiles = across * down;
    int64_t visible = 0, overflowed = 0, skipped = 0, kept = 0;
    if (n < 0 || n > scene->count || tiles < 1 || threads < 1) return TSPLAT_BAD_SIZE;
    if (across > INT16_MAX || down > INT16_MAX) return TSPLAT_BAD_SIZE;
    if (bad_degree(params->sh_degree, scene->coefficients) ||
        (params->sh_degree && packed->width != TSPLAT_COLUMNS))
        return TSPLAT_BAD_SIZE;
    lens lens = make_lens(camera, params);
    float floor_ = (float)log2(lens.threshold);
    int64_t corners = (across + 1) * (down + 1);
    memset(space->steps, 0, sizeof *space->steps * (size_t)(corners * threads));
#pragma omp parallel num_threads(threads) if (n > WORTH) \
    reduction(+ : visible, overflowed, skipped, kept)
    {
        int thread = 0;
#ifdef _OPENMP
        thread = omp_get_thread_num();
#endif
#pragma omp for schedule(dynamic, 8)
        for (int64_t c = 0; c < clusters; c++) {
            int64_t first = c * CLUSTER, count = min64(CLUSTER, n - first), found[3] = {0, 0, 0};
            int used = 0;
            if (skip && out_of_sight(&lens, packed->bounds + c * TSPLAT_BOUNDS))
                skipped += count;
            else
                used = best->project_chunk(packed, scene, &lens, floor_, first, (int)count, space,
                                           space->steps + thread * corners, found);
            space->cluster_counts[c] = used;
            space->owners[c] = thread;
            visible += found[0];
            overflowed += found[1];
            kept += found[2];
        }
        STREAMED();
    }
    /* Sums over columns and rows turn steps into counts; these become the places of each tile. */
    for (int t = 0; t < threads; t++) {
        const int32_t *steps = space->steps + t * corners;
        int64_t *counts = space->cursors + t * tiles;
        for (int64_t v = 0; v < down; v++) {
            int64_t sum = 0;
            for (int64_t u = 0; u < across; u++) {
                sum += steps[v * (across + 1) + u];
                counts[v * across + u] = sum + (v ? counts[(v - 1) * across + u] : 0);
            }
        }
    }
    int64_t empty = place_tiles(space, tiles, threads, totals + 3);
    totals[0] = visible, totals[1] = overflowed, totals[2] = skipped;
    totals[5] = empty, totals[6] = kept;
    return 0;
}

int tsplat_frame_slabs(const tsplat_packed *packed, const tsplat_camera *camera,
                       const tsplat_space *space, int64_t share, uint32_t *bounds, int32_t *count) {
    enum { STEPS = 4096 };
    int64_t pairs[STEPS] = {0}, seen = 0;
    uint32_t low = UINT32_MAX, high = 0;
    int64_t tiles = ((int64_t)camera->width + TILE - 1) / TILE * (((int64_t)camera->height + TILE - 1) / TILE);
    memset(space->closed, 0, (size_t)tiles);
    for (int round = 0; round < 2; round++) {
        int shift = high > low ? 32 - __builtin_clz(high - low) : 0;
        shift = shift > 12 ? shift - 12 : 0;
        for (int64_t c = 0; c * CLUSTER < packed->count; c++) {
            for (int64_t slot = c * CLUSTER; slot < c * CLUSTER + space->cluster_counts[c]; slot++) {
                uint32_t depth = depth_bits(space, slot);
                if (!round) {
                    low = depth < low ? depth : low, high = depth > high ? depth : high;
                    continue;
                }
                box b = ((const box *)(const void *)space->boxes)[slot];
                pairs[(depth - low) >> shift] += (b.last % 65536 - b.first % 65536 + 1LL) *
                                                 (b.last / 65536 - b.first / 65536 + 1LL);
            }
        }
        if (!round) continue;
        int32_t n = 0;
        bounds[0] = 0;
        for (uint32_t k = 0; k < STEPS && n + 1 < TSPLAT_SLABS; k++) {
            seen += pairs[k];
            if (seen < share) continue;
            bounds[++n] = low + ((k + 1) << shift);
            seen = 0, share *= 4;
        }
        bounds[++n] = UINT32_MAX;
        *count = n;
    }
    return 0;
}

/* Whether a splat of that depth belongs to a slab and may reach an open tile; open is the number of
 * open tiles above and left of each corner. */
static inline int in_slab(box b, uint32_t depth, uint32_t near_bits, uint32_t far_bits,
                          const int32_t *open, int64_t across) {
    if (depth < near_bits || depth >= far_bits) return 0;
    if (!open) return 1;
    const int32_t *top = open + b.first / 65536 * (across + 1);
    const int32_t *below = open + (b.last / 65536 + 1) * (across + 1);
    int64_t u0 = b.first % 65536, u1 = b.last % 65536 + 1;
    return below[u1] - below[u0] - top[u1] + top[u0] > 0;
}

int tsplat_frame_count(const tsplat_packed *packed, const tsplat_camera *camera,
                       const tsplat_space *space, uint32_t near_bits, uint32_t far_bits,
                       int64_t *totals, int threads) {
    int64_t clusters = (packed->count + CLUSTER - 1) / CLUSTER;
    int64_t across = ((int64_t)camera->width + TILE - 1) / TILE;
    int64_t down = ((int64_t)camera->height + TILE - 1) / TILE, tiles = across * down;
    int32_t *open = space->steps; /* no longer needed for what project counted */
    memset(open, 0, sizeof *open * (size_t)(across + 1));
    for (int64_t v = 0; v < down; v++) {
        int32_t *row = open + (v + 1) * (across + 1), sum = 0;
        row[0] = 0;
        for (int64_t u = 0; u < across; u++) {
            sum += !space->closed[v * across + u];
            row[u + 1] = row[u - across] + sum;
        }
    }
    memset(space->cursors, 0, sizeof *space->cursors * (size_t)(tiles * threads));
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (packed->count > WORTH)
    for (int t = 0; t < threads; t++) {
        int64_t *counts = space->cursors + t * tiles;
        for (int64_t c = 0; c < clusters; c++) {
            if (space->owners[c] != t) continue;
            for (int64_t slot = c * CLUSTER; slot < c * CLUSTER + space->cluster_counts[c]; slot++) {
                box b = ((const box *)(const void *)space->boxes)[slot];
                if (!in_slab(b, depth_bits(space, slot), near_bits, far_bits, open, across)) continue;
                int64_t u0 = b.first % 65536, u1 = b.last % 65536;
                for (int64_t v = b.first / 65536; v <= b.last / 65536; v++)
                    for (int64_t u = u0; u <= u1; u++)
                        counts[v * across + u] += !space->closed[v * across + u];
            }
        }
    }
    place_tiles(space, tiles, threads, totals);
    return 0;
}

int tsplat_frame_bin(const tsplat_packed *packed, const tsplat_camera *camera,
                     const tsplat_space *space, uint32_t near_bits, uint32_t far_bits, int threads) {
    int64_t clusters = (packed->count + CLUSTER - 1) / CLUSTER;
    int64_t across = ((int64_t)camera->width + TILE - 1) / TILE;
    int64_t down = ((int64_t)camera->height + TILE - 1) / TILE;
    int whole = !near_bits && far_bits == UINT32_MAX;
    const int32_t *open = whole ? NULL : space->steps;
#pragma omp parallel for schedule(static, 1) num_threads(threads) if (packed->count > WORTH)
    for (int t = 0; t < threads; t++) {
        int64_t *cursors = space->cursors + t * across * down;
        for (int64_t c = 0; c < clusters; c++) {
            if (space->owners[c] != t) continue;
            for (int64_t slot = c * CLUSTER; slot < c * CLUSTER + space->cluster_counts[c]; slot++) {
                box b = ((const box *)(const void *)space->boxes)[slot];
                uint32_t depth = depth_bits(space, slot);
                if (!whole && !in_slab(b, depth, near_bits, far_bits, open, across)) continue;
                uint64_t pair = (uint64_t)depth << 32 | (uint32_t)slot;
                int64_t u0 = b.first % 65536, u1 = b.last % 65536;
                for (int64_t v = b.first / 65536; v <= b.last / 65536; v++)
                    for (int64_t u = u0; u <= u1; u++)
                        if (whole || !space->closed[v * across + u])
                            space->pairs[cursors[v * across + u]++] = pair;
            }
        }
    }
    return 0;
}

/* A tile that no splat of the slab touches. */
static void pass_tile(const picture *out, int32_t x0, int32_t y0, int32_t columns, int32_t rows) {
    for (int y = 0; y < rows; y++) {
        int64_t at = (int64_t)(y0 + y) * out->width + x0;
        float *t = out->transmittance + at;
        if (out->resume) {
            for (int x = 0; x < columns && out->last; x++) t[x] = fabsf(t[x]);
            continue;
        }
        memset(out->rgb + 3 * at, 0, 3 * sizeof(float) * (size_t)columns);
        if (out->depth) memset(out->depth + at, 0, sizeof(float) * (size_t)columns);
        for (int x = 0; x < columns; x++) t[x] = 1;
    }
}

int tsplat_frame_composite(const tsplat_packed *packed, const tsplat_camera *camera,
                           const tsplat_params *params, int skip, int resume, int last,
                           const tsplat_space *space, int64_t longest, float *rgb,
                           float *transmittance, float *depth, int threads) {
    int32_t width = camera->width, height = camera->height;
    int64_t across = ((int64_t)width + TILE - 1) / TILE, down = ((int64_t)height + TILE - 1) / TILE;
    const record *records = (const record *)(const void *)space->records;
    const ties ties = {records, packed->numbers};
    picture out = make_picture(params, width, rgb, transmittance, depth);
    int bad = 0;
    if (width < 1 || height < 1 || threads < 1) return TSPLAT_BAD_SIZE;
    out.resume = resume, out.last = last;
    if (!last) out.stream = 0; /* it is read again soon */
#pragma omp parallel num_threads(threads) reduction(| : bad)
    {
        int thread = 0;
#ifdef _OPENMP
        thread = omp_get_thread_num();
#endif
        uint64_t *scratch = space->scratch + thread * longest;
        int32_t *ids = space->ids + thread * longest;
        /* A square of tiles at a time: neighbours share splats, which the cache still holds. */
        int64_t squares = (across + SQUARE - 1) / SQUARE;
#pragma omp for schedule(dynamic, 1)
        for (int64_t k = 0; k < squares * ((down + SQUARE - 1) / SQUARE); k++) {
            int64_t u0 = k % squares * SQUARE, v0 = k / squares * SQUARE;
            for (int64_t v = v0; v < min64(v0 + SQUARE, down); v++) {
                for (int64_t u = u0; u < min64(u0 + SQUARE, across); u++) {
                    int64_t tile = v * across + u, begin = space->tile_offsets[tile];
                    int64_t count = space->tile_offsets[tile + 1] - begin;
                    int32_t x0 = (int32_t)u * TILE, y0 = (int32_t)v * TILE;
                    int32_t columns = (int32_t)min64(TILE, width - x0);
                    int32_t rows = (int32_t)min64(TILE, height - y0);
                    if (resume && space->closed[tile]) continue;
                    if ((skip || resume) && !count) {
                        pass_tile(&out, x0, y0, columns, rows);
                        continue;
                    }
                    best->sort_tile(space->pairs + begin, scratch, count, &ties, ids);
                    /* as a rule the next tile has as many; a wrong address does no harm */
                    for (int64_t j = 0; j < min64(count, 512); j += 8) PREFETCH(space->pairs + begin + count + j);
                    int open = best->composite_tile(&out, records, packed->count, ids, count, x0,
                                                    y0, columns, rows);
                    bad |= open < 0;
                    if (!last) space->closed[tile] = !open;
                }
            }
        }
        STREAMED();
    }
    return bad ? TSPLAT_BAD_ID : 0;
}
