/* Sums over neighbours: gradients and Laplacians of fields. */

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

/* Adds a group of four neighbours of n blocks of one stencil to sums with G, by lanes (00 10 01 11); for Laplacians, to
 * those with C, by lanes (0 1), (2 3). */
INLINED void add_gradient(const KernelData *s, long k, const int laplacians, long l, const Block *block, const int n,
                          const double *field, v4 grad[][4], v4 bend[][2])
{
    const coefficient *g = s->gradient + 8 * k, *C = s->laplacian + 4 * l;
    size_t c[4];
    neighbours(s->column + 4 * k, c);
    __builtin_prefetch(g + 8 * AHEAD);
    for (int m = 0; m < n; m++) {
        const double *x = field + 4L * block[m].shift;
        const v4 x0 = twice(x + c[0]), x1 = twice(x + c[1]), x2 = twice(x + c[2]), x3 = twice(x + c[3]);
        grad[m][0] = fma4(x0, even_of(g), grad[m][0]);
        grad[m][1] = fma4(x1, odd_of(g), grad[m][1]);
        grad[m][2] = fma4(x2, even_of(g + 4), grad[m][2]);
        grad[m][3] = fma4(x3, odd_of(g + 4), grad[m][3]);
        if (!laplacians) continue;
        bend[m][0] = fma4(halves(x0, x1), even_of(C), bend[m][0]);
        bend[m][1] = fma4(halves(x2, x3), odd_of(C), bend[m][1]);
    }
}

/* Σ G x field over the neighbours of n blocks of one stencil, lanes 00 10 01 11, and if they are asked for Laplacians
 * Σ C field by lanes: neighbours that these have come first. */
INLINED void gather_both(const KernelData *s, const Block *block, const int n, const int laplacians,
                         const double *field, v4 grad[][4], v4 bend[][D])
{
    v4 acc[MOST][4] = {{{0}}}, sum[MOST][2] = {{{0}}};
    long k = s->first[block->stencil];
    const long end = s->first[block->stencil + 1];
    if (laplacians)
        for (long l = s->first_laplacian[block->stencil]; l < s->first_laplacian[block->stencil + 1]; l++, k++)
            add_gradient(s, k, 1, l, block, n, field, acc, sum);
    for (; k < end; k++) add_gradient(s, k, 0, 0, block, n, field, acc, sum);
    for (int m = 0; m < n; m++) transpose(acc[m], grad[m]);
    for (int m = 0; laplacians && m < n; m++) {
        bend[m][0] = SHUFFLE(sum[m][0], sum[m][1], 0, 2, 4, 6);
        bend[m][1] = SHUFFLE(sum[m][0], sum[m][1], 1, 3, 5, 7);
    }
}

/* Σ G x field alone. */
INLINED void gather(const KernelData *s, const Block *block, const int n, const double *field, v4 grad[][4])
{
    gather_both(s, block, n, 0, field, grad, 0);
}
