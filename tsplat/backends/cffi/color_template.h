/* Colours of LANES Gaussians; a template, instantiated once per instruction set. The harmonics are
 * worked out for all at once; the coefficients lie Gaussian by Gaussian, RGB last. */

/* The real spherical harmonics of the directions from the camera, see reference.sh_basis. */
TARGET static inline void NAME(harmonics)(const lens *lens, const float *means, float rows[LANES][16]) {
    VF mean[3] = {LOAD(means), LOAD(means + 16), LOAD(means + 32)}, direction[3];
    VD d[3][2], inverse[2];
    for (int h = 0; h < 2; h++) {
        for (int k = 0; k < 3; k++)
            d[k][h] = DSUB(h ? HIGH(mean[k]) : LOW(mean[k]), DSET1(lens->centre[k]));
        VD square = DFMA(d[0][h], d[0][h], DFMA(d[1][h], d[1][h], DMUL(d[2][h], d[2][h])));
        inverse[h] = DDIV(DSET1(1.0), DSQRT(square));
    }
    for (int k = 0; k < 3; k++)
        direction[k] = JOIN(DMUL(d[k][0], inverse[0]), DMUL(d[k][1], inverse[1]));
    VF x = direction[0], y = direction[1], z = direction[2];
    VF xx = MUL(x, x), yy = MUL(y, y), zz = MUL(z, z), two = SET1(2.0f), three = SET1(3.0f);
    VF xy = MUL(x, y), difference = SUB(xx, yy), four_zz = FMA(SET1(4.0f), zz, SUB(SET1(0.0f), ADD(xx, yy)));
#define TIMES(c, a) MUL(SET1((float)(c)), a)
    VF columns[16] = {
        SET1((float)SH_C0),
        TIMES(-SH_C1, y), TIMES(SH_C1, z), TIMES(-SH_C1, x),
        TIMES(SH_C2_0, xy), TIMES(SH_C2_1, MUL(y, z)),
        TIMES(SH_C2_2, FMA(two, zz, SUB(SET1(0.0f), ADD(xx, yy)))),
        TIMES(SH_C2_3, MUL(x, z)), TIMES(SH_C2_4, difference),
        TIMES(SH_C3_0, MUL(y, FMA(three, xx, SUB(SET1(0.0f), yy)))), TIMES(SH_C3_1, MUL(xy, z)),
        TIMES(SH_C3_2, MUL(y, four_zz)),
        TIMES(SH_C3_3, MUL(z, FNMA(three, ADD(xx, yy), MUL(two, zz)))),
        TIMES(SH_C3_4, MUL(x, four_zz)), TIMES(SH_C3_5, MUL(z, difference)),
        TIMES(SH_C3_6, MUL(x, FNMA(three, yy, xx)))};
#undef TIMES
    NAME(transpose)(columns, rows);
}

/* max(0, 0.5 + sum of harmonics times coefficients) for the Gaussians that lanes has bits for; means
 * are columns 16 floats apart, ids their rows in the scene. */
TARGET static inline void NAME(colors)(const tsplat_scene *s, const lens *lens, const float *means,
                                       const int32_t *ids, unsigned lanes, float color[3][LANES]) {
    _Alignas(64) float rows[LANES][16], sh[64] = {0};
    int terms = (lens->sh_degree + 1) * (lens->sh_degree + 1);
    if (terms > 1) NAME(harmonics)(lens, means, rows);
    for (; lanes; lanes &= lanes - 1) {
        int l = __builtin_ctz(lanes);
        int64_t at = 3LL * ids[l] * s->coefficients;
        if (terms == 1) {
            float plain[3];
            plain_color(s, ids[l], plain);
            for (int c = 0; c < 3; c++) color[c][l] = plain[c];
            continue;
        }
        if (s->half) {
            _Alignas(64) uint16_t half[64] = {0};
            const uint16_t *from = (const uint16_t *)s->sh + at;
            if (terms == 16) memcpy(half, from, 48 * sizeof *half); /* a fixed size is no call */
            if (terms == 9) memcpy(half, from, 27 * sizeof *half);
            if (terms == 4) memcpy(half, from, 12 * sizeof *half);
            for (int k = 0; k < 3 * terms; k += 8) EIGHT_HALVES(sh + k, half + k);
        } else {
            const float *from = (const float *)s->sh + at;
            if (terms == 16) memcpy(sh, from, 48 * sizeof *sh);
            if (terms == 9) memcpy(sh, from, 27 * sizeof *sh);
            if (terms == 4) memcpy(sh, from, 12 * sizeof *sh);
        }
        four even = {0.5f, 0.5f, 0.5f, 0}, odd = {0}; /* two sums, as each step waits for the last */
        for (int k = 0; k + 1 < terms; k += 2) {
            even += rows[l][k] * *(const four *)(sh + 3 * k);
            odd += rows[l][k + 1] * *(const four *)(sh + 3 * k + 3);
        }
        if (terms % 2) even += rows[l][terms - 1] * *(const four *)(sh + 3 * terms - 3);
        even += odd;
        for (int c = 0; c < 3; c++) color[c][l] = even[c] > 0 ? even[c] : 0;
    }
}
