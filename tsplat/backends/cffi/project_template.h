/* Projecting LANES Gaussians at a time; a template, instantiated once per instruction set. Its
 * parameters are those of composite_template.h.
 *
 * Geometry is double, in two halves of LANES / 2: a needle's tilt must be right to the last bit of
 * the float it ends in. Roots and quotients are float, taken of sums that hold no cancellation.
 */

/* What one half yields, per Gaussian; see reference._project_rows for the names. */
typedef struct {
    VD z, mean_x, mean_y, xx, yy, xy, det_sharp;
} NAME(half);

/* LANES splats. */
typedef struct {
    VD mean_x[2], mean_y[2];
    VF u11, u12, u22, z, opacity, radius_x, radius_y;
} NAME(splats);

/* in: means, quats, scales as columns of LANES floats; half 0 or 1. */
TARGET static inline NAME(half) NAME(geometry)(const lens *lens, const VD in[10]) {
    const double *R = lens->rotation;
    NAME(half) out;
#define R_(i) DSET1(R[i])
    VD dx = DSUB(in[0], DSET1(lens->centre[0])), dy = DSUB(in[1], DSET1(lens->centre[1]));
    VD dz = DSUB(in[2], DSET1(lens->centre[2]));
    /* In this order and without FMA: the depth's bits are the contract's. */
    out.z = DADD(DADD(DMUL(R_(6), dx), DMUL(R_(7), dy)), DMUL(R_(8), dz));
    VD px = DADD(DADD(DMUL(R_(0), dx), DMUL(R_(1), dy)), DMUL(R_(2), dz));
    VD py = DADD(DADD(DMUL(R_(3), dx), DMUL(R_(4), dy)), DMUL(R_(5), dz));
    VD near_by = DDIV(DSET1(1.0), out.z), slope_x = DMUL(px, near_by), slope_y = DMUL(py, near_by);
    VD fx = DSET1(lens->fx), fy = DSET1(lens->fy);
    out.mean_x = DFMA(fx, slope_x, DSET1(lens->cx));
    out.mean_y = DFMA(fy, slope_y, DSET1(lens->cy));
    VD u = DMIN(DMAX(slope_x, DSET1(lens->slope_min[0])), DSET1(lens->slope_max[0]));
    VD v = DMIN(DMAX(slope_y, DSET1(lens->slope_min[1])), DSET1(lens->slope_max[1]));
    VD scale_x = DMUL(fx, near_by), scale_y = DMUL(fy, near_by);
    VD j1[3], j2[3]; /* the rows of J R */
    for (int i = 0; i < 3; i++) {
        j1[i] = DMUL(scale_x, DFNMA(u, R_(6 + i), R_(i)));
        j2[i] = DMUL(scale_y, DFNMA(v, R_(6 + i), R_(3 + i)));
    }
#undef R_
    VD w = in[3], x = in[4], y = in[5], z = in[6], one = DSET1(1.0), two = DSET1(2.0);
    VD x2 = DMUL(two, x), y2 = DMUL(two, y), z2 = DMUL(two, z);
    VD turn[9] = {
        DFNMA(y2, y, DFNMA(z2, z, one)), DFNMA(w, z2, DMUL(x, y2)), DFMA(w, y2, DMUL(x, z2)),
        DFMA(w, z2, DMUL(x, y2)), DFNMA(x2, x, DFNMA(z2, z, one)), DFNMA(w, x2, DMUL(y, z2)),
        DFNMA(w, y2, DMUL(x, z2)), DFMA(w, x2, DMUL(y, z2)), DFNMA(x2, x, DFNMA(y2, y, one))};
    VD a1[3], a2[3];
    for (int k = 0; k < 3; k++) {
        VD p = DFMA(j1[0], turn[k], DFMA(j1[1], turn[3 + k], DMUL(j1[2], turn[6 + k])));
        VD q = DFMA(j2[0], turn[k], DFMA(j2[1], turn[3 + k], DMUL(j2[2], turn[6 + k])));
        a1[k] = DMUL(p, in[7 + k]);
        a2[k] = DMUL(q, in[7 + k]);
    }
    out.xx = DFMA(a1[0], a1[0], DFMA(a1[1], a1[1], DMUL(a1[2], a1[2])));
    out.yy = DFMA(a2[0], a2[0], DFMA(a2[1], a2[1], DMUL(a2[2], a2[2])));
    out.xy = DFMA(a1[0], a2[0], DFMA(a1[1], a2[1], DMUL(a1[2], a2[2])));
    VD c0 = DFNMA(a1[2], a2[1], DMUL(a1[1], a2[2]));
    VD c1 = DFNMA(a1[0], a2[2], DMUL(a1[2], a2[0]));
    VD c2 = DFNMA(a1[1], a2[0], DMUL(a1[0], a2[1]));
    out.det_sharp = DFMA(c0, c0, DFMA(c1, c1, DMUL(c2, c2)));
    return out;
}

