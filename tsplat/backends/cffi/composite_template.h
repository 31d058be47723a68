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

/* Pixels of a block: transmittance, negative once stopped; colour sums; depth sum. */
typedef struct {
    _Alignas(4 * LANES) float t[LANES], r[LANES], g[LANES], b[LANES], z[LANES];
} NAME(pixels);

/* A splat on this tile: the exponent's products w and v at the lanes of a block, and at each
 * block's corner. */
typedef struct {
    _Alignas(64) float lane_w[LANES], lane_v[LANES], corner_w[BLOCKS], corner_v[BLOCKS];
    float level, r, g, b, z;
} NAME(placed);

/* A splat on a block: byte offsets into placed, pixels and the corners. */
typedef struct {
    uint16_t splat, block, corner, unused;
} NAME(entry);

typedef struct {
    _Alignas(64) NAME(pixels) pixels[BLOCKS];
    _Alignas(64) NAME(placed) placed[BATCH];
    NAME(entry) list[BATCH * BLOCKS];
} NAME(tile);

/* Blocks that have an open pixel: bit BLOCK_H * block of the result. */
TARGET static uint64_t NAME(open_blocks)(const NAME(tile) *s) {
    uint64_t open = 0;
    for (int k = 0; k < BLOCKS; k++)
        open |= (uint64_t)(BITS(GT(LOAD(s->pixels[k].t), SET1(0.0f))) != 0) << (BLOCK_H * k);
    return open;
}

/* Blocks that a splat can reach, as in open_blocks. On a row of pixels w runs linearly through 0 at
 * mean + shear dy, so the row is reached where w^2 <= reach - v^2: an interval, padded against
 * rounding. Rows are then merged into rows of blocks. */
