/* The C kernel's interface, read by the compiler and by cffi alike (which skips # lines).
 *
 * The caller owns every buffer; the kernel allocates nothing and remembers only which instruction
 * set it uses. Shapes stand beside each pointer; N Gaussians, M splats, T tiles, I intersections.
 * All arrays are C-contiguous. Functions return a status: 0, or one of the TSPLAT_ codes below.
 *
 * There are two ways to a frame, of the same bits: the four stages, each of which can be checked
 * or replaced, and tsplat_frame_*, which keep splats as compositing reads them and sort by tile.
 */
#ifndef TSPLAT_KERNEL_H
#define TSPLAT_KERNEL_H
#include <stdint.h>

enum {
    TSPLAT_TILE = 16,           /* px, side of a tile */
    TSPLAT_RECORD = 16,         /* floats of scratch per Gaussian in project, per splat in composite */
    TSPLAT_CHUNK = 2048,        /* Gaussians per entry of chunk_counts in tsplat_project */
    TSPLAT_RADIX = 2048,        /* entries of scratch per thread in tsplat_sort */
    TSPLAT_CLUSTER = 256,       /* packed Gaussians that are skipped together */
    TSPLAT_BOUNDS = 8,          /* numbers that bound a cluster */
    TSPLAT_SLABS = 8,           /* most slabs of depth that a frame is made in */
    TSPLAT_COLUMNS = 12,        /* packed floats per Gaussian, and three more with its colour */
    TSPLAT_TAPS = 4,            /* pixels that one is interpolated from, along each axis */
    TSPLAT_BAD_SIZE = 1,        /* a count, a size or a thread number out of range */
    TSPLAT_BAD_ID = 2,          /* an index points outside the array it indexes */
    TSPLAT_BAD_ISA = 3,         /* this CPU or build does not offer that instruction set */
    TSPLAT_GENERIC = 1,         /* instruction sets, as bits */
    TSPLAT_AVX2 = 2,
    TSPLAT_AVX512 = 4
};

typedef struct {
    const float *means;         /* [N, 3] world units, relative to the scene's origin */
    const float *quats;         /* [N, 4] w x y z, unit */
    const float *scales;        /* [N, 3] world units */
    const float *opacities;     /* [N]    0..1 */
    const void *sh;             /* [N, coefficients, 3] float, or IEEE half if half is 1 */
    int64_t count;              /* N */
    int32_t coefficients;       /* 1, 4, 9 or 16 */
    int32_t half;               /* 0 or 1 */
} tsplat_scene;

typedef struct {
    double rotation[9];         /* world to camera, row-major */
    double centre[3];           /* world units, relative to the scene's origin */
    double fx, fy, cx, cy;      /* px */
    double near_, far_;         /* world units */
    int32_t width, height;      /* px */
} tsplat_camera;

typedef struct {
    double alpha_threshold;
    double transmittance_min;
    int32_t sh_degree;          /* 0..3, at most what the scene's coefficients allow */
    int32_t antialias;          /* 0 or 1 */
    float depth_split;          /* RenderParams.depth_split; 1 keeps all bits */
    double low_pass;            /* px^2 */
} tsplat_params;

typedef struct {
    double *means2d;            /* [M, 2] px */
    float *factors;             /* [M, 3] u11 u12 u22, 1/px */
    float *depths;              /* [M]    camera z */
    float *opacities;           /* [M] */
    float *colors;              /* [M, 3] */
    float *radii;               /* [M, 2] px */
    int32_t *gaussian_ids;      /* [M] */
    int64_t count;              /* M */
    int32_t width, height;      /* px */
} tsplat_splats;

/* 1 if the kernel was built with OpenMP, else 0: then every call runs on one thread. */
int tsplat_has_openmp(void);

/* The instruction sets this CPU and build offer, or'ed. */
int tsplat_isas(void);

/* Chooses one for all later calls; the generic one is used until then. Not while others run. */
int tsplat_use_isa(int isa);

/* Projects all Gaussians into scratch and counts what stays visible.
 * scratch [N, TSPLAT_RECORD]; chunk_counts [ceil(N / TSPLAT_CHUNK)]; totals [2]: M, overflowed. */
int tsplat_project(const tsplat_scene *scene, const tsplat_camera *camera,
                   const tsplat_params *params, float *scratch, int32_t *chunk_counts,
                   int64_t *totals, int threads);

/* Copies the visible ones from scratch into splats, whose arrays have room for M. */
int tsplat_gather(const float *scratch, const int32_t *chunk_counts, int64_t gaussians,
                  const tsplat_splats *splats, int threads);

/* Stable sort by depth. order [M]; scratch [2 M] pairs of key and index;
 * histograms [threads, TSPLAT_RADIX]. */
int tsplat_sort(const float *depths, int64_t count, int32_t *order, uint64_t *scratch,
                uint32_t *histograms, int threads);

/* Counts intersections. tile_offsets [T + 1] is final after this call; boxes [M, 4] (first column
 * and row of tiles, last column and row) and cursors [threads, T] are scratch that tsplat_bin_fill
 * needs unchanged, called with the same order and threads. */
int tsplat_bin_count(const tsplat_splats *splats, const int32_t *order, int32_t *boxes,
                     int64_t *tile_offsets, int64_t *cursors, int threads);

/* Lists the splats of each tile, near to far. splat_ids [I], I = tile_offsets[T]. */
int tsplat_bin_fill(const tsplat_splats *splats, const int32_t *order, const int32_t *boxes,
                    int64_t *cursors, int32_t *splat_ids, int threads);

