/* Sums over neighbours: gradients of a field, and the stabilisation applied to it. */

/* Coefficients stream from memory: they are prefetched this many groups of neighbours ahead. */
enum { AHEAD = 48 };

/* Places of four neighbours in fields of four numbers: `column` holds four times their local numbers. */
static inline void neighbours(const uint32_t *column, size_t c[4])
{
    uint64_t pair[2];
    memcpy(pair, column, sizeof pair);
    c[0] = (uint32_t)pair[0];
    c[1] = pair[0] >> 32;
    c[2] = (uint32_t)pair[1];
    c[3] = pair[1] >> 32;
}

/* Adds to `sum`, rows (0 1), (2 3), Σ coefficient x field over the neighbours of n blocks of one stencil. */
INLINED void gather_scalar(const long *first, const uint32_t *column, const coefficient *values, const Block *block,
                           const int n, const double *field, v4 sum[][2])
{
    for (long k = first[block->stencil]; k < first[block->stencil + 1]; k++) {
        const coefficient *a = values + 4 * k;
        size_t c[4];
        neighbours(column + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *x = field + 4L * block[m].shift;
            sum[m][0] = fma4(halves(twice(x + c[0]), twice(x + c[1])), even_of(a), sum[m][0]);
            sum[m][1] = fma4(halves(twice(x + c[2]), twice(x + c[3])), odd_of(a), sum[m][1]);
        }
    }
}

/* Σ G x field over the neighbours of n blocks of one stencil, lanes 00 10 01 11, and S x field, rows (0 1), (2 3). */
INLINED void gather(const KernelData *s, const Block *block, const int n, const double *field, v4 grad[][4],
                    v4 stab[][2])
{
    v4 acc[MOST][4] = {{{0}}}, st[MOST][2] = {{{0}}};
    for (long k = s->first[block->stencil]; k < s->first[block->stencil + 1]; k++) {
        const coefficient *a = s->gradient + GRADIENT_WIDTH * k;
        __builtin_prefetch(a + AHEAD * GRADIENT_WIDTH);
        __builtin_prefetch(a + AHEAD * GRADIENT_WIDTH + 64 / sizeof *a);
        size_t c[4];
        neighbours(s->column + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *x = field + 4L * block[m].shift;
            const v4 x0 = twice(x + c[0]), x1 = twice(x + c[1]), x2 = twice(x + c[2]), x3 = twice(x + c[3]);
            acc[m][0] = fma4(x0, even_of(a), acc[m][0]);
            acc[m][1] = fma4(x1, odd_of(a), acc[m][1]);
            acc[m][2] = fma4(x2, even_of(a + 4), acc[m][2]);
            acc[m][3] = fma4(x3, odd_of(a + 4), acc[m][3]);
            if (STABILISED) {
                st[m][0] = fma4(halves(x0, x1), even_of(a + 8), st[m][0]);
                st[m][1] = fma4(halves(x2, x3), odd_of(a + 8), st[m][1]);
            }
        }
    }
    if (STABILISED) gather_scalar(s->first_outer, s->column_outer, s->outer, block, n, field, st);
    for (int m = 0; m < n; m++) {
        transpose(acc[m], grad[m]);
        stab[m][0] = st[m][0];
        stab[m][1] = st[m][1];
    }
}
