/* A tile while it is drawn: what the composite templates share. */

typedef float four __attribute__((vector_size(16), aligned(4), may_alias));
typedef int32_t four_ids __attribute__((vector_size(16)));
typedef double four_doubles __attribute__((vector_size(32)));

/* A splat as compositing reads it: one cache line. Exponents are base 2: alpha = 2^(level - w^2 -
 * v^2) with w = u11 dx + u12 dy and v = u22 dy, the factors scaled by sqrt(log2(e) / 2). */
typedef struct {
    double w, v;          /* u11 x + u12 y and u22 y at the mean */
    float reach;          /* of w^2 + v^2, with some slack: alpha is below the threshold beyond */
    int32_t id;           /* row in the scene */
    float half_w, half_v; /* how far w and v run from the middle of a block of pixels */
    four factors;         /* u11, u22, u12, level */
    float r, g, b, z;
} record;

/* Where a tile's pixels go, and the two thresholds. */
typedef struct {
    float *rgb, *transmittance, *depth;
    int32_t width;
    int stream;  /* rows start at a multiple of this many bytes, if it is 16 or 64 */
    float floor; /* log2 of the alpha threshold */
    float stop;  /* the transmittance where a pixel stops */
    int resume;  /* whether pixels go on from what is there, stopped ones negative */
    int last;    /* whether this is the last of them; else stopped pixels stay negative */
} picture;

enum {
    BATCH = 256, /* splats that are drawn on a block in one go */
    LOOK = 16,   /* splats between two looks whether a block is closed */
    AHEAD = 16   /* splats between fetching a record and needing it */
};
#define REACH_SLACK 1e-4f /* w and v are rounded a hundred times finer */

/* Writes past the caches: a picture is not read again soon, and is larger than they are. */
#ifdef __SSE__
#define STREAM(p, v) _mm_stream_ps(p, (__m128)(v))
#define STREAMED() _mm_sfence()
#else
#define STREAM(p, v) (*(four *)(p) = (v))
#define STREAMED()
#endif

/* A block's pixels: transmittance, colour sums, depth sum. */
typedef struct {
    _Alignas(64) float t[16], r[16], g[16], b[16], z[16];
} pixels;

/* A splat on a tile: w and v at its top left pixel, and what its record says. */
typedef struct {
    _Alignas(64) float w, v;
    float reach, unused, half_w, half_v;
    four factors;
    float r, g, b, z;
} placed;

typedef struct {
    pixels pixels[16];
    placed placed[BATCH + 1];           /* the last draws nothing */
    _Alignas(64) uint16_t hits[BATCH];  /* the blocks that each can reach, as bits */
    uint32_t list[BATCH * 16 + 16];     /* (block, splat) as byte offsets, block by block */
    int ends[16];                       /* of each block in the list */
} tile;

/* The middles of a tile's blocks and their pixels, counted from the top left pixel; all in rows. */
#define ROW(a, b, c, d) a, b, c, d
#define ALIKE(a) a, a, a, a
_Alignas(64) static const float BLOCK_X[] = {ALIKE(ROW(1.5f, 5.5f, 9.5f, 13.5f))};
_Alignas(64) static const float BLOCK_Y[] = {ALIKE(1.5f), ALIKE(5.5f), ALIKE(9.5f), ALIKE(13.5f)};
#define BLOCKS(a) ALIKE(ROW(a(0), a(4), a(8), a(12)))
#define ACROSS(x) {ALIKE(ROW(x, x + 1, x + 2, x + 3))}
#define DOWN(y) {ALIKE(y), ALIKE(y + 1), ALIKE(y + 2), ALIKE(y + 3)}
_Alignas(64) static const float PIXEL_X[16][16] = {BLOCKS(ACROSS)};
_Alignas(64) static const float PIXEL_Y[16][16] = {ALIKE(DOWN(0)), ALIKE(DOWN(4)), ALIKE(DOWN(8)), ALIKE(DOWN(12))};

/* A tile to begin or to go on with; pixels beyond columns x rows are stopped from the start. Returns
 * its open blocks. */
static uint32_t start_tile(tile *s, const picture *out, int32_t x0, int32_t y0, int32_t columns,
                           int32_t rows) {
    uint32_t open = 0;
    int whole = columns == TILE && rows == TILE && !out->resume;
    s->placed[BATCH] = (placed){.factors = {0, 0, 0, -1e9f}};
    for (int k = 0; k < 16; k++) {
        pixels *p = &s->pixels[k];
        for (int i = 0; i < 16; i++) {
            p->t[i] = 1;
            p->r[i] = p->g[i] = p->b[i] = p->z[i] = 0;
        }
        if (whole) continue;
        for (int i = 0; i < 16; i++) {
            int x = k % 4 * 4 + i % 4, y = k / 4 * 4 + i / 4;
            if (x >= columns || y >= rows) {
                p->t[i] = -1;
                continue;
            }
            if (out->resume) {
                int64_t at = (int64_t)(y0 + y) * out->width + x0 + x;
                p->r[i] = out->rgb[3 * at], p->g[i] = out->rgb[3 * at + 1], p->b[i] = out->rgb[3 * at + 2];
                p->t[i] = out->transmittance[at];
                if (out->depth) p->z[i] = out->depth[at];
            }
            open |= (uint32_t)(p->t[i] > 0) << k;
        }
    }
    return whole ? 0xffff : open;
}

/* Writes a tile's pixels where they belong; done says whether the tile needs no more splats. */
static void finish_tile(const tile *s, const picture *out, int done, int32_t x0, int32_t y0,
                        int32_t columns, int32_t rows) {
    int32_t mask = done ? 0x7fffffff : -1;
    for (int y = 0; y < rows; y++) {
        for (int x = 0; x < columns; x += 4) {
            const pixels *from = &s->pixels[y / 4 * 4 + x / 4];
            int at = y % 4 * 4, n = columns - x < 4 ? columns - x : 4;
            int64_t place = (int64_t)(y0 + y) * out->width + x0 + x;
            float *rgb = out->rgb + 3 * place, *t = out->transmittance + place;
            four r = *(const four *)(from->r + at), g = *(const four *)(from->g + at);
            four b = *(const four *)(from->b + at), left = *(const four *)(from->t + at);
            left = (four)((four_ids)left & mask);
            if (n == 4) {
                four rg = __builtin_shuffle(r, g, (four_ids){0, 4, 1, 5});
                four gb = __builtin_shuffle(g, b, (four_ids){1, 5, 2, 6});
                four br = __builtin_shuffle(b, r, (four_ids){2, 7, 3, 3});
                four first = __builtin_shuffle(rg, b, (four_ids){0, 1, 4, 2});
                four second = __builtin_shuffle(gb, r, (four_ids){0, 1, 6, 2});
                four third = __builtin_shuffle(br, g, (four_ids){0, 1, 7, 2});
                if (out->stream) {
                    STREAM(rgb, first), STREAM(rgb + 4, second), STREAM(rgb + 8, third);
                    STREAM(t, left);
                } else {
                    *(four *)rgb = first, *(four *)(rgb + 4) = second, *(four *)(rgb + 8) = third;
                    *(four *)t = left;
                }
            } else {
                for (int i = 0; i < n; i++) {
                    rgb[3 * i] = r[i], rgb[3 * i + 1] = g[i], rgb[3 * i + 2] = b[i];
                    t[i] = left[i];
                }
            }
            if (out->depth) memcpy(out->depth + place, from->z + at, sizeof(float) * n);
        }
    }
}
