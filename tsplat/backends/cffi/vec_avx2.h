/* Eight lanes: AVX2 and FMA. */
#define NAME(f) f##_avx2
#define TARGET __attribute__((target("avx2,fma,f16c,bmi,bmi2,lzcnt,popcnt")))
#define LANES 8
#define WIDE 2
#define VF __m256
#define VM __m256
#define LOAD(p) _mm256_load_ps(p)
#define STORE(p, v) _mm256_store_ps(p, v)
#define SET1(x) _mm256_set1_ps(x)
#define ADD(a, b) _mm256_add_ps(a, b)
#define SUB(a, b) _mm256_sub_ps(a, b)
#define MUL(a, b) _mm256_mul_ps(a, b)
#define FMA(a, b, c) _mm256_fmadd_ps(a, b, c)
#define FNMA(a, b, c) _mm256_fnmadd_ps(a, b, c)
#define MIN(a, b) _mm256_min_ps(a, b)
#define MAX(a, b) _mm256_max_ps(a, b)
#define ABS(a) _mm256_andnot_ps(_mm256_set1_ps(-0.0f), a)
#define GE(a, b) _mm256_cmp_ps(a, b, _CMP_GE_OQ)
#define LE(a, b) _mm256_cmp_ps(a, b, _CMP_LE_OQ)
#define PICK(m, a, b) _mm256_blendv_ps(b, a, m)
#define BITS(m) ((unsigned)_mm256_movemask_ps(m))
#define GT(a, b) _mm256_cmp_ps(a, b, _CMP_GT_OQ)
#define KEEP(m, a) _mm256_and_ps(m, a)
#define OR(a, b) _mm256_or_ps(a, b)
#define FLOOR(a) _mm256_floor_ps(a)
#define CEIL(a) _mm256_ceil_ps(a)
#define FRACTION(x) _mm256_sub_ps(x, FLOOR(x))
#define SCALE(m, p, x) _mm256_and_ps(m, _mm256_castsi256_ps(_mm256_add_epi32( /* 2^floor(x) p, or 0 */ \
    _mm256_castps_si256(p), _mm256_slli_epi32(_mm256_cvtps_epi32(FLOOR(x)), 23))))
#define EVENS(h) split_avx2((h)[0], (h)[1], 0)
#define ODDS(h) split_avx2((h)[0], (h)[1], 1)

/* As many integers. */
#define VI __m256i
#define ILOAD(p) _mm256_load_si256((const __m256i *)(const void *)(p))
#define ISTORE(p, v) _mm256_store_si256((__m256i *)(void *)(p), v)
#define ISET1(x) _mm256_set1_epi32(x)
#define IADD(a, b) _mm256_add_epi32(a, b)
#define IMUL(a, b) _mm256_mullo_epi32(a, b)
#define TRUNCATE(a) _mm256_cvttps_epi32(a)
#define COUNT_LESS(n, a, b) _mm256_sub_epi32(n, _mm256_cmpgt_epi32(b, a)) /* n + 1 where a < b */

#define EIGHT_HALVES(to, from) \
    _mm256_storeu_ps(to, _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(const void *)(from))))

/* Half as many doubles. */
#define VD __m256d
#define DLOAD(p) _mm256_load_pd(p)
#define DSTORE(p, v) _mm256_store_pd(p, v)
#define DSET1(x) _mm256_set1_pd(x)
#define DADD(a, b) _mm256_add_pd(a, b)
#define DSUB(a, b) _mm256_sub_pd(a, b)
#define DMUL(a, b) _mm256_mul_pd(a, b)
#define DDIV(a, b) _mm256_div_pd(a, b)
#define DFMA(a, b, c) _mm256_fmadd_pd(a, b, c)
#define DFNMA(a, b, c) _mm256_fnmadd_pd(a, b, c)
#define DMIN(a, b) _mm256_min_pd(a, b)
#define DMAX(a, b) _mm256_max_pd(a, b)
#define DABS(a) _mm256_andnot_pd(_mm256_set1_pd(-0.0), a)
#define DLT_BITS(a, b) ((unsigned)_mm256_movemask_pd(_mm256_cmp_pd(a, b, _CMP_LT_OQ)))
#define DLE_BITS(a, b) ((unsigned)_mm256_movemask_pd(_mm256_cmp_pd(a, b, _CMP_LE_OQ)))
#define DSQRT(a) _mm256_sqrt_pd(a)
#define LOW(a) _mm256_cvtps_pd(_mm256_castps256_ps128(a))
#define HIGH(a) _mm256_cvtps_pd(_mm256_extractf128_ps(a, 1))
#define JOIN(a, b) _mm256_set_m128(_mm256_cvtpd_ps(b), _mm256_cvtpd_ps(a))
#define DIV(a, b) _mm256_div_ps(a, b)
#define SQRT(a) _mm256_sqrt_ps(a)
#define EXPONENT(a) _mm256_cvtepi32_ps(_mm256_sub_epi32( \
    _mm256_srli_epi32(_mm256_castps_si256(a), 23), _mm256_set1_epi32(127)))
