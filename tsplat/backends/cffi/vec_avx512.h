/* Sixteen lanes: AVX-512 F, DQ, BW and VL. */
#define NAME(f) f##_avx512
#define TARGET __attribute__((target("avx512f,avx512dq,avx512bw,avx512vl,avx2,fma,bmi,bmi2,lzcnt,popcnt")))
#define LANES 16
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
#define ROUGH_SQRT(a) _mm512_mul_ps(a, _mm512_rsqrt14_ps(a))
#define GE(a, b) _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ)
#define GT(a, b) _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ)
#define LE(a, b) _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ)
#define BOTH(m, n) ((__mmask16)((m) & (n)))
#define BUT_NOT(m, n) ((__mmask16)((m) & ~(n)))
#define KEEP(m, a) _mm512_maskz_mov_ps(m, a)
#define PICK(m, a, b) _mm512_mask_mov_ps(b, m, a)
#define NEGATE(m, a) _mm512_mask_or_ps(a, m, a, _mm512_set1_ps(-0.0f))
#define BITS(m) ((unsigned)(m))
#define SCALE(p, n) _mm512_castsi512_ps(_mm512_add_epi32( \
    _mm512_castps_si512(p), _mm512_slli_epi32(_mm512_castps_si512(n), 23)))

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
#define LOW(a) _mm512_cvtps_pd(_mm512_castps512_ps256(a))
#define HIGH(a) _mm512_cvtps_pd(_mm512_extractf32x8_ps(a, 1))
#define JOIN(a, b) _mm512_insertf32x8( \
    _mm512_castps256_ps512(_mm512_cvtpd_ps(a)), _mm512_cvtpd_ps(b), 1)
#define DIV(a, b) _mm512_div_ps(a, b)
#define SQRT(a) _mm512_sqrt_ps(a)
#define EXPONENT(a) _mm512_getexp_ps(a)
#define MANTISSA(a) _mm512_getmant_ps(a, _MM_MANT_NORM_1_2, _MM_MANT_SIGN_zero)
#include "composite_template.h"
#include "project_template.h"
#include "vec_undef.h"
