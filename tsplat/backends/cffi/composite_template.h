/* Compositing one tile of TILE x TILE pixels; a template, instantiated once per instruction set.
 *
 * Parameters: NAME(f), the function's name for this set; TARGET, its attributes; LANES, 4, 8 or 16;
 * VF and VM, vector and mask; and the operations of vec_*.h.
 *
 * A tile is cut into blocks of 4 x (LANES / 4) pixels, one vector each. For a batch of splats the
 * blocks that each can reach are found from the exact span of its ellipse on every row of pixels,
 * and listed splat by splat; then one loop without surprises runs over the list. A pixel is its
 * transmittance, negative once it has stopped, and its colour sums.
 */
#define BLOCK_H (LANES / 4)
#define DOWN (TILE / BLOCK_H)
#define BLOCKS (4 * DOWN)

/* Pixels of a block, and the top left pixels of a tile's blocks; block = column * DOWN + row. */
#if LANES == 16
_Alignas(64) static const float NAME(lane_x)[] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
_Alignas(64) static const float NAME(lane_y)[] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};
#define COLUMN(x) x, x, x, x
#define COLUMN_ROWS 0, 4, 8, 12
#elif LANES == 8
_Alignas(64) static const float NAME(lane_x)[] = {0, 1, 2, 3, 0, 1, 2, 3};
_Alignas(64) static const float NAME(lane_y)[] = {0, 0, 0, 0, 1, 1, 1, 1};
#define COLUMN(x) x, x, x, x, x, x, x, x
#define COLUMN_ROWS 0, 2, 4, 6, 8, 10, 12, 14
#else
_Alignas(64) static const float NAME(lane_x)[] = {0, 1, 2, 3};
_Alignas(64) static const float NAME(lane_y)[] = {0, 0, 0, 0};
#define COLUMN(x) x, x, x, x, x, x, x, x, x, x, x, x, x, x, x, x
#define COLUMN_ROWS 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15
#endif
_Alignas(64) static const float NAME(block_x)[] = {COLUMN(0), COLUMN(4), COLUMN(8), COLUMN(12)};
_Alignas(64) static const float NAME(block_y)[] = {COLUMN_ROWS, COLUMN_ROWS, COLUMN_ROWS, COLUMN_ROWS};

typedef struct {
    /* per block, LANES values each */
    _Alignas(64) float t[BLOCKS * LANES], r[BLOCKS * LANES], g[BLOCKS * LANES];
    _Alignas(64) float b[BLOCKS * LANES], z[BLOCKS * LANES];
    /* per splat of a batch: exponent products at the lanes of a block, and at each block's corner */
    _Alignas(64) float lane_w[BATCH][LANES], lane_v[BATCH][LANES];
    _Alignas(64) float corner_w[BATCH][BLOCKS], corner_v[BATCH][BLOCKS];
    uint16_t list[BATCH * BLOCKS]; /* splat of the batch * BLOCKS + block */
} NAME(tile);

/* Blocks that have an open pixel: bit BLOCK_H * block of the result. */
TARGET static uint64_t NAME(open_blocks)(const NAME(tile) *s) {
    uint64_t open = 0;
    for (int k = 0; k < BLOCKS; k++)
        open |= (uint64_t)(BITS(GT(LOAD(s->t + k * LANES), SET1(0.0f))) != 0) << (BLOCK_H * k);
    return open;
}

/* Blocks that a splat can reach, as in open_blocks. On a row of pixels w runs linearly through 0 at
 * mean + shear dy, so the row is reached where w^2 <= reach - v^2: an interval, padded against
 * rounding. Rows are then merged into rows of blocks. */