#define MANTISSA(a) _mm256_or_ps(_mm256_and_ps(a, \
    _mm256_castsi256_ps(_mm256_set1_epi32(0x007fffff))), _mm256_set1_ps(1.0f))

/* The low or the high words of eight doubles. */
TARGET static inline __m256 split_avx2(__m256d a, __m256d b, int high) {
    __m256 x = _mm256_castpd_ps(a), y = _mm256_castpd_ps(b);
    __m256 mixed = high ? _mm256_shuffle_ps(x, y, 0xdd) : _mm256_shuffle_ps(x, y, 0x88);
    return _mm256_castpd_ps(_mm256_permute4x64_pd(_mm256_castps_pd(mixed), 0xd8));
}

/* See vec_generic.h for these two. */
TARGET static inline void transpose_avx2(const __m256 columns[16], float rows[8][16]) {
    for (int k = 0; k < 16; k += 8) {
        __m256 a[8], b[8];
        const __m256 *c = columns + k;
        for (int i = 0; i < 4; i++) {
            a[2 * i] = _mm256_unpacklo_ps(c[2 * i], c[2 * i + 1]);
            a[2 * i + 1] = _mm256_unpackhi_ps(c[2 * i], c[2 * i + 1]);
        }
        for (int i = 0; i < 8; i += 4) {
            b[i] = _mm256_shuffle_ps(a[i], a[i + 2], 0x44);
            b[i + 1] = _mm256_shuffle_ps(a[i], a[i + 2], 0xee);
            b[i + 2] = _mm256_shuffle_ps(a[i + 1], a[i + 3], 0x44);
            b[i + 3] = _mm256_shuffle_ps(a[i + 1], a[i + 3], 0xee);
        }
        for (int i = 0; i < 4; i++) {
            STORE(rows[i] + k, _mm256_permute2f128_ps(b[i], b[i + 4], 0x20));
            STORE(rows[i + 4] + k, _mm256_permute2f128_ps(b[i], b[i + 4], 0x31));
        }
    }
}

TARGET static inline uint64_t splats_on_avx2(const uint16_t *hits, int block) {
    uint64_t splats = 0;
    for (int j = 0; j < 64; j += 32) { /* the bit becomes the sign, words become bytes */
        const __m256i *from = (const __m256i *)(const void *)(hits + j);
        __m256i a = _mm256_slli_epi16(_mm256_load_si256(from), 15 - block);
        __m256i b = _mm256_slli_epi16(_mm256_load_si256(from + 1), 15 - block);
        __m256i bytes = _mm256_permute4x64_epi64(_mm256_packs_epi16(a, b), 0xd8);
        splats |= (uint64_t)(uint32_t)_mm256_movemask_epi8(bytes) << j;
    }
    return splats;
}

TARGET static inline uint32_t list_avx2(uint32_t *to, const uint16_t *hits, int count, int block) {
    uint32_t found = 0, offset = (uint32_t)block * sizeof PIXEL_X[0] << 16;
    for (int j = 0; j < count; j += 64) {
        uint64_t splats = splats_on_avx2(hits + j, block);
        uint32_t *next = to + found;
        found += (uint32_t)__builtin_popcountll(splats);
        for (; splats; next += 4) /* past the last one come any */
            for (int k = 0; k < 4; k++, splats &= splats - 1)
                next[k] = offset + (uint32_t)(j + (int)_tzcnt_u64(splats) % 64) * (uint32_t)sizeof(placed);
    }
    return found;
}

#include "composite_template.h"
#include "color_template.h"
#include "project_template.h"
#include "order_template.h"
#include "vec_undef.h"
