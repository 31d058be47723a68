/* Sixteen lanes: AVX-512 F, DQ, BW and VL. */
#define NAME(f) f##_avx512
#define TARGET __attribute__((target("avx512f,avx512dq,avx512bw,avx512vl,avx2,fma,f16c,bmi,bmi2,lzcnt,popcnt")))
#define LANES 16
#define WIDE 1
#define VF __m512
#define VM __mmask16
#define LOAD(p) _mm512_load_ps(p)
#define STORE(p, v) _mm512_store_ps(p, v)
#define SET1(x) _mm512_set1_ps(x)
#define ADD(a, b) _mm512_add_ps(a, b)
#define SUB(a, b) _mm512_sub_ps(a, b)
#define MUL(a, b) _mm512_mul_ps(a, b)
#define FMA(a, b, c) _mm512_fmadd_ps(a, b, c)
#define FNMA(a, b, c) _mm512_fnmadd_ps(a, b, c)
#define MIN(a, b) _mm512_min_ps(a, b)
#define MAX(a, b) _mm512_max_ps(a, b)
#define ABS(a) _mm512_abs_ps(a)
#define GE(a, b) _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ)
#define LE(a, b) _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ)
#define PICK(m, a, b) _mm512_mask_mov_ps(b, m, a)
#define BITS(m) ((unsigned)(m))
#define GT(a, b) _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ)
#define KEEP(m, a) _mm512_maskz_mov_ps(m, a)
#define OR(a, b) _mm512_or_ps(a, b)
#define FLOOR(a) _mm512_roundscale_ps(a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC)
#define CEIL(a) _mm512_roundscale_ps(a, _MM_FROUND_TO_POS_INF | _MM_FROUND_NO_EXC)
#define FRACTION(x) _mm512_reduce_ps(x, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC)
#define SCALE(m, p, x) _mm512_maskz_scalef_ps(m, p, x) /* 2^floor(x) p, or 0 */
#define EVENS(h) split_avx512((h)[0], (h)[1], 0)
#define ODDS(h) split_avx512((h)[0], (h)[1], 1)

/* As many integers. */
#define VI __m512i
#define ILOAD(p) _mm512_load_si512(p)
#define ISTORE(p, v) _mm512_store_si512(p, v)
#define ISET1(x) _mm512_set1_epi32(x)
#define IADD(a, b) _mm512_add_epi32(a, b)
#define IMUL(a, b) _mm512_mullo_epi32(a, b)
#define TRUNCATE(a) _mm512_cvttps_epi32(a)
#define COUNT_LESS(n, a, b) /* n + 1 where a < b */ \
    _mm512_mask_sub_epi32(n, _mm512_cmplt_epi32_mask(a, b), n, _mm512_set1_epi32(-1))

#define EIGHT_HALVES(to, from) \
    _mm256_storeu_ps(to, _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)(from))))

/* Half as many doubles. */
#define VD __m512d
#define DLOAD(p) _mm512_load_pd(p)
#define DSTORE(p, v) _mm512_store_pd(p, v)
#define DSET1(x) _mm512_set1_pd(x)
#define DADD(a, b) _mm512_add_pd(a, b)
#define DSUB(a, b) _mm512_sub_pd(a, b)
#define DMUL(a, b) _mm512_mul_pd(a, b)
#define DDIV(a, b) _mm512_div_pd(a, b)
#define DFMA(a, b, c) _mm512_fmadd_pd(a, b, c)
#define DFNMA(a, b, c) _mm512_fnmadd_pd(a, b, c)
#define DMIN(a, b) _mm512_min_pd(a, b)
#define DMAX(a, b) _mm512_max_pd(a, b)
#define DABS(a) _mm512_abs_pd(a)
#define DLT_BITS(a, b) ((unsigned)_mm512_cmp_pd_mask(a, b, _CMP_LT_OQ))
#define DLE_BITS(a, b) ((unsigned)_mm512_cmp_pd_mask(a, b, _CMP_LE_OQ))
#define DSQRT(a) _mm512_sqrt_pd(a)
#define LOW(a) _mm512_cvtps_pd(_mm512_castps512_ps256(a))
#define HIGH(a) _mm512_cvtps_pd(_mm512_extractf32x8_ps(a, 1))
#define JOIN(a, b) _mm512_insertf32x8( \
    _mm512_castps256_ps512(_mm512_cvtpd_ps(a)), _mm512_cvtpd_ps(b), 1)
#define DIV(a, b) _mm512_div_ps(a, b)
#define SQRT(a) _mm512_sqrt_ps(a)
#define EXPONENT(a) _mm512_getexp_ps(a)
#define MANTISSA(a) _mm512_getmant_ps(a, _MM_MANT_NORM_1_2, _MM_MANT_SIGN_zero)

/* The low or the high words of sixteen doubles. */
TARGET static inline __m512 split_avx512(__m512d a, __m512d b, int high) {
    const __m512i evens = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    __m512i which = high ? _mm512_add_epi32(evens, _mm512_set1_epi32(1)) : evens;
    return _mm512_permutex2var_ps(_mm512_castpd_ps(a), which, _mm512_castpd_ps(b));
}