TARGET static inline uint64_t NAME(reached)(const record *p, int32_t x0, int32_t y0) {
    VF mean_x = SET1(p->mean_x - ((float)x0 + 0.5f)), mean_y = SET1(p->mean_y - ((float)y0 + 0.5f));
    VF slope = SET1(p->u22), reach = SET1(p->reach), shear = SET1(p->shear), tiny = SET1(1e-12f);
    VF inverse = SET1(p->inverse), pad = SET1(SPAN_PAD), slack = SET1(SPAN_SLACK);
    uint64_t hit = 0;
    for (int i = 0; i < TILE; i += LANES) {
        VF dy = SUB(LOAD(ROWS + i), mean_y);
        VF v = MUL(slope, dy), room = FNMA(v, v, reach), lean = MUL(shear, dy);
        VF half = MUL(ROUGH_SQRT(MAX(room, tiny)), inverse), middle = ADD(mean_x, lean);
        half = ADD(half, FMA(slack, ADD(half, ABS(lean)), pad));
        VF left = SUB(middle, half), right = ADD(middle, half);
        VM some = GE(room, SET1(0.0f));
        for (int c = 0; c < 4; c++) {
            VM in = BOTH(LE(left, SET1(4.0f * c + 3)), GE(right, SET1(4.0f * c)));
            hit |= (uint64_t)BITS(BOTH(in, some)) << (16 * c + i);
        }
    }
    if (BLOCK_H > 1) hit |= hit >> 1;
    if (BLOCK_H > 2) hit |= hit >> 2;
    return hit;
}

/* The exponent's products w and v of splat j at every lane of a block and at every block's corner.
 * At the tile's corner they are worked out in double: far from a needle's middle terms cancel. */
TARGET static inline void NAME(place)(NAME(tile) *s, int j, const record *p, int32_t x0, int32_t y0) {
    double dx = x0 + 0.5 - p->mean_x, dy = y0 + 0.5 - p->mean_y;
    VF w = SET1((float)(p->u11 * dx + p->u12 * dy)), v = SET1((float)(p->u22 * dy));
    VF u11 = SET1(p->u11), u12 = SET1(p->u12), u22 = SET1(p->u22);
    STORE(s->lane_w[j], FMA(u11, LOAD(NAME(lane_x)), MUL(u12, LOAD(NAME(lane_y)))));
    STORE(s->lane_v[j], MUL(u22, LOAD(NAME(lane_y))));
    for (int k = 0; k < BLOCKS; k += LANES) {
        VF y = LOAD(NAME(block_y) + k);
        STORE(s->corner_w[j] + k, FMA(u11, LOAD(NAME(block_x) + k), FMA(u12, y, w)));
        STORE(s->corner_v[j] + k, FMA(u22, y, v));
    }
}

/* Draws a splat on a block: level - w^2 - v^2 is the base-2 logarithm of its alpha. */
TARGET static inline void NAME(draw)(NAME(tile) *s, const record *p, int j, int block, VF floor_,
                                     VF stop, int want_depth) {
    int at = block * LANES;
    VF w = ADD(LOAD(s->lane_w[j]), SET1(s->corner_w[j][block]));
    VF v = ADD(LOAD(s->lane_v[j]), SET1(s->corner_v[j][block]));
    VF x = FNMA(v, v, FNMA(w, w, SET1(p->level)));
    VM reached = GE(x, floor_);
    x = MAX(x, floor_); /* no denormals, which cost a hundred times as much */
    /* alpha = 2^n 2^f; the polynomial in pairs, since a pixel waits for it */
    VF shifted = ADD(x, SET1(ROUNDING)), f = SUB(x, SUB(shifted, SET1(ROUNDING))), f2 = MUL(f, f);
    VF low = FMA(f, SET1((float)EXP2_POLY_1), SET1((float)EXP2_POLY_0));
    VF middle = FMA(f, SET1((float)EXP2_POLY_3), SET1((float)EXP2_POLY_2));
    VF high = FMA(f, SET1((float)EXP2_POLY_5), SET1((float)EXP2_POLY_4));
    high = FMA(f2, SET1((float)EXP2_POLY_6), high);
    VF alpha = SCALE(FMA(FMA(high, f2, middle), f2, low), shifted);
    alpha = MIN(alpha, SET1((float)ALPHA_MAX));
    VF t = LOAD(s->t + at), part = MUL(t, alpha), next = SUB(t, part);
    VM drawn = BOTH(GT(next, stop), reached);
    VF weight = KEEP(drawn, part);
    STORE(s->t + at, PICK(drawn, next, NEGATE(BUT_NOT(reached, drawn), t)));
    STORE(s->r + at, FMA(weight, SET1(p->r), LOAD(s->r + at)));
    STORE(s->g + at, FMA(weight, SET1(p->g), LOAD(s->g + at)));
    STORE(s->b + at, FMA(weight, SET1(p->b), LOAD(s->b + at)));
    if (want_depth) STORE(s->z + at, FMA(weight, SET1(p->z), LOAD(s->z + at)));
}

