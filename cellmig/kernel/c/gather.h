/* Gradients of fields. */

/* F[row][column] of its entries by columns. */
static inline void matrix_of(const v4 f[D * D], v4 F[D][D])
{
    for (int k = 0; k < D * D; k++) F[k % D][k / D] = f[k];
}

/* F of block b. */
static inline void load_F(const KernelData *s, long b, v4 F[D][D])
{
    for (int k = 0; k < D * D; k++) F[k % D][k / D] = load(s->F + 4 * (D * D * b + k));
}

/* Reference gradients of the numbers of a director, of block b. */
static inline void load_director_gradient(const KernelData *s, long b, v4 g[M][D])
{
    for (int k = 0; k < M * D; k++) g[k / D][k % D] = load(s->director_gradient + 4 * (M * D * b + k));
}

/* Σ G x field alone, of n blocks of one stencil: entries by columns. */
INLINED void gather(const KernelData *s, const Block *block, const int n, const double *field, v4 grad[][D * D])
{
    gather_both(s, block, n, 0, field, grad, 0);
}
