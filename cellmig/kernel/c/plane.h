/* Two dimensions: neighbours of the four particles of a block side by side, one of each at a time. */

enum { FORCES = 2 }; /* vectors for the forces on a block, of its particles (0 1), (2 3) */

/* What formulas of facets take: gaps of the corners; edges from the first corner to the others; velocities along the
 * substrate. */
#define GAPS(gap) gap[0], gap[1]
#define EDGES(edge) edge[0]
#define SLIDING(v) v[0][0], v[1][0]

/* Component c of the force on particle i of a block. */
static inline double force_on(const v4 f[FORCES], int i, int c) { return f[i / 2][2 * (i % 2) + c]; }

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

/* Rows of block b: of s->Q V P by entries 00 10 01 11, of s->bent what resists Laplacians; lanes that it lacks have no
 * volume. */
static inline void store_stress(const KernelData *s, const Block *block, const v4 P[D][D], const v4 q[D])
{
    const v4 lanes[4] = {P[0][0], P[1][0], P[0][1], P[1][1]};
    double *Q = s->Q + 4L * block->row, *bent = s->bent + 2L * block->row;
    v4 rows[4];
    transpose(lanes, rows);
    const v4 pairs[2] = {SHUFFLE(q[0], q[1], 0, 4, 1, 5), SHUFFLE(q[0], q[1], 2, 6, 3, 7)};
    if (block->lanes == 4) {
        for (int i = 0; i < 4; i++) store(Q + 4 * i, rows[i]);
        for (int i = 0; BENDS && i < 2; i++) store(bent + 4 * i, pairs[i]);
    } else {
        memcpy(Q, rows, sizeof(v4) * (size_t)block->lanes);
        if (BENDS) memcpy(bent, pairs, sizeof(double) * D * (size_t)block->lanes);
    }
}

/* Adds a group of four neighbours of n blocks of one stencil to sums of stresses with H, by columns of P;
 * of those that have Laplacians, to sums with -Cᵀ, by lanes (0 1), (2 3). */
INLINED void add_stresses(const KernelData *s, long k, const int laplacians, long l, const Block *block, const int n,
                          v4 acc[][4], v4 bent[][2])
{
    const coefficient *h = s->adjoint + 8 * k, *C = s->bending + 4 * l;
    size_t c[4];
    neighbours(s->column + 4 * k, c);
    __builtin_prefetch(h + 8 * AHEAD);
    for (int m = 0; m < n; m++) {
        const double *Q = s->Q + 4L * block[m].shift;
        acc[m][0] = fma4(load(Q + c[0]), even_of(h), acc[m][0]);
        acc[m][1] = fma4(load(Q + c[1]), odd_of(h), acc[m][1]);
        acc[m][2] = fma4(load(Q + c[2]), even_of(h + 4), acc[m][2]);
        acc[m][3] = fma4(load(Q + c[3]), odd_of(h + 4), acc[m][3]);
        if (!laplacians) continue;
        const double *q = s->bent + 2L * block[m].shift;
        bent[m][0] = fma4(halves(twice(q + c[0] / 2), twice(q + c[1] / 2)), even_of(C), bent[m][0]);
        bent[m][1] = fma4(halves(twice(q + c[2] / 2), twice(q + c[3] / 2)), odd_of(C), bent[m][1]);
    }
}

/* Forces of s->Q on n blocks of one stencil, rows (0 1), (2 3): Σ V P x H, the adjoint of the gradient; and if they are
 * asked for those of s->bent, the adjoint of the Laplacian. */
INLINED void gather_stress(const KernelData *s, const Block *block, const int n, const int laplacians, v4 f[][FORCES])
{
    v4 acc[MOST][4] = {{{0}}}, bent[MOST][2] = {{{0}}};
    long k = s->first[block->stencil];
    const long end = s->first[block->stencil + 1];
    if (laplacians)
        for (long l = s->first_laplacian[block->stencil]; l < s->first_laplacian[block->stencil + 1]; l++, k++)
            add_stresses(s, k, 1, l, block, n, acc, bent);
    for (; k < end; k++) add_stresses(s, k, 0, 0, block, n, acc, bent);
    for (int m = 0; m < n; m++)
        for (int i = 0; i < 2; i++) {
            const v4 low = SHUFFLE(acc[m][2 * i], acc[m][2 * i + 1], 0, 1, 4, 5);
            const v4 high = SHUFFLE(acc[m][2 * i], acc[m][2 * i + 1], 2, 3, 6, 7);
            f[m][i] = bent[m][i] + (low + high);
        }
}

/* Adds forces (lanes, D) to those on a block. */
static inline void add_forces(v4 f[FORCES], const double *force, int lanes)
{
    double all[8] = {0};
    memcpy(all, force, sizeof(double) * D * (size_t)lanes);
    for (int i = 0; i < FORCES; i++) f[i] += load(all + 4 * i);
}

/* v += kick f/m + gain, then u += dt v, for particle i of a block, whose state is z; kick_per_mass : kick/m. */
static inline void kick_and_drift_particle(const v4 f[FORCES], int i, double kick_per_mass, const double gain[D],
                                           double dt, double *z)
{
    const v4 none = {0}, both = {0, 0, gain[0], gain[1]};
    const v4 a = i % 2 ? SHUFFLE(f[i / 2], none, 4, 4, 2, 3) : SHUFFLE(f[i / 2], none, 4, 4, 0, 1);
    v4 x = load(z) + kick_per_mass * a + both;
    x += dt * SHUFFLE(x, none, 2, 3, 4, 4);
    store(z, x);
}

/* Cofactors J F⁻ᵀ of F (entries by columns, every `stride` numbers); returns J. */
static inline double cofactors_of(const double *F, int stride, double C[D][D])
{
    const double a = F[0], c = F[stride], b = F[2 * stride], d = F[3 * stride];
    C[0][0] = d; C[0][1] = -c;
    C[1][0] = -b; C[1][1] = a;
    return a * d - b * c;
}

/* Largest eigenvalue of a symmetric matrix. */
static inline double largest_eigenvalue(const double A[D][D])
{
    const double mean = 0.5 * (A[0][0] + A[1][1]), half = 0.5 * (A[0][0] - A[1][1]);
    return mean + sqrt(half * half + A[0][1] * A[0][1]);
}
