/* How fast this machine reads, writes and multiplies: the limits that a frame is held against.
 * Built at run time by machine.py. */
#include <stdint.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

typedef int64_t eight_ints __attribute__((vector_size(64)));

/* Reads n bytes, a multiple of 256; the sum keeps the compiler from leaving that out. */
int64_t read_bytes(const char *from, int64_t n) {
    eight_ints a = {0}, b = a, c = a, d = a;
    for (const eight_ints *p = (const void *)from; (const char *)p < from + n; p += 4)
        a += p[0], b += p[1], c += p[2], d += p[3];
    a += b + c + d;
    return a[0] + a[1] + a[2] + a[3] + a[4] + a[5] + a[6] + a[7];
}

/* Writes n bytes, a multiple of 64, past the caches where there is a way. */
void write_bytes(char *to, int64_t n) {
    for (int64_t i = 0; i < n; i += 64)
        for (int k = 0; k < 64; k += 16)
#ifdef __SSE2__
            _mm_stream_si128((__m128i *)(to + i + k), _mm_setzero_si128());
#else
            *(eight_ints *)(to + i) = (eight_ints){0};
#endif
}

/* n rounds of TWELVE independent multiplications and additions, LANES wide. */
enum { TWELVE = 12 };
#define PROBE(NAME, TARGET, LANES)                                                                 \
    TARGET float NAME(int64_t n, float by) {                                                       \
        typedef float vector __attribute__((vector_size(4 * LANES)));                              \
        vector x[TWELVE], scale, shift, sum;                                                       \
        for (int i = 0; i < LANES; i++) scale[i] = by, shift[i] = 1 - by;                          \
        for (int k = 0; k < TWELVE; k++) x[k] = scale + (float)k;                                  \
        for (int64_t i = 0; i < n; i++)                                                            \
            _Pragma("GCC unroll 12") for (int k = 0; k < TWELVE; k++) x[k] = x[k] * scale + shift; \
        sum = x[0];                                                                                \
        for (int k = 1; k < TWELVE; k++) sum += x[k];                                              \
        return sum[0];                                                                             \
    }

PROBE(generic, , 4)
#ifdef __x86_64__
PROBE(avx2, __attribute__((target("avx2,fma"))), 8)
PROBE(avx512, __attribute__((target("avx512f,prefer-vector-width=512"))), 16)
#endif
