/* Four lanes in the compiler's own vectors: SSE2, NEON, or whatever the machine's base has. */
#define NAME(f) f##_generic
#define TARGET
#define LANES 4
typedef float vf4 __attribute__((vector_size(16)));
typedef int32_t vi4 __attribute__((vector_size(16)));
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
#define ROUGH_SQRT(a) ((vf4){sqrtf((a)[0]), sqrtf((a)[1]), sqrtf((a)[2]), sqrtf((a)[3])})
#define GE(a, b) ((a) >= (b))
#define GT(a, b) ((a) > (b))
#define LE(a, b) ((a) <= (b))
#define BOTH(m, n) ((m) & (n))
#define BUT_NOT(m, n) ((m) & ~(n))
#define KEEP(m, a) ((vf4)((vi4)(a) & (m)))
#define PICK(m, a, b) pick4((m), (a), (b))
#define NEGATE(m, a) ((vf4)((vi4)(a) | ((m) & (int32_t)0x80000000)))
#define BITS(m) bits4(m)
#define SCALE(p, n) ((vf4)((vi4)(p) + ((vi4)(n) << 23))) /* n: an integer plus ROUNDING */

static inline vf4 pick4(vi4 m, vf4 a, vf4 b) { return (vf4)(((vi4)a & m) | ((vi4)b & ~m)); }
static inline unsigned bits4(vi4 m) {
    return (m[0] & 1) | (m[1] & 2) | (m[2] & 4) | (m[3] & 8);
}

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
#define LOW(a) ((vd2){(a)[0], (a)[1]})
#define HIGH(a) ((vd2){(a)[2], (a)[3]})
#define JOIN(a, b) ((vf4){(float)(a)[0], (float)(a)[1], (float)(b)[0], (float)(b)[1]})
#define DIV(a, b) ((a) / (b))
#define SQRT(a) ROUGH_SQRT(a)
#define EXPONENT(a) __builtin_convertvector(((vi4)(a) >> 23) - 127, vf4) /* of a normal a > 0 */
#define MANTISSA(a) ((vf4)(((vi4)(a) & 0x007fffff) | 0x3f800000))          /* in 1..2 */

static inline vd2 dpick2(vm2 m, vd2 a, vd2 b) { return (vd2)(((vm2)a & m) | ((vm2)b & ~m)); }
static inline unsigned dbits2(vm2 m) { return (unsigned)((m[0] & 1) | (m[1] & 2)); }
#include "composite_template.h"
#include "project_template.h"
#include "vec_undef.h"