/* See composite_tile in kernel.c. */
TARGET static int NAME(composite_tile)(const picture *out, const record *records, int64_t splats,
                                       const int32_t *ids, int64_t count, int32_t x0, int32_t y0,
                                       int32_t columns, int32_t rows) {
    NAME(tile) s;
    int want_depth = out->depth != NULL;
    VF floor_ = SET1(out->floor), stop = SET1(out->stop);
    for (int64_t j = 0; j < min64(BATCH, count); j++) PREFETCH(records + ids[j]);
    memset(s.r, 0, sizeof s.r);
    memset(s.g, 0, sizeof s.g);
    memset(s.b, 0, sizeof s.b);
    if (want_depth) memset(s.z, 0, sizeof s.z);
    for (int k = 0; k < BLOCKS; k++)
        for (int l = 0; l < LANES; l++) { /* pixels outside the picture are stopped from the start */
            int x = 4 * (k / DOWN) + l % 4, y = BLOCK_H * (k % DOWN) + l / 4;
            s.t[k * LANES + l] = x < columns && y < rows ? 1.0f : -1.0f;
        }
    for (int64_t begin = 0; begin < count; begin += BATCH) {
        int n = (int)min64(BATCH, count - begin), entries = 0;
        const int32_t *id = ids + begin;
        uint64_t open = NAME(open_blocks)(&s);
        if (!open) break;
        for (int j = 0; j < n; j++)
            if (id[j] < 0 || id[j] >= splats) return 1;
        for (int64_t j = begin + BATCH; j < min64(begin + 2 * BATCH, count); j++)
            PREFETCH(records + ids[j]); /* a wrong one does no harm */
        for (int j = 0; j < n; j++) {
            const record *p = records + id[j];
            uint64_t mask = NAME(reached)(p, x0, y0) & open; /* open has only every BLOCK_H-th bit */
            if (!mask) continue;
            NAME(place)(&s, j, p, x0, y0);
            for (; mask; mask &= mask - 1)
                s.list[entries++] = (uint16_t)(j * BLOCKS + __builtin_ctzll(mask) / BLOCK_H);
        }
        for (int i = 0; i < entries; i++) {
            int j = s.list[i] / BLOCKS;
            NAME(draw)(&s, records + id[j], j, s.list[i] % BLOCKS, floor_, stop, want_depth);
        }
    }
    for (int y = 0; y < rows; y++) {
        for (int x = 0; x < columns; x += 4) {
            int at = ((x / 4) * DOWN + y / BLOCK_H) * LANES + y % BLOCK_H * 4;
            int64_t place = (int64_t)(y0 + y) * out->width + x0 + x;
            float *rgb = out->rgb + 3 * place, *t = out->transmittance + place;
            int n = columns - x < 4 ? columns - x : 4;
            for (int i = 0; i < n; i++) {
                rgb[3 * i] = s.r[at + i];
                rgb[3 * i + 1] = s.g[at + i];
                rgb[3 * i + 2] = s.b[at + i];
                t[i] = fabsf(s.t[at + i]);
            }
            if (want_depth) memcpy(out->depth + place, s.z + at, sizeof(float) * n);
        }
    }
    return 0;
}

#undef BLOCK_H
#undef DOWN
#undef BLOCKS
#undef COLUMN
#undef COLUMN_ROWS
