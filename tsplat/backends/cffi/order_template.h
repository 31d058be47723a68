/* Sorting the splats of a tile, see order.h; a template, instantiated once per instruction set. */

/* Writes the slots of at most FEW pairs, by counting for each how many are nearer; no branch depends
 * on the depths. Returns 0 if two are equally far. */
TARGET static inline int NAME(sort_few)(const uint64_t *pairs, int count, int32_t *ids) {
    _Alignas(64) int32_t depths[FEW], ranks[FEW]; /* positive: as integers they order as they do */
    for (int i = 0; i < count; i++) depths[i] = (int32_t)(pairs[i] >> 32), ids[i] = -1;
    for (int i = count; i % (2 * LANES); i++) depths[i] = INT32_MAX;
    for (int k = 0; k < count; k += 2 * LANES) { /* two at a time: each waits for its last sum */
        VI a = ILOAD(depths + k), b = ILOAD(depths + k + LANES), below_a = ISET1(0), below_b = below_a;
        for (int i = 0; i < count; i++) {
            VI other = ISET1(depths[i]);
            below_a = COUNT_LESS(below_a, other, a);
            below_b = COUNT_LESS(below_b, other, b);
        }
        ISTORE(ranks + k, below_a);
        ISTORE(ranks + k + LANES, below_b);
    }
    for (int i = 0; i < count; i++) ids[ranks[i]] = (int32_t)pairs[i];
    int all = 1;
    for (int i = 0; i < count; i++) all &= ids[i] >= 0;
    return all;
}

/* See sort_tile in kernel.c; uses pairs and scratch up. Two rounds of a radix sort, by digits so large
 * that two splats seldom agree in both. */
TARGET static void NAME(sort_tile)(uint64_t *pairs, uint64_t *scratch, int64_t count,
                                   const ties *ties, int32_t *ids) {
    enum { DIGIT = 11 };
    if (count <= FEW) {
        if (!NAME(sort_few)(pairs, (int)count, ids)) tidy(pairs, scratch, count, ties, ids);
        return;
    }
    uint64_t low = UINT64_MAX, high = 0;
    for (int64_t i = 0; i < count; i++) {
        low = pairs[i] < low ? pairs[i] : low;
        high = pairs[i] > high ? pairs[i] : high;
    }
    uint32_t near_ = (uint32_t)(low >> 32), range = (uint32_t)(high >> 32) - near_;
    int digit = 63 - __builtin_clzll((uint64_t)count), bits = range ? 32 - __builtin_clz(range) : 0;
    digit = digit < DIGIT ? digit : DIGIT;
    int shift = bits > 2 * digit ? bits - 2 * digit : 0;
    uint32_t first[1 << DIGIT], second[1 << DIGIT], mask = (1u << digit) - 1, a = 0, b = 0;
    memset(first, 0, sizeof *first << digit);
    memset(second, 0, sizeof *second << digit);
#define KEY(pair) (((uint32_t)((pair) >> 32) - near_) >> shift)
    for (int64_t i = 0; i < count; i++) {
        uint32_t key = KEY(pairs[i]);
        first[key & mask]++;
        second[key >> digit]++;
    }
    for (uint32_t k = 0; k <= mask; k++) {
        uint32_t m = first[k], n = second[k];
        first[k] = a, second[k] = b;
        a += m, b += n;
    }
    for (int64_t i = 0; i < count; i++) scratch[first[KEY(pairs[i]) & mask]++] = pairs[i];
    for (int64_t i = 0; i < count; i++) pairs[second[KEY(scratch[i]) >> digit]++] = scratch[i];
#undef KEY
    tidy(pairs, scratch, count, ties, ids);
}