/* See vec_generic.h for these two. */
TARGET static inline void transpose_avx512(const __m512 c[16], float rows[16][16]) {
    __m512 a[16], b[16];
    for (int i = 0; i < 16; i += 2) {
        a[i] = _mm512_unpacklo_ps(c[i], c[i + 1]);
        a[i + 1] = _mm512_unpackhi_ps(c[i], c[i + 1]);
    }
    for (int i = 0; i < 16; i += 4) {
        b[i] = _mm512_shuffle_ps(a[i], a[i + 2], 0x44);
        b[i + 1] = _mm512_shuffle_ps(a[i], a[i + 2], 0xee);
        b[i + 2] = _mm512_shuffle_ps(a[i + 1], a[i + 3], 0x44);
        b[i + 3] = _mm512_shuffle_ps(a[i + 1], a[i + 3], 0xee);
    }
    for (int i = 0; i < 4; i++) { /* b[i + 4 k] holds columns 4 k.. of rows i, i + 4, i + 8, i + 12 */
        __m512 lo = _mm512_shuffle_f32x4(b[i], b[i + 4], 0x88), hi = _mm512_shuffle_f32x4(b[i], b[i + 4], 0xdd);
        __m512 lo2 = _mm512_shuffle_f32x4(b[i + 8], b[i + 12], 0x88);
        __m512 hi2 = _mm512_shuffle_f32x4(b[i + 8], b[i + 12], 0xdd);
        STORE(rows[i], _mm512_shuffle_f32x4(lo, lo2, 0x88));
        STORE(rows[i + 4], _mm512_shuffle_f32x4(hi, hi2, 0x88));
        STORE(rows[i + 8], _mm512_shuffle_f32x4(lo, lo2, 0xdd));
        STORE(rows[i + 12], _mm512_shuffle_f32x4(hi, hi2, 0xdd));
    }
}

TARGET static inline uint32_t list_avx512(uint32_t *to, const uint16_t *hits, int count, int block) {
    __m256i bit = _mm256_set1_epi16((short)(1 << block));
    __m512i step = _mm512_set1_epi32(16 * (int)sizeof(placed));
    __m512i entry = _mm512_mullo_epi32(_mm512_set1_epi32((int)sizeof(placed)), _mm512_setr_epi32(
        0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15));
    entry = _mm512_add_epi32(entry, _mm512_set1_epi32(block * (int)sizeof PIXEL_X[0] << 16));
    uint32_t *begin = to;
    for (int j = 0; j < count; j += 16, entry = _mm512_add_epi32(entry, step)) {
        __mmask16 hit = _mm256_test_epi16_mask(_mm256_load_si256((const __m256i *)(const void *)(hits + j)), bit);
        _mm512_storeu_si512(to, _mm512_maskz_compress_epi32(hit, entry));
        to += __builtin_popcount(hit);
    }
    return (uint32_t)(to - begin);
}

/* Sixteen pixels of row y, one channel. */
TARGET static inline __m512 row_avx512(const pixels *blocks, ptrdiff_t channel, int y) {
    const char *at = (const char *)(blocks + y / 4 * 4) + channel + y % 4 * 16;
#define FROM(k) _mm_load_ps((const float *)(const void *)(at + (k) * sizeof(pixels)))
    __m512 row = _mm512_castps128_ps512(FROM(0));
    row = _mm512_insertf32x4(row, FROM(1), 1);
    row = _mm512_insertf32x4(row, FROM(2), 2);
    return _mm512_insertf32x4(row, FROM(3), 3);
#undef FROM
}

/* Writes a row of a tile past the caches. */
TARGET static inline void stream_row_avx512(const tile *s, int y, float *rgb, float *t) {
    __m512 r = row_avx512(s->pixels, offsetof(pixels, r), y);
    __m512 g = row_avx512(s->pixels, offsetof(pixels, g), y);
    __m512 b = row_avx512(s->pixels, offsetof(pixels, b), y);
    for (int k = 0; k < 3; k++) { /* float i of the row is channel i % 3 of pixel i / 3 */
        __m512i i = _mm512_add_epi32(_mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15),
                                     _mm512_set1_epi32(16 * k));
        __m512i pixel = _mm512_srli_epi32(_mm512_mullo_epi32(i, _mm512_set1_epi32(21846)), 16);
        __m512i channel = _mm512_sub_epi32(i, _mm512_mullo_epi32(pixel, _mm512_set1_epi32(3)));
        __m512i which = _mm512_add_epi32(pixel, _mm512_slli_epi32(_mm512_and_epi32(channel, _mm512_set1_epi32(1)), 4));
        __m512 mixed = _mm512_permutex2var_ps(r, which, g);
        __mmask16 blue = _mm512_cmpeq_epi32_mask(channel, _mm512_set1_epi32(2));
        _mm512_stream_ps(rgb + 16 * k, _mm512_mask_permutexvar_ps(mixed, blue, pixel, b));
    }
    _mm512_stream_ps(t, _mm512_abs_ps(row_avx512(s->pixels, offsetof(pixels, t), y)));
}
#define STREAM_ROW(s, y, rgb, t) stream_row_avx512(s, y, rgb, t)

#include "composite_template.h"
#include "color_template.h"
#include "project_template.h"
#include "order_template.h"
#include "vec_undef.h"
