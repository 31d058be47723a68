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

/* in: means, quats, scales as columns of LANES floats; half 0 or 1. */
TARGET static inline NAME(half) NAME(geometry)(const tsplat_camera *cam, const VD in[10]) {
    const double *R = cam->rotation;
    NAME(half) out;
#define R_(i) DSET1(R[i])
    VD dx = DSUB(in[0], DSET1(cam->centre[0])), dy = DSUB(in[1], DSET1(cam->centre[1]));
    VD dz = DSUB(in[2], DSET1(cam->centre[2]));
    /* In this order and without FMA: the depth's bits are the contract's. */
    out.z = DADD(DADD(DMUL(R_(6), dx), DMUL(R_(7), dy)), DMUL(R_(8), dz));
    VD px = DADD(DADD(DMUL(R_(0), dx), DMUL(R_(1), dy)), DMUL(R_(2), dz));
    VD py = DADD(DADD(DMUL(R_(3), dx), DMUL(R_(4), dy)), DMUL(R_(5), dz));
    VD near_by = DDIV(DSET1(1.0), out.z), slope_x = DMUL(px, near_by), slope_y = DMUL(py, near_by);
    VD fx = DSET1(cam->fx), fy = DSET1(cam->fy);
    out.mean_x = DFMA(fx, slope_x, DSET1(cam->cx));
    out.mean_y = DFMA(fy, slope_y, DSET1(cam->cy));

    double margin_x = CLAMP_MARGIN * cam->width / (2 * cam->fx);
    double margin_y = CLAMP_MARGIN * cam->height / (2 * cam->fy);
    VD u = DMIN(DMAX(slope_x, DSET1(-cam->cx / cam->fx - margin_x)),
                DSET1((cam->width - cam->cx) / cam->fx + margin_x));
    VD v = DMIN(DMAX(slope_y, DSET1(-cam->cy / cam->fy - margin_y)),
                DSET1((cam->height - cam->cy) / cam->fy + margin_y));
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

/* See project_group in kernel.c. */
TARGET static int NAME(project_group)(const tsplat_scene *s, const tsplat_camera *cam,
                                      const tsplat_params *p, double threshold, int64_t first,
                                      int count, float *out, int64_t *overflowed) {
    enum { HALF = LANES / 2 };
    _Alignas(64) float column[11][LANES];
    for (int l = 0; l < LANES; l++) {
        int64_t i = first + (l < count ? l : 0); /* lanes to spare repeat the first */
        for (int k = 0; k < 3; k++) column[k][l] = s->means[3 * i + k];
        for (int k = 0; k < 4; k++) column[3 + k][l] = s->quats[4 * i + k];
        for (int k = 0; k < 3; k++) column[7 + k][l] = s->scales[3 * i + k];
        column[10][l] = s->opacities[i];
    }
    VF opacity = LOAD(column[10]);
    NAME(half) g[2];
    unsigned seen = 0, fits = 0;
    for (int h = 0; h < 2; h++) {
        VD in[10];
        for (int k = 0; k < 10; k++) in[k] = h ? HIGH(LOAD(column[k])) : LOW(LOAD(column[k]));
        g[h] = NAME(geometry)(cam, in);
        VD o = h ? HIGH(opacity) : LOW(opacity), far_out = DSET1(OFFSCREEN_MAX);
        unsigned ahead = DLT_BITS(DSET1(cam->near_), g[h].z) & DLT_BITS(g[h].z, DSET1(cam->far_)) &
                         DLE_BITS(DSET1(threshold), o);
        unsigned holds = DLE_BITS(DADD(g[h].xx, g[h].yy), DSET1(VARIANCE_MAX)) &
                         DLE_BITS(DABS(g[h].mean_x), far_out) & DLE_BITS(DABS(g[h].mean_y), far_out);
        seen |= ahead << (HALF * h);
        fits |= holds << (HALF * h);
    }
    seen &= (1u << count) - 1;
    *overflowed += __builtin_popcount(seen & ~fits);
    seen &= fits;
    if (!seen) return 0;

    VD eps = DSET1(EPS2D), eps_squared = DSET1(EPS2D * EPS2D), var_x[2], var_y[2], det[2];
    for (int h = 0; h < 2; h++) {
        var_x[h] = DADD(g[h].xx, eps);
        var_y[h] = DADD(g[h].yy, eps);
        det[h] = DADD(g[h].det_sharp, DFMA(eps, DADD(g[h].xx, g[h].yy), eps_squared));
    }
    VF width_x = SQRT(JOIN(var_x[0], var_x[1])), width_y = SQRT(JOIN(var_y[0], var_y[1]));
    VF root = SQRT(JOIN(det[0], det[1])), one = SET1(1.0f);
    if (p->antialias)
        opacity = MUL(opacity, DIV(SQRT(JOIN(g[0].det_sharp, g[1].det_sharp)), root));
    VF least = SET1((float)threshold);
    seen &= BITS(GE(opacity, least));
    /* alpha reaches the threshold where sigma <= ln(opacity / threshold) */
    VF ratio = MAX(DIV(opacity, least), one);
    VF reach = SQRT(MUL(NAME(log2)(ratio), SET1(1.38629436f))); /* 2 ln 2 */
    VF slack = SET1((float)(1 + RADIUS_SLACK)), pad = SET1((float)RADIUS_PAD), centre = SET1(0.5f);
    VF radius_x = FMA(MUL(reach, width_x), slack, pad);
    VF radius_y = FMA(MUL(reach, width_y), slack, pad);
    VF mean_x = JOIN(g[0].mean_x, g[1].mean_x), mean_y = JOIN(g[0].mean_y, g[1].mean_y);
    seen &= BITS(GE(ADD(mean_x, radius_x), centre)) & BITS(GE(ADD(mean_y, radius_y), centre)) &
            BITS(LE(SUB(mean_x, radius_x), SET1((float)cam->width - 0.5f))) &
            BITS(LE(SUB(mean_y, radius_y), SET1((float)cam->height - 0.5f)));
    if (!seen) return 0;

    /* u11 and u12 share one factor, so that their quotient, the tilt, is rounded only at the end. */
    VF share = DIV(one, MUL(width_y, root));
    VD share_low = LOW(share), share_high = HIGH(share), zero = DSET1(0.0);
    _Alignas(64) float field[7][LANES];
    _Alignas(64) double mean[2][LANES];
    for (int h = 0; h < 2; h++) {
        DSTORE(mean[0] + HALF * h, g[h].mean_x);
        DSTORE(mean[1] + HALF * h, g[h].mean_y);
    }
    STORE(field[0], JOIN(DMUL(var_y[0], share_low), DMUL(var_y[1], share_high)));
    STORE(field[1], JOIN(DFNMA(g[0].xy, share_low, zero), DFNMA(g[1].xy, share_high, zero)));
    STORE(field[2], DIV(one, width_y));
    STORE(field[3], JOIN(g[0].z, g[1].z));
    STORE(field[4], opacity);
    STORE(field[5], radius_x);
    STORE(field[6], radius_y);
    int kept = 0;
    for (; seen; seen &= seen - 1, kept++, out += RECORD) {
        int l = __builtin_ctz(seen);
        memcpy(out, &mean[0][l], sizeof(double)); /* two floats' room each */
        memcpy(out + 2, &mean[1][l], sizeof(double));
        for (int k = 0; k < 5; k++) out[4 + k] = field[k][l];
        sh_color(s, cam, p->sh_degree, first + l, out + 9);
        out[12] = field[5][l];
        out[13] = field[6][l];
        int32_t id = (int32_t)(first + l);
        memcpy(out + 14, &id, sizeof id);
    }
    return kept;
}
