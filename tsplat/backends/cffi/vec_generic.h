/* Four lanes in the compiler's own vectors: SSE2, NEON, or whatever the machine's base has. */
#define NAME(f) f##_generic
#define TARGET
#define LANES 4
#define WIDE 1
typedef float vf4 __attribute__((vector_size(16)));
typedef int32_t vi4 __attribute__((vector_size(16)));
typedef uint32_t vu4 __attribute__((vector_size(16)));
#define VF vf4
#define VM vi4
#define LOAD(p) (*(const vf4 *)(p))
#define STORE(p, v) (*(vf4 *)(p) = (v))
#define SET1(x) ((vf4){(x), (x), (x), (x)})
#define ADD(a, b) ((a) + (b))
#define SUB(a, b) ((a) - (b))
#define MUL(a, b) ((a) * (b))
#define FMA(a, b, c) ((a) * (b) + (c))
#define FNMA(a, b, c) ((c) - (a) * (b))
#define MIN(a, b) pick4((a) < (b), (a), (b))
#define MAX(a, b) pick4((a) > (b), (a), (b))
#define ABS(a) ((vf4)((vi4)(a) & 0x7fffffff))
#define SQRT(a) ((vf4){sqrtf((a)[0]), sqrtf((a)[1]), sqrtf((a)[2]), sqrtf((a)[3])})
#define GE(a, b) ((a) >= (b))
#define LE(a, b) ((a) <= (b))
#define PICK(m, a, b) pick4((m), (a), (b))
#define BITS(m) bits4(m)
#define GT(a, b) ((a) > (b))
#define KEEP(m, a) ((vf4)((vi4)(a) & (m)))
#define OR(a, b) ((vf4)((vi4)(a) | (vi4)(b)))
#define FLOOR(a) floor4(a)
#define CEIL(a) (-floor4(-(a)))
#define FRACTION(x) ((x) - floor4(x))
#define SCALE(m, p, x) /* 2^floor(x) p where m, else 0 */ \
    ((vf4)(((vu4)(p) + ((vu4)whole4(x) << 23)) & (vu4)(m)))

/* floor(a), of small numbers only. */
static inline vi4 whole4(vf4 a) {
    vf4 inside = (vf4)((vi4)a & ((a > -1e9f) & (a < 1e9f)));
    vi4 toward_zero = __builtin_convertvector(inside, vi4);
    return toward_zero + (__builtin_convertvector(toward_zero, vf4) > inside);
}
static inline vf4 floor4(vf4 a) { return __builtin_convertvector(whole4(a), vf4); }
static inline vf4 pick4(vi4 m, vf4 a, vf4 b) { return (vf4)(((vi4)a & m) | ((vi4)b & ~m)); }
static inline unsigned bits4(vi4 m) {
    return (m[0] & 1) | (m[1] & 2) | (m[2] & 4) | (m[3] & 8);
}

/* As many integers. */
#define VI vi4
#define ILOAD(p) (*(const vi4 *)(const void *)(p))
#define ISTORE(p, v) (*(vi4 *)(void *)(p) = (v))
#define ISET1(x) ((vi4){(x), (x), (x), (x)})
#define IADD(a, b) ((vi4)((vu4)(a) + (vu4)(b))) /* lanes that do not count may overflow */
#define IMUL(a, b) ((vi4)((vu4)(a) * (vu4)(b)))
#define TRUNCATE(a) __builtin_convertvector(a, vi4)
#define COUNT_LESS(n, a, b) ((n) - ((a) < (b))) /* n + 1 where a < b */

#define EIGHT_HALVES(to, from) \
    for (int i_ = 0; i_ < 8; i_++) (to)[i_] = half_to_float((from)[i_])

/* Half as many doubles. */
typedef double vd2 __attribute__((vector_size(16)));
typedef int64_t vm2 __attribute__((vector_size(16)));
#define VD vd2
#define DLOAD(p) (*(const vd2 *)(p))
#define DSTORE(p, v) (*(vd2 *)(p) = (v))
#define DSET1(x) ((vd2){(x), (x)})
#define DADD(a, b) ((a) + (b))
#define DSUB(a, b) ((a) - (b))
#define DMUL(a, b) ((a) * (b))
#define DDIV(a, b) ((a) / (b))
#define DFMA(a, b, c) ((a) * (b) + (c))
#define DFNMA(a, b, c) ((c) - (a) * (b))
#define DMIN(a, b) dpick2((a) < (b), (a), (b))
#define DMAX(a, b) dpick2((a) > (b), (a), (b))
#define DABS(a) ((vd2)((vm2)(a) & 0x7fffffffffffffff))
#define DLT_BITS(a, b) dbits2((a) < (b))
#define DLE_BITS(a, b) dbits2((a) <= (b))
#define DSQRT(a) ((vd2){sqrt((a)[0]), sqrt((a)[1])})
#define LOW(a) ((vd2){(a)[0], (a)[1]})
#define HIGH(a) ((vd2){(a)[2], (a)[3]})
#define JOIN(a, b) ((vf4){(float)(a)[0], (float)(a)[1], (float)(b)[0], (float)(b)[1]})
#define EVENS(h) ((vf4)__builtin_shuffle((vi4)(h)[0], (vi4)(h)[1], (vi4){0, 2, 4, 6}))
#define ODDS(h) ((vf4)__builtin_shuffle((vi4)(h)[0], (vi4)(h)[1], (vi4){1, 3, 5, 7}))
#define DIV(a, b) ((a) / (b))
#define EXPONENT(a) __builtin_convertvector(((vi4)(a) >> 23) - 127, vf4) /* of a normal a > 0 */
#define MANTISSA(a) ((vf4)(((vi4)(a) & 0x007fffff) | 0x3f800000))          /* in 1..2 */

static inline vd2 dpick2(vm2 m, vd2 a, vd2 b) { return (vd2)(((vm2)a & m) | ((vm2)b & ~m)); }
static inline unsigned dbits2(vm2 m) { return (unsigned)((m[0] & 1) | (m[1] & 2)); }

/* Columns of sixteen numbers become LANES rows. */
static inline void transpose_generic(const vf4 columns[16], float rows[4][16]) {
    for (int k = 0; k < 16; k++)
        for (int l = 0; l < 4; l++) rows[l][k] = columns[k][l];
}

/* Of 64 splats that hit blocks, those that hit this one, as bits. */
static inline uint64_t splats_on_generic(const uint16_t *hits, int block) {
    uint64_t splats = 0;
    for (int j = 0; j < 64; j++) splats |= (uint64_t)(hits[j] >> block & 1) << j;
    return splats;
}

/* Lists the splats of count that hit a block; there is room for three more. Returns how many. */
static inline uint32_t list_generic(uint32_t *to, const uint16_t *hits, int count, int block) {
    uint32_t found = 0, offset = (uint32_t)block * sizeof PIXEL_X[0] << 16;
    for (int j = 0; j < count; j += 64) {
        uint64_t splats = splats_on_generic(hits + j, block);
        for (; splats; splats &= splats - 1)
            to[found++] = offset + (uint32_t)(j + __builtin_ctzll(splats)) * sizeof(placed);
    }
    return found;
}

#include "composite_template.h"
#include "color_template.h"
#include "project_template.h"
#include "order_template.h"
#include "vec_undef.h"
