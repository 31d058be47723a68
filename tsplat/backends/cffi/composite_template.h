/* Compositing one tile of TILE x TILE pixels; a template, instantiated once per instruction set.
 *
 * Parameters: NAME(f), the function's name for this set; TARGET, its attributes; LANES, 4, 8 or 16;
 * VF and VM, vector and mask; and the operations of vec_*.h.
 *
 * A tile is cut into 4 x 4 blocks of 4 x 4 pixels. For a batch of splats the blocks that each can
 * reach are found, all sixteen at once; then block by block its splats are drawn, with the pixels in
 * registers; one that has stopped keeps its transmittance, negative. What is slow here is not the arithmetic but waiting for it: a processor looks some
 * hundred instructions ahead, two splats' worth. So each loop takes short steps of several splats at
 * a time instead of all steps of one.
 */

/* Works w and v out where the tile's corner is, which place has as (x, y, y, 0); in double, since far
 * from a needle's middle terms cancel. */
TARGET static inline void NAME(place)(placed *s, const record *p, const four_doubles *place) {
    four_doubles product = *place * __builtin_convertvector(p->factors, four_doubles);
    s->w = (float)(product[0] - p->w + product[2]);
    s->v = (float)(product[1] - p->v);
    memcpy(&s->reach, &p->reach, 12 * sizeof(float)); /* it and what follows lie alike in both */
}

/* Blocks of a tile that a splat can reach, as bits. Over a block w and v run through intervals about
 * their values at its middle; the distances of these intervals from 0 bound w^2 + v^2 from below. */
TARGET static inline unsigned NAME(reached)(const placed *s) {
    VF u11 = SET1(s->factors[0]), u22 = SET1(s->factors[1]), u12 = SET1(s->factors[2]);
    VF zero = SET1(0.0f);
    unsigned hit = 0;
    for (int k = 0; k < 16; k += LANES) {
        VF x = LOAD(BLOCK_X + k), y = LOAD(BLOCK_Y + k);
        VF w = FMA(u11, x, FMA(u12, y, SET1(s->w))), v = FMA(u22, y, SET1(s->v));
        w = MAX(SUB(ABS(w), SET1(s->half_w)), zero), v = MAX(SUB(ABS(v), SET1(s->half_v)), zero);
        hit |= BITS(LE(FMA(v, v, MUL(w, w)), SET1(s->reach))) << k;
    }
    return hit;
}

/* First step of a draw: the base-2 logarithm of alpha. */
TARGET static inline VF NAME(exponent)(const tile *s, uint32_t entry, int at) {
    const placed *p = (const placed *)(const void *)((const char *)s->placed + entry % 65536);
    VF x = LOAD((const float *)(const void *)((const char *)PIXEL_X + entry / 65536) + at);
    VF y = LOAD((const float *)(const void *)((const char *)PIXEL_Y + entry / 65536) + at);
    VF w = FMA(SET1(p->factors[0]), x, FMA(SET1(p->factors[2]), y, SET1(p->w)));
    VF v = FMA(SET1(p->factors[1]), y, SET1(p->v));
    return FNMA(v, v, FNMA(w, w, SET1(p->factors[3])));
}

/* Second step: alpha, 0 below the threshold. */
TARGET static inline VF NAME(alpha)(VF x, VF floor_) {
    VM reached = GE(x, floor_);
    VF f = FRACTION(x), f2 = MUL(f, f);
    VF low = FMA(f, SET1((float)EXP2_FLOOR_1), SET1((float)EXP2_FLOOR_0));
    VF middle = FMA(f, SET1((float)EXP2_FLOOR_3), SET1((float)EXP2_FLOOR_2));
    VF high = FMA(f, SET1((float)EXP2_FLOOR_5), SET1((float)EXP2_FLOOR_4));
    /* kept before it is used: numbers below the normal ones cost a hundred times as much */
    VF alpha = SCALE(reached, FMA(FMA(high, f2, middle), f2, low), x);
    return MIN(alpha, SET1((float)ALPHA_MAX));
}

/* Draws the listed splats on some rows of each block, WIDE vectors of pixels at a time: broadcasts
 * serve them all. Returns the blocks where a pixel is open still. */
