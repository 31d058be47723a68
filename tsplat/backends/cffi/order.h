/* Sorting the splats of a tile: pairs of a depth's bits (high) and a slot (low), by depth; equal
 * depths by the number of their Gaussian. */

typedef struct {
    const record *records;
    const int32_t *numbers; /* of the scene's rows, or NULL: by row */
} ties;

/* Whether a pair comes before another. */
static inline int before(uint64_t a, uint64_t b, const ties *ties) {
    if (a >> 32 != b >> 32) return a < b;
    int32_t i = ties->records[(uint32_t)a].id, j = ties->records[(uint32_t)b].id;
    return ties->numbers ? ties->numbers[i] < ties->numbers[j] : i < j;
}

/* Sorts by merging, whatever the pairs are like; for what the quick way leaves. */
static void merge_sort(uint64_t *pairs, uint64_t *scratch, int64_t count, const ties *ties) {
    for (int64_t width = 1; width < count; width *= 2) {
        for (int64_t begin = 0; begin < count; begin += 2 * width) {
            int64_t middle = min64(begin + width, count), end = min64(begin + 2 * width, count);
            int64_t i = begin, j = middle;
            for (int64_t k = begin; k < end; k++) {
                int left = i < middle && (j >= end || !before(pairs[j], pairs[i], ties));
                scratch[k] = left ? pairs[i++] : pairs[j++];
            }
        }
        memcpy(pairs, scratch, sizeof *pairs * (size_t)count);
    }
}

/* Writes the slots of pairs that are all but sorted. */
static void tidy(uint64_t *pairs, uint64_t *scratch, int64_t count, const ties *ties, int32_t *ids) {
    int64_t moves = 0;
    for (int64_t i = 1; i < count; i++) {
        uint64_t pair = pairs[i];
        int64_t j = i;
        if (pairs[i - 1] >> 32 < pair >> 32) continue; /* as a rule */
        for (; j > 0 && before(pair, pairs[j - 1], ties); j--) pairs[j] = pairs[j - 1];
        pairs[j] = pair;
        moves += i - j;
        if (moves > 16 * count) {
            merge_sort(pairs, scratch, count, ties);
            break;
        }
    }
    for (int64_t i = 0; i < count; i++) ids[i] = (int32_t)pairs[i];
}
