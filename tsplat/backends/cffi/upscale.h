/* Interpolating a picture: rows first, which are contiguous, then within each row. */

enum { TAPS = TSPLAT_TAPS };

/* Row y of a layer of the large picture before it is widened: [width * channels], and room. */
static void blend_rows(const tsplat_layer *layer, int64_t y, float *out) {
    int64_t n = (int64_t)layer->width * layer->channels;
    const float *from[TAPS], *weights = layer->row_weights + y * TAPS;
    for (int k = 0; k < TAPS; k++) from[k] = layer->small + layer->rows[y * TAPS + k] * n;
    for (int64_t i = 0; i < n; i++)
        out[i] = from[0][i] * weights[0] + from[1][i] * weights[1] + from[2][i] * weights[2] +
                 from[3][i] * weights[3];
}

static inline float within(float value, float most) { return value < 0 ? 0 : value > most ? most : value; }

/* One channel. */
static void widen_one(const tsplat_layer *layer, const float *row, float *to) {
    for (int64_t x = 0; x < layer->out_width; x++) {
        const int32_t *at = layer->columns + x * TAPS;
        const float *w = layer->column_weights + x * TAPS;
        float sum = row[at[0]] * w[0] + row[at[1]] * w[1] + row[at[2]] * w[2] + row[at[3]] * w[3];
        to[x] = within(sum, layer->most);
    }
}

/* Three channels: a vector holds a pixel and the first of the next, which is written over. */
static void widen_three(const tsplat_layer *layer, const float *row, float *to) {
    four zero = {0}, most = {layer->most, layer->most, layer->most, layer->most};
    for (int64_t x = 0; x < layer->out_width; x++) {
        const int32_t *at = layer->columns + x * TAPS;
        const float *w = layer->column_weights + x * TAPS;
        four sum = zero;
        for (int k = 0; k < TAPS; k++) sum += *(const four *)(row + 3 * at[k]) * w[k];
        sum = (four)((four_ids)sum & (sum > zero));
        four_ids over = sum > most;
        sum = (four)(((four_ids)most & over) | ((four_ids)sum & ~over));
        if (x + 1 < layer->out_width)
            *(four *)(to + 3 * x) = sum;
        else
            for (int c = 0; c < 3; c++) to[3 * x + c] = sum[c];
    }
}

int tsplat_upscale(const tsplat_layer *layer, float *scratch, int threads) {
    if (layer->channels != 1 && layer->channels != 3) return TSPLAT_BAD_SIZE;
    if (layer->width < 1 || layer->height < 1 || layer->out_width < 1 || layer->out_height < 1 || threads < 1)
        return TSPLAT_BAD_SIZE;
    for (int64_t i = 0; i < (int64_t)layer->out_width * TAPS; i++)
        if (layer->columns[i] < 0 || layer->columns[i] >= layer->width) return TSPLAT_BAD_ID;
    for (int64_t i = 0; i < (int64_t)layer->out_height * TAPS; i++)
        if (layer->rows[i] < 0 || layer->rows[i] >= layer->height) return TSPLAT_BAD_ID;
    int64_t across = (int64_t)layer->width * layer->channels, out = (int64_t)layer->out_width * layer->channels;
#pragma omp parallel for schedule(static) num_threads(threads) if (layer->out_height * out > WORTH)
    for (int64_t y = 0; y < layer->out_height; y++) {
        int thread = 0;
#ifdef _OPENMP
        thread = omp_get_thread_num();
#endif
        float *row = scratch + thread * (across + 1);
        blend_rows(layer, y, row);
        row[across] = 0;
        (layer->channels == 3 ? widen_three : widen_one)(layer, row, layer->large + y * out);
    }
    return 0;
}