/* Makes the picture. records [M, TSPLAT_RECORD] is scratch, 64-byte aligned; rgb [H, W, 3],
 * transmittance [H, W], depth [H, W] or NULL. Any tile size, so that other backends' bins serve too. */
int tsplat_composite(const tsplat_splats *splats, const int64_t *tile_offsets,
                     const int32_t *splat_ids, int32_t tile_size, const tsplat_params *params,
                     float *records, float *rgb, float *transmittance, float *depth, int threads);

/* A scene in the order of a space-filling curve, in vectors; clusters have bounds. */
typedef struct {
    const float *columns;       /* [ceil(N / 16), width, 16], 64-byte aligned: mean, quat, scale,
                                   opacity, row in the scene as int32; colour */
    const double *bounds;       /* [ceil(N / TSPLAT_CLUSTER), TSPLAT_BOUNDS] */
    int64_t count;              /* N that are packed */
    int32_t width;              /* TSPLAT_COLUMNS, or three more where SH degree 0 makes the colour */
    float *colors;              /* [ceil(N / 16), 3, 16] kept from frame to frame, or NULL */
    uint16_t *kept;             /* [ceil(N / 16)]: which of sixteen colours are */
    const int32_t *numbers;     /* of the scene's rows: of equal depths the lowest is in front; NULL:
                                   by row */
} tsplat_packed;

/* What a frame needs; slots are ceil(N / TSPLAT_CLUSTER) * TSPLAT_CLUSTER. */
typedef struct {
    float *records;             /* [slots, TSPLAT_RECORD], 64-byte aligned */
    int32_t *boxes;             /* [slots, 2]: first and last tile, as column + row * 65536 */
    float *depths;              /* [slots] */
    int32_t *cluster_counts;    /* [clusters] */
    int32_t *owners;            /* [clusters]: the thread that projected it */
    int32_t *steps;             /* [threads, rows + 1, columns + 1] of tiles */
    int64_t *cursors;           /* [threads, T] */
    int64_t *tile_offsets;      /* [T + 1] */
    uint8_t *closed;            /* [T]: whether all pixels have stopped */
    uint64_t *pairs;            /* [I]: depth's bits, slot */
    uint64_t *scratch;          /* [threads, longest tile] */
    int32_t *ids;               /* [threads, longest tile] */
} tsplat_space;

/* Fills columns and bounds of packed, whose count and width say how much, in the given order. */
int tsplat_pack(const tsplat_scene *scene, const int32_t *order, double alpha_threshold,
                const tsplat_packed *packed, float *columns, double *bounds, int threads);

/* Projects what may be visible into records and counts intersections. With skip, clusters out of
 * sight are not looked at. totals [7]: visible, overflowed, Gaussians in skipped clusters,
 * intersections, intersections of the fullest tile, tiles without any, colours that were kept. */
int tsplat_frame_project(const tsplat_packed *packed, const tsplat_scene *scene,
                         const tsplat_camera *camera, const tsplat_params *params, int skip,
                         const tsplat_space *space, int64_t *totals, int threads);

/* Cuts the frame into slabs of depth, the nearest with about share intersections, each further one
 * with four times as many; to be binned and composited one after the other. bounds [TSPLAT_SLABS + 1]:
 * depths' bits where they begin, and the end. *count: how many. Opens all tiles. */
int tsplat_frame_slabs(const tsplat_packed *packed, const tsplat_camera *camera,
                       const tsplat_space *space, int64_t share, uint32_t *bounds, int32_t *count);

/* Counts intersections anew, of splats from near up to far with open tiles. totals [2]:
 * intersections, those of the fullest tile. */
int tsplat_frame_count(const tsplat_packed *packed, const tsplat_camera *camera,
                       const tsplat_space *space, uint32_t near_bits, uint32_t far_bits,
                       int64_t *totals, int threads);

/* Lists the pairs of each tile as they were counted; a frame in one slab is from 0 to UINT32_MAX.
 * Same packed, camera and threads as before. */
int tsplat_frame_bin(const tsplat_packed *packed, const tsplat_camera *camera,
                     const tsplat_space *space, uint32_t near_bits, uint32_t far_bits, int threads);

/* Sorts and draws each tile; longest as it was counted. With skip, tiles without splats are only
 * cleared. A slab resumes what nearer ones left and closes tiles, unless it is the last. */
int tsplat_frame_composite(const tsplat_packed *packed, const tsplat_camera *camera,
                           const tsplat_params *params, int skip, int resume, int last,
                           const tsplat_space *space, int64_t longest, float *rgb,
                           float *transmittance, float *depth, int threads);

/* A layer of a picture and where it goes at another size: w, h before and W, H after. */
typedef struct {
    const float *small;          /* [h, w, channels] */
    float *large;                /* [H, W, channels] */
    const int32_t *columns, *rows; /* [W, TSPLAT_TAPS], [H, TSPLAT_TAPS]: which pixels */
    const float *column_weights, *row_weights; /* likewise: how much of each */
    int32_t width, height, channels; /* w, h; 1 or 3 */
    int32_t out_width, out_height;   /* W, H */
    float most;                  /* what is more, and what is less than 0, is cut off */
} tsplat_layer;

/* Interpolates a layer. scratch [threads, w * channels + 1]. */
int tsplat_upscale(const tsplat_layer *layer, float *scratch, int threads);
#endif