/* log2 of a > 0, normal: exponent plus 2 / ln 2 (t + t^3/3 + ...), t = (m - 1) / (m + 1), with m in
 * 3/4..3/2; within 2e-7. */
TARGET static inline VF NAME(log2)(VF a) {
    VF e = EXPONENT(a), m = MANTISSA(a), one = SET1(1.0f);
    VM upper = GE(m, SET1(1.5f));
    m = PICK(upper, MUL(m, SET1(0.5f)), m);
    e = PICK(upper, ADD(e, one), e);
    VF t = DIV(SUB(m, one), ADD(m, one)), t2 = MUL(t, t);
    VF s = FMA(t2, SET1(1.0f / 9), SET1(1.0f / 7));
    s = FMA(s, t2, SET1(1.0f / 5));
    s = FMA(s, t2, SET1(1.0f / 3));
    s = FMA(s, t2, one);
    return FMA(MUL(s, t), SET1(2.88539008f), e);
}

/* Projects the Gaussians that lanes has bits for; returns the bits of those that are visible. in:
 * means, quats, scales and opacities, columns 16 floats apart. */
TARGET static inline unsigned NAME(project)(const lens *lens, const float *in, unsigned lanes,
                                            NAME(splats) *out, int64_t *overflowed) {
    enum { HALF = LANES / 2 };
    VF opacity = LOAD(in + 16 * 10);
    NAME(half) g[2];
    unsigned seen = 0, fits = 0;
    for (int h = 0; h < 2; h++) {
        VD column[10];
        for (int k = 0; k < 10; k++) column[k] = h ? HIGH(LOAD(in + 16 * k)) : LOW(LOAD(in + 16 * k));
        g[h] = NAME(geometry)(lens, column);
        VD o = h ? HIGH(opacity) : LOW(opacity), far_out = DSET1(OFFSCREEN_MAX);
        unsigned ahead = DLT_BITS(DSET1(lens->near_), g[h].z) & DLT_BITS(g[h].z, DSET1(lens->far_)) &
                         DLE_BITS(DSET1(lens->threshold), o);
        unsigned holds = DLE_BITS(DADD(g[h].xx, g[h].yy), DSET1(VARIANCE_MAX)) &
                         DLE_BITS(DABS(g[h].mean_x), far_out) & DLE_BITS(DABS(g[h].mean_y), far_out);
        seen |= ahead << (HALF * h);
        fits |= holds << (HALF * h);
    }
    seen &= lanes;
    *overflowed += __builtin_popcount(seen & ~fits);
    seen &= fits;
    if (!seen) return 0;

    VD eps = DSET1(lens->low_pass), eps_squared = DSET1(lens->low_pass * lens->low_pass), var_x[2], var_y[2], det[2];
    for (int h = 0; h < 2; h++) {
        var_x[h] = DADD(g[h].xx, eps);
        var_y[h] = DADD(g[h].yy, eps);
        det[h] = DADD(g[h].det_sharp, DFMA(eps, DADD(g[h].xx, g[h].yy), eps_squared));
    }
    VF width_x = SQRT(JOIN(var_x[0], var_x[1])), width_y = SQRT(JOIN(var_y[0], var_y[1]));
    VF root = SQRT(JOIN(det[0], det[1])), one = SET1(1.0f);
    if (lens->antialias)
        opacity = MUL(opacity, DIV(SQRT(JOIN(g[0].det_sharp, g[1].det_sharp)), root));
    VF least = SET1((float)lens->threshold);
    seen &= BITS(GE(opacity, least));
    /* alpha reaches the threshold where sigma <= ln(opacity / threshold) */
    VF ratio = MAX(DIV(opacity, least), one);
    VF reach = SQRT(MUL(NAME(log2)(ratio), SET1(1.38629436f))); /* 2 ln 2 */
    VF slack = SET1((float)(1 + RADIUS_SLACK)), pad = SET1((float)RADIUS_PAD), centre = SET1(0.5f);
    VF radius_x = FMA(MUL(reach, width_x), slack, pad);
    VF radius_y = FMA(MUL(reach, width_y), slack, pad);
    VF mean_x = JOIN(g[0].mean_x, g[1].mean_x), mean_y = JOIN(g[0].mean_y, g[1].mean_y);
    seen &= BITS(GE(ADD(mean_x, radius_x), centre)) & BITS(GE(ADD(mean_y, radius_y), centre)) &
            BITS(LE(SUB(mean_x, radius_x), SET1((float)lens->width - 0.5f))) &
            BITS(LE(SUB(mean_y, radius_y), SET1((float)lens->height - 0.5f)));
    if (!seen) return 0;

    /* u11 and u12 share one factor, so that their quotient, the tilt, is rounded only at the end. */
    VF share = DIV(one, MUL(width_y, root));
    VD share_low = LOW(share), share_high = HIGH(share), zero = DSET1(0.0);
    for (int h = 0; h < 2; h++) out->mean_x[h] = g[h].mean_x, out->mean_y[h] = g[h].mean_y;
    out->u11 = JOIN(DMUL(var_y[0], share_low), DMUL(var_y[1], share_high));
    out->u12 = JOIN(DFNMA(g[0].xy, share_low, zero), DFNMA(g[1].xy, share_high, zero));
    out->u22 = DIV(one, width_y);
    VF z = JOIN(g[0].z, g[1].z), wide = MUL(z, SET1(lens->depth_split));
    out->z = SUB(wide, SUB(wide, z));
    out->opacity = opacity;
    out->radius_x = radius_x;
    out->radius_y = radius_y;
    return seen;
}