TARGET static inline uint64_t NAME(reached)(const record *p, int32_t x0, int32_t y0) {
    VF mean_x = SET1((float)(p->mean_x - (x0 + 0.5))), mean_y = SET1((float)(p->mean_y - (y0 + 0.5)));
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

/* Fills a splat in. At the tile's corner its products are worked out in double: far from a needle's
 * middle terms cancel. */
TARGET static inline void NAME(place)(NAME(placed) *s, const record *p, int32_t x0, int32_t y0) {
    double dx = x0 + 0.5 - p->mean_x, dy = y0 + 0.5 - p->mean_y;
    VF w = SET1((float)(p->u11 * dx + p->u12 * dy)), v = SET1((float)(p->u22 * dy));
    VF u11 = SET1(p->u11), u12 = SET1(p->u12), u22 = SET1(p->u22);
    STORE(s->lane_w, FMA(u11, LOAD(NAME(lane_x)), MUL(u12, LOAD(NAME(lane_y)))));
    STORE(s->lane_v, MUL(u22, LOAD(NAME(lane_y))));
    for (int k = 0; k < BLOCKS; k += LANES) {
        VF y = LOAD(NAME(block_y) + k);
        STORE(s->corner_w + k, FMA(u11, LOAD(NAME(block_x) + k), FMA(u12, y, w)));
        STORE(s->corner_v + k, FMA(u22, y, v));
    }
    s->level = p->level;
    s->r = p->r, s->g = p->g, s->b = p->b, s->z = p->z;
}

/* Draws a splat on a block: level - w^2 - v^2 is the base-2 logarithm of its alpha. The number of
 * steps counts: the processor sees only a few entries ahead. */
TARGET static inline void NAME(draw)(NAME(tile) *s, NAME(entry) e, VF floor_, VF stop, int want_depth) {
    const char *p = (const char *)s->placed + e.splat, *corner = p + e.corner;
    NAME(pixels) *to = (NAME(pixels) *)((char *)s->pixels + e.block);
    const NAME(placed) *splat = (const NAME(placed) *)p;
    VF w = ADD(LOAD(splat->lane_w), SET1(((const NAME(placed) *)corner)->corner_w[0]));
    VF v = ADD(LOAD(splat->lane_v), SET1(((const NAME(placed) *)corner)->corner_v[0]));
    VF x = FNMA(v, v, FNMA(w, w, SET1(splat->level)));
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
    VF t = LOAD(to->t), part = MUL(t, alpha), next = SUB(t, part);
    VM drawn = BOTH(GT(next, stop), reached);
    VF weight = KEEP(drawn, part);
    STORE(to->t, PICK(drawn, next, NEGATE(BUT_NOT(reached, drawn), t)));
    STORE(to->r, FMA(weight, SET1(splat->r), LOAD(to->r)));
    STORE(to->g, FMA(weight, SET1(splat->g), LOAD(to->g)));
    STORE(to->b, FMA(weight, SET1(splat->b), LOAD(to->b)));
    if (want_depth) STORE(to->z, FMA(weight, SET1(splat->z), LOAD(to->z)));
}

/* See composite_tile in kernel.c. */
TARGET static int NAME(composite_tile)(const picture *out, const record *records, int64_t splats,
                                       const int32_t *ids, int64_t count, int32_t x0, int32_t y0,
                                       int32_t columns, int32_t rows) {
    NAME(tile) s;
    int want_depth = out->depth != NULL;
    VF floor_ = SET1(out->floor), stop = SET1(out->stop);
    for (int64_t j = 0; j < min64(BATCH, count); j++) PREFETCH(records + ids[j]);
    for (int k = 0; k < BLOCKS; k++) {
        memset(&s.pixels[k], 0, sizeof s.pixels[k]);
        for (int l = 0; l < LANES; l++) { /* pixels outside the picture are stopped from the start */
            int x = 4 * (k / DOWN) + l % 4, y = BLOCK_H * (k % DOWN) + l / 4;
            s.pixels[k].t[l] = x < columns && y < rows ? 1.0f : -1.0f;
        }
    }
    for (int64_t begin = 0; begin < count; begin += BATCH) {
        int n = (int)min64(BATCH, count - begin), found = 0;
        const int32_t *id = ids + begin;
        uint64_t open = NAME(open_blocks)(&s), masks[BATCH];
        uint8_t which[BATCH];
        if (!open) break;
        for (int j = 0; j < n; j++)
            if (id[j] < 0 || id[j] >= splats) return 1;
        for (int64_t j = begin + BATCH; j < min64(begin + 2 * BATCH, count); j++)
            PREFETCH(records + ids[j]); /* a wrong one does no harm */
        /* In turn, each without branches that would have to wait for sums. */
        for (int j = 0; j < n; j++) masks[j] = NAME(reached)(records + id[j], x0, y0) & open;
        for (int j = 0; j < n; j++) {
            which[found] = (uint8_t)j;
            found += masks[j] != 0;
        }
        NAME(entry) *last = s.list;
        for (int i = 0; i < found; i++) {
            NAME(place)(s.placed + i, records + id[which[i]], x0, y0);
            for (uint64_t mask = masks[which[i]]; mask; mask &= mask - 1) {
                int block = __builtin_ctzll(mask) / BLOCK_H;
                *last++ = (NAME(entry)){(uint16_t)(i * sizeof s.placed[0]),
                                        (uint16_t)(block * sizeof s.pixels[0]),
                                        (uint16_t)(block * sizeof(float)), 0};
            }
        }
        for (const NAME(entry) *e = s.list; e < last; e++)
            NAME(draw)(&s, *e, floor_, stop, want_depth);
    }
    for (int y = 0; y < rows; y++) {
        for (int x = 0; x < columns; x += 4) {
            const NAME(pixels) *from = &s.pixels[(x / 4) * DOWN + y / BLOCK_H];
            int at = y % BLOCK_H * 4;
            int64_t place = (int64_t)(y0 + y) * out->width + x0 + x;
            float *rgb = out->rgb + 3 * place, *t = out->transmittance + place;
            int n = columns - x < 4 ? columns - x : 4;
            for (int i = 0; i < n; i++) {
                rgb[3 * i] = from->r[at + i];
                rgb[3 * i + 1] = from->g[at + i];
                rgb[3 * i + 2] = from->b[at + i];
                t[i] = fabsf(from->t[at + i]);
            }
            if (want_depth) memcpy(out->depth + place, from->z + at, sizeof(float) * n);
        }
    }
    return 0;
}

#undef BLOCK_H
#undef DOWN
#undef BLOCKS
#undef COLUMN
#undef COLUMN_ROWS
