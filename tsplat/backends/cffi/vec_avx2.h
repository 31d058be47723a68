/* Eight lanes: AVX2 and FMA. */
#define NAME(f) f##_avx2
#define TARGET __attribute__((target("avx2,fma,bmi,bmi2,lzcnt,popcnt")))
#define LANES 8
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
#define ROUGH_SQRT(a) _mm256_mul_ps(a, _mm256_rsqrt_ps(a))
#define GE(a, b) _mm256_cmp_ps(a, b, _CMP_GE_OQ)
#define GT(a, b) _mm256_cmp_ps(a, b, _CMP_GT_OQ)
#define LE(a, b) _mm256_cmp_ps(a, b, _CMP_LE_OQ)
#define BOTH(m, n) _mm256_and_ps(m, n)
#define BUT_NOT(m, n) _mm256_andnot_ps(n, m)
#define KEEP(m, a) _mm256_and_ps(m, a)
#define PICK(m, a, b) _mm256_blendv_ps(b, a, m)
#define NEGATE(m, a) _mm256_or_ps(a, _mm256_and_ps(m, _mm256_set1_ps(-0.0f)))
#define BITS(m) ((unsigned)_mm256_movemask_ps(m))
#define SCALE(p, n) _mm256_castsi256_ps(_mm256_add_epi32( \
    _mm256_castps_si256(p), _mm256_slli_epi32(_mm256_castps_si256(n), 23)))

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
#define LOW(a) _mm256_cvtps_pd(_mm256_castps256_ps128(a))
#define HIGH(a) _mm256_cvtps_pd(_mm256_extractf128_ps(a, 1))
#define JOIN(a, b) _mm256_set_m128(_mm256_cvtpd_ps(b), _mm256_cvtpd_ps(a))
#define DIV(a, b) _mm256_div_ps(a, b)
#define SQRT(a) _mm256_sqrt_ps(a)
#define EXPONENT(a) _mm256_cvtepi32_ps(_mm256_sub_epi32( \
    _mm256_srli_epi32(_mm256_castps_si256(a), 23), _mm256_set1_epi32(127)))
#define MANTISSA(a) _mm256_or_ps(_mm256_and_ps(a, \
    _mm256_castsi256_ps(_mm256_set1_epi32(0x007fffff))), _mm256_set1_ps(1.0f))
#include "composite_template.h"
#include "project_template.h"
#include "vec_undef.h"