/* Fills rows with records. */
TARGET static inline void NAME(pack)(const NAME(splats) *g, const VF color[3], VF ids, float floor_,
                                     float rows[LANES][16]) {
    VF unit = SET1(0.84932180028801907f); /* sqrt(log2(e) / 2) */
    VF u11 = MUL(g->u11, unit), u12 = MUL(g->u12, unit), u22 = MUL(g->u22, unit);
    VF middle = SET1(1.5f), slack = SET1(REACH_SLACK);
    VF level = NAME(log2)(g->opacity), reach = SUB(level, SET1(floor_));
    VD w[2], v[2];
    for (int h = 0; h < 2; h++) {
        VD a = h ? HIGH(u11) : LOW(u11), b = h ? HIGH(u12) : LOW(u12), c = h ? HIGH(u22) : LOW(u22);
        w[h] = DFMA(a, g->mean_x[h], DMUL(b, g->mean_y[h]));
        v[h] = DMUL(c, g->mean_y[h]);
    }
    VF columns[16] = {EVENS(w), ODDS(w), EVENS(v), ODDS(v),
                      ADD(FMA(reach, slack, reach), slack), ids,
                      MUL(middle, ADD(u11, ABS(u12))), MUL(middle, u22), u11, u22, u12, level,
                      color[0], color[1], color[2], g->z};
    NAME(transpose)(columns, rows);
}

