/* Packing a scene, once: neighbours in space become neighbours in memory, vectors need no
 * gathering, and whole clusters can be skipped. */

/* bounds: lowest mean, highest mean, furthest reach in world units, furthest reach in standard
 * deviations; each a little too wide rather than too narrow. */
static void bound(const tsplat_scene *scene, const int32_t *order, int64_t count, double least,
                  double *bounds) {
    for (int k = 0; k < 3; k++) bounds[k] = INFINITY, bounds[3 + k] = -INFINITY;
    bounds[6] = bounds[7] = 0;
    for (int64_t i = 0; i < count; i++) {
        int64_t id = order[i];
        double widest = 0;
        for (int k = 0; k < 3; k++) {
            bounds[k] = min_(bounds[k], scene->means[3 * id + k]);
            bounds[3 + k] = max_(bounds[3 + k], scene->means[3 * id + k]);
            widest = max_(widest, scene->scales[3 * id + k]);
        }
        double reach = sqrt(2 * log(max_(scene->opacities[id] / least, 1))) * 1.001 + 0.001;
        bounds[6] = max_(bounds[6], reach * widest);
        bounds[7] = max_(bounds[7], reach);
    }
}

int tsplat_pack(const tsplat_scene *scene, const int32_t *order, double alpha_threshold,
                const tsplat_packed *packed, float *columns, double *bounds, int threads) {
    int64_t n = packed->count, width = packed->width, clusters = (n + CLUSTER - 1) / CLUSTER;
    int colored = width == TSPLAT_COLUMNS + 3, bad = 0;
    if (n < 0 || n > scene->count || threads < 1) return TSPLAT_BAD_SIZE;
    if (width != TSPLAT_COLUMNS && !colored) return TSPLAT_BAD_SIZE;
    double least = max_(alpha_threshold, ALPHA_FLOOR);
#pragma omp parallel for schedule(dynamic, 16) num_threads(threads) if (n > WORTH) reduction(| : bad)
    for (int64_t c = 0; c < clusters; c++) {
        int64_t first = c * CLUSTER, end = min64(n, first + CLUSTER);
        for (int64_t i = first; i < end; i++) {
            if (i + 16 < end) {
                int64_t ahead = order[i + 16];
                PREFETCH(scene->means + 3 * ahead); /* a wrong one does no harm */
                PREFETCH(scene->quats + 4 * ahead);
                PREFETCH(scene->scales + 3 * ahead);
            }
            int32_t id = order[i];
            if (id < 0 || id >= scene->count) {
                bad = 1;
                break;
            }
            float *to = columns + i / 16 * 16 * width + i % 16, color[3];
            for (int k = 0; k < 3; k++) to[16 * k] = scene->means[3 * (int64_t)id + k];
            for (int k = 0; k < 4; k++) to[16 * (3 + k)] = scene->quats[4 * (int64_t)id + k];
            for (int k = 0; k < 3; k++) to[16 * (7 + k)] = scene->scales[3 * (int64_t)id + k];
            to[16 * 10] = scene->opacities[id];
            memcpy(to + 16 * 11, &id, sizeof id);
            if (colored) {
                plain_color(scene, id, color);
                for (int k = 0; k < 3; k++) to[16 * (12 + k)] = color[k];
            }
        }
        if (bad) continue;
        for (int64_t i = end; i % 16; i++) /* lanes to spare repeat the last */
            for (int64_t k = 0; k < width; k++)
                columns[(i / 16 * width + k) * 16 + i % 16] =
                    columns[((end - 1) / 16 * width + k) * 16 + (end - 1) % 16];
        bound(scene, order + first, end - first, least, bounds + c * TSPLAT_BOUNDS);
    }
    return bad ? TSPLAT_BAD_ID : 0;
}
