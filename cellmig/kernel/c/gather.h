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

/* Σ G x field over the neighbours of n blocks of one stencil, lanes 00 10 01 11. */
INLINED void gather(const KernelData *s, const Block *block, const int n, const double *field, v4 grad[][4])
{
    v4 acc[MOST][4] = {{{0}}};
    for (long k = s->first[block->stencil]; k < s->first[block->stencil + 1]; k++) {
        const coefficient *a = s->gradient + 8 * k;
        __builtin_prefetch(a + AHEAD * 8);
        size_t c[4];
        neighbours(s->column + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *x = field + 4L * block[m].shift;
            const v4 x0 = twice(x + c[0]), x1 = twice(x + c[1]), x2 = twice(x + c[2]), x3 = twice(x + c[3]);
            acc[m][0] = fma4(x0, even_of(a), acc[m][0]);
            acc[m][1] = fma4(x1, odd_of(a), acc[m][1]);
            acc[m][2] = fma4(x2, even_of(a + 4), acc[m][2]);
            acc[m][3] = fma4(x3, odd_of(a + 4), acc[m][3]);
        }
    }
    for (int m = 0; m < n; m++) transpose(acc[m], grad[m]);
}

/* Laplacians of the state of n blocks of one stencil, (C u, C v) by lanes. */
INLINED void gather_laplacians(const KernelData *s, const Block *block, const int n, v4 bend[][4])
{
    v4 acc[MOST][4] = {{{0}}};
    for (long k = s->first_laplacian[block->stencil]; k < s->first_laplacian[block->stencil + 1]; k++) {
        const coefficient *a = s->laplacian + 4 * k;
        size_t c[4];
        neighbours(s->column_laplacian + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *x = s->state + 4L * block[m].shift;
            for (int i = 0; i < 4; i++) acc[m][i] = fma4(load(x + c[i]), splat(a[i]), acc[m][i]);
        }
    }
    for (int m = 0; m < n; m++) transpose(acc[m], bend[m]);
}

/* Adds to f, rows (0 1), (2 3), the forces of s->bent on n blocks of one stencil: its sums with -Cᵀ. */
INLINED void gather_bent(const KernelData *s, const Block *block, const int n, v4 f[][2])
{
    for (long k = s->first_laplacian[block->stencil]; k < s->first_laplacian[block->stencil + 1]; k++) {
        const coefficient *a = s->bending + 4 * k;
        size_t c[4];
        neighbours(s->column_laplacian + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *q = s->bent + 2L * block[m].shift;
            f[m][0] = fma4(halves(twice(q + c[0] / 2), twice(q + c[1] / 2)), even_of(a), f[m][0]);
            f[m][1] = fma4(halves(twice(q + c[2] / 2), twice(q + c[3] / 2)), odd_of(a), f[m][1]);
        }
    }
}