/* See project_group in kernel.c. */
TARGET static int NAME(project_group)(const tsplat_scene *s, const lens *lens, int64_t first,
                                      int count, float *out, int64_t *overflowed) {
    _Alignas(64) float in[11 * 16], rows[LANES][16];
    for (int l = 0; l < LANES; l++) {
        int64_t i = first + (l < count ? l : 0); /* lanes to spare repeat the first */
        for (int k = 0; k < 3; k++) in[16 * k + l] = s->means[3 * i + k];
        for (int k = 0; k < 4; k++) in[16 * (3 + k) + l] = s->quats[4 * i + k];
        for (int k = 0; k < 3; k++) in[16 * (7 + k) + l] = s->scales[3 * i + k];
        in[16 * 10 + l] = s->opacities[i];
    }
    NAME(splats) g;
    unsigned seen = NAME(project)(lens, in, (1u << count) - 1, &g, overflowed);
    if (!seen) return 0;
    VF columns[16] = {EVENS(g.mean_x), ODDS(g.mean_x), EVENS(g.mean_y), ODDS(g.mean_y),
                      g.u11, g.u12, g.u22, g.opacity, g.radius_x, g.radius_y};
    for (int k = 10; k < 16; k++) columns[k] = g.z;
    NAME(transpose)(columns, rows);
    _Alignas(64) float color[3][LANES];
    int32_t ids[LANES];
    for (int l = 0; l < LANES; l++) ids[l] = (int32_t)(first + l);
    NAME(colors)(s, lens, in, ids, seen, color);
    int kept = __builtin_popcount(seen);
    for (; seen; seen &= seen - 1, out += RECORD) {
        int l = __builtin_ctz(seen);
        for (int c = 0; c < 3; c++) rows[l][11 + c] = color[c][l];
        memcpy(rows[l] + 14, ids + l, sizeof *ids);
        memcpy(out, rows[l], sizeof rows[l]);
    }
    return kept;
}

/* See pack_group in kernel.c. */
TARGET static void NAME(pack_group)(const tsplat_splats *s, int64_t first, int count, float floor_,
                                    record *out) {
    _Alignas(64) double mean[2][LANES];
    _Alignas(64) float in[8][LANES], rows[LANES][16];
    for (int l = 0; l < LANES; l++) {
        int64_t i = first + (l < count ? l : 0);
        for (int k = 0; k < 2; k++) mean[k][l] = s->means2d[2 * i + k];
        for (int k = 0; k < 3; k++) in[k][l] = s->factors[3 * i + k];
        for (int k = 0; k < 3; k++) in[3 + k][l] = s->colors[3 * i + k];
        in[6][l] = s->opacities[i];
        in[7][l] = s->depths[i];
    }
    VF color[3] = {LOAD(in[3]), LOAD(in[4]), LOAD(in[5])};
    NAME(splats) g = {.mean_x = {DLOAD(mean[0]), DLOAD(mean[0] + LANES / 2)},
                      .mean_y = {DLOAD(mean[1]), DLOAD(mean[1] + LANES / 2)},
                      .u11 = LOAD(in[0]), .u12 = LOAD(in[1]), .u22 = LOAD(in[2]),
                      .opacity = LOAD(in[6]), .z = LOAD(in[7])};
    NAME(pack)(&g, color, g.z, floor_, rows);
    memcpy(out, rows, sizeof rows[0] * (size_t)count);
}