#define EACH for (int h = 0; h < WIDE; h++)
TARGET static inline uint32_t NAME(draw)(tile *s, int at, VF floor_, VF stop, int want_depth) {
    const uint32_t *list = s->list;
    uint32_t open = 0;
    VF x[WIDE], alpha[WIDE], t[WIDE], r[WIDE], g[WIDE], b[WIDE], z[WIDE];
    VF sign = SET1(-0.0f), zero = SET1(0.0f);
    EACH x[h] = NAME(exponent)(s, list[1], at + h * LANES);
    EACH alpha[h] = NAME(alpha)(NAME(exponent)(s, list[0], at + h * LANES), floor_);
    for (int block = 0, i = 0; block < 16; block++) {
        int count = s->ends[block];
        pixels *to = &s->pixels[block];
        unsigned some = 0;
        EACH t[h] = LOAD(to->t + at + h * LANES);
        if (i < count) {
            EACH {
                int k = at + h * LANES;
                r[h] = LOAD(to->r + k), g[h] = LOAD(to->g + k), b[h] = LOAD(to->b + k);
                z[h] = want_depth ? LOAD(to->z + k) : zero;
            }
            for (;;) {
                int end = count - i < LOOK ? count : i + LOOK;
                for (; i < end; i++) {
                    const placed *p = (const placed *)(const void *)((const char *)s->placed + list[i] % 65536);
                    EACH {
                        VF next = FNMA(t[h], alpha[h], t[h]);
                        VM drawn = GT(next, stop);
                        VF weight = KEEP(drawn, MUL(t[h], alpha[h]));
                        alpha[h] = NAME(alpha)(x[h], floor_);
                        x[h] = NAME(exponent)(s, list[i + 2], at + h * LANES);
                        t[h] = PICK(drawn, next, OR(t[h], sign));
                        r[h] = FMA(weight, SET1(p->r), r[h]);
                        g[h] = FMA(weight, SET1(p->g), g[h]);
                        b[h] = FMA(weight, SET1(p->b), b[h]);
                        if (want_depth) z[h] = FMA(weight, SET1(p->z), z[h]);
                    }
                }
                if (i == count) break;
                some = 0;
                EACH some |= BITS(GE(t[h], zero));
                if (some) continue;
                i = count; /* the rest of its splats is hidden */
                EACH alpha[h] = NAME(alpha)(NAME(exponent)(s, list[i], at + h * LANES), floor_);
                EACH x[h] = NAME(exponent)(s, list[i + 1], at + h * LANES);
                break;
            }
            EACH {
                int k = at + h * LANES;
                STORE(to->t + k, t[h]);
                STORE(to->r + k, r[h]);
                STORE(to->g + k, g[h]);
                STORE(to->b + k, b[h]);
                if (want_depth) STORE(to->z + k, z[h]);
            }
        }
        some = 0;
        EACH some |= BITS(GE(t[h], zero));
        open |= (uint32_t)(some != 0) << block;
    }
    return open;
}
#undef EACH

/* Draws a batch on the open blocks, and returns those that are still open. */
TARGET static inline uint32_t NAME(draw_batch)(tile *s, int count, uint32_t open, VF floor_, VF stop,
                                               int want_depth) {
    uint32_t found = 0, still = 0;
    for (int block = 0; block < 16; block++) {
        if (open >> block & 1) found += NAME(list)(s->list + found, s->hits, count, block);
        s->ends[block] = (int)found;
    }
    s->list[found] = s->list[found + 1] = BATCH * sizeof(placed);
    for (int k = 0; k < 16; k += WIDE * LANES) still |= NAME(draw)(s, k, floor_, stop, want_depth);
    return still;
}

/* See composite_tile in kernel.c. */
TARGET static int NAME(composite_tile)(const picture *out, const record *records, int64_t slots,
                                       const int32_t *ids, int64_t count, int32_t x0, int32_t y0,
                                       int32_t columns, int32_t rows) {
    tile s;
    VF floor_ = SET1(out->floor), stop = SET1(out->stop);
    four_doubles place = {x0 + 0.5, y0 + 0.5, y0 + 0.5, 0};
    for (int64_t j = 0; j < min64(AHEAD, count); j++) PREFETCH(records + ids[j]);
    uint32_t open = start_tile(&s, out, x0, y0, columns, rows);
    /* where the first few splats hide the rest, placing more would be in vain */
    int64_t most = count > BATCH || !out->last ? BATCH / 8 : BATCH;
    for (int64_t j = 0; j < count && open; most = BATCH) {
        int n = (int)min64(most, count - j);
        for (int i = 0; i < n; i++, j++) {
            if (ids[j] < 0 || ids[j] >= slots) return -1;
            PREFETCH(records + ids[min64(j + AHEAD, count - 1)]); /* a wrong one does no harm */
            NAME(place)(s.placed + i, records + ids[j], &place);
        }
        for (int i = 0; i < n; i++) s.hits[i] = (uint16_t)NAME(reached)(s.placed + i);
        for (int i = n; i % 64; i++) s.hits[i] = 0;
        open = out->depth ? NAME(draw_batch)(&s, n, open, floor_, stop, 1)
                          : NAME(draw_batch)(&s, n, open, floor_, stop, 0);
    }
    int done = out->last || !open;
#ifdef STREAM_ROW
    if (done && out->stream == 64 && !out->depth && columns == TILE) {
        for (int y = 0; y < rows; y++) {
            int64_t at = (int64_t)(y0 + y) * out->width + x0;
            STREAM_ROW(&s, y, out->rgb + 3 * at, out->transmittance + at);
        }
        return open != 0;
    }
#endif
    finish_tile(&s, out, done, x0, y0, columns, rows);
    return open != 0;
}