/* See project_chunk in kernel.c. */
TARGET static int NAME(project_chunk)(const tsplat_packed *packed, const tsplat_scene *s,
                                      const lens *lens, float floor_, int64_t first, int count,
                                      const tsplat_space *to, int32_t *steps, int64_t *totals) {
    _Alignas(64) float rows[LANES][16], color[3][LANES];
    _Alignas(64) int32_t first_tile[LANES], last_tile[LANES], corner[4][LANES];
    record *records = (record *)(void *)to->records + first;
    box *boxes = (box *)(void *)to->boxes + first;
    VF half = SET1(0.5f), zero = SET1(0.0f), minus = SET1(-1.0f), per_tile = SET1(1.0f / TILE);
    VF right = SET1((float)(lens->width - 1)), bottom = SET1((float)(lens->height - 1));
    VI stride = ISET1((lens->width + TILE - 1) / TILE + 1);
    int used = 0;
    for (int i = 0; i < count; i += LANES) {
        const float *in = packed->columns + (first + i) / 16 * 16 * packed->width + i % 16;
        for (int k = 0; k < packed->width; k++) PREFETCH(in + 16 * (packed->width + k)); /* the next */
        NAME(splats) g;
        unsigned lanes = count - i < LANES ? (1u << (count - i)) - 1 : (1u << LANES) - 1;
        unsigned seen = NAME(project)(lens, in, lanes, &g, totals + 1);
        totals[0] += __builtin_popcount(seen);
        if (!seen) continue;
        if (lens->sh_degree) fetch_sh(s, packed, first + i + LANES, LANES);
        /* the tiles with pixels whose centres its box holds, which may be 1e9 px wide: cut to the
         * picture before it is rounded to whole pixels, as not all of FLOOR take so much */
        VF x = JOIN(g.mean_x[0], g.mean_x[1]), y = JOIN(g.mean_y[0], g.mean_y[1]);
        VF x0 = CEIL(MIN(MAX(SUB(SUB(x, g.radius_x), half), zero), right));
        VF y0 = CEIL(MIN(MAX(SUB(SUB(y, g.radius_y), half), zero), bottom));
        VF x1 = FLOOR(MIN(MAX(SUB(ADD(x, g.radius_x), half), minus), right));
        VF y1 = FLOOR(MIN(MAX(SUB(ADD(y, g.radius_y), half), minus), bottom));
        seen &= BITS(LE(x0, x1)) & BITS(LE(y0, y1));
        if (!seen) continue;
        VI u0 = TRUNCATE(MUL(x0, per_tile)), v0 = TRUNCATE(MUL(y0, per_tile));
        VI u1 = TRUNCATE(MUL(x1, per_tile)), v1 = TRUNCATE(MUL(y1, per_tile)), next = ISET1(1);
        ISTORE(first_tile, IADD(u0, IMUL(v0, ISET1(65536))));
        ISTORE(last_tile, IADD(u1, IMUL(v1, ISET1(65536))));
        /* where sums over rows and columns begin and end to count the box */
        VI top = IMUL(v0, stride), below = IMUL(IADD(v1, next), stride);
        u1 = IADD(u1, next);
        ISTORE(corner[0], IADD(top, u0)), ISTORE(corner[1], IADD(top, u1));
        ISTORE(corner[2], IADD(below, u0)), ISTORE(corner[3], IADD(below, u1));
        VF ids = LOAD(in + 16 * 11);
        if (packed->width > TSPLAT_COLUMNS) {
            for (int c = 0; c < 3; c++) STORE(color[c], LOAD(in + 16 * (12 + c)));
        } else {
            const int32_t *rows_of = (const int32_t *)(const void *)(in + 16 * 11);
            int64_t group = (first + i) / 16;
            unsigned known = packed->colors ? packed->kept[group] >> (i % 16) & seen : 0;
            NAME(colors)(s, lens, in, rows_of, seen & ~known, color);
            if (packed->colors) {
                float *store = packed->colors + group * 48 + i % 16;
                for (unsigned left = seen; left; left &= left - 1) {
                    int l = __builtin_ctz(left), old = known >> l & 1;
                    for (int c = 0; c < 3; c++)
                        if (old) color[c][l] = store[16 * c + l];
                        else store[16 * c + l] = color[c][l];
                }
                packed->kept[group] |= (uint16_t)(seen << (i % 16));
                totals[2] += __builtin_popcount(known);
            }
        }
        VF rgb[3] = {LOAD(color[0]), LOAD(color[1]), LOAD(color[2])};
        NAME(pack)(&g, rgb, ids, floor_, rows);
        for (; seen; seen &= seen - 1, used++) {
            int l = __builtin_ctz(seen);
            float *out = (float *)(void *)(records + used);
            for (int k = 0; k < 16; k += 4) STREAM(out + k, *(const four *)(rows[l] + k));
            to->depths[first + used] = rows[l][15];
            boxes[used] = (box){first_tile[l], last_tile[l]};
            steps[corner[0][l]]++, steps[corner[1][l]]--;
            steps[corner[2][l]]--, steps[corner[3][l]]++;
        }
    }
    return used;
}
