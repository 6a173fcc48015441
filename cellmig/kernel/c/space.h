/* Three dimensions: one particle of a block after the other; a neighbour's G and C are one vector (x, y, z, C). */

enum { FORCES = 4 }; /* vectors for the forces on a block, one for each particle */

/* What formulas of facets take: gaps of the corners; edges from the first corner to the others; velocities along the
 * substrate. */
#define GAPS(gap) gap[0], gap[1], gap[2]
#define EDGES(edge) edge[0], edge[1]
#define SLIDING(v) v[0], v[1], v[2]

/* Component c of the force on particle i of a block. */
static inline double force_on(const v4 f[FORCES], int i, int c) { return f[i][c]; }

/* Adds two neighbours of a particle, k and k + 1, to the sums of n blocks: (∂x, ∂y, ∂z, C) of each component. */
INLINED void add_gradient(const KernelData *s, long k, const Block *block, const int n, const double *field,
                          v4 sum[][2][D])
{
    const coefficient *g = s->gradient + 4 * k;
    __builtin_prefetch(g + 4 * AHEAD);
    for (int e = 0; e < 2; e++) {
        const v4 a = four_of(g + 4 * e);
        const size_t at = s->column[k + e];
        for (int m = 0; m < n; m++) {
            const double *x = field + 2 * D * (long)block[m].shift + at;
            for (int c = 0; c < D; c++) sum[m][e][c] = fma4(splat(x[c]), a, sum[m][e][c]);
        }
    }
}

/* Σ G x field over the neighbours of n blocks of one stencil, entries by columns, and if they are asked for Laplacians
 * Σ C field by lanes. */
INLINED void gather_both(const KernelData *s, const Block *block, const int n, const int laplacians,
                         const double *field, v4 grad[][D * D], v4 bend[][D])
{
    v4 rows[MOST][D][4];
    for (int i = 0; i < 4; i++) {
        v4 sum[MOST][2][D] = {{{{0}}}};
        const long *first = s->first + 4L * block->stencil + i;
        for (long k = first[0]; k < first[1]; k += 2) add_gradient(s, k, block, n, field, sum);
        for (int m = 0; m < n; m++)
            for (int c = 0; c < D; c++) rows[m][c][i] = sum[m][0][c] + sum[m][1][c];
    }
    for (int m = 0; m < n; m++)
        for (int c = 0; c < D; c++) {
            v4 columns[4];
            transpose(rows[m][c], columns);
            for (int k = 0; k < D; k++) grad[m][c + D * k] = columns[k];
            if (laplacians) bend[m][c] = columns[D];
        }
}

/* Rows of block b: of s->Q (V P_c0, V P_c1, V P_c2, what resists Laplacians of c), c after c; lanes that the block lacks
 * have no volume. */
static inline void store_stress(const KernelData *s, const Block *block, const v4 P[D][D], const v4 q[D])
{
    double *Q = s->Q + 12L * block->row;
    for (int c = 0; c < D; c++) {
        const v4 lanes[4] = {P[c][0], P[c][1], P[c][2], q[c]};
        v4 rows[4];
        transpose(lanes, rows);
        for (int i = 0; i < block->lanes; i++) store(Q + 12 * i + 4 * c, rows[i]);
    }
}

/* Forces of s->Q on n blocks of one stencil, particle by particle: Σ V P x H, the adjoint of the gradient, and in the
 * same sums that of the Laplacian, where there is one. */
INLINED void gather_stress(const KernelData *s, const Block *block, const int n, const int laplacians, v4 f[][FORCES])
{
    for (int i = 0; i < 4; i++) {
        v4 sum[MOST][2][D] = {{{{0}}}};
        const long *first = s->first + 4L * block->stencil + i;
        for (long k = first[0]; k < first[1]; k += 2) {
            const coefficient *h = s->adjoint + 4 * k;
            __builtin_prefetch(h + 4 * AHEAD);
            for (int e = 0; e < 2; e++) {
                const v4 a = four_of(h + 4 * e);
                const size_t at = 2 * (size_t)s->column[k + e];
                for (int m = 0; m < n; m++) {
                    const double *Q = s->Q + 12L * block[m].shift + at;
                    for (int c = 0; c < D; c++) sum[m][e][c] = fma4(load(Q + 4 * c), a, sum[m][e][c]);
                }
            }
        }
        for (int m = 0; m < n; m++) {
            v4 parts[4] = {{0}}, by_entry[4];
            for (int c = 0; c < D; c++) parts[c] = sum[m][0][c] + sum[m][1][c];
            transpose(parts, by_entry);
            f[m][i] = (by_entry[0] + by_entry[1]) + by_entry[2];
            if (laplacians) f[m][i] += by_entry[3];
        }
    }
}

/* Adds forces (lanes, D) to those on a block. */
static inline void add_forces(v4 f[FORCES], const double *force, int lanes)
{
    for (int i = 0; i < lanes; i++)
        for (int c = 0; c < D; c++) f[i][c] += force[D * i + c];
}

/* v += kick f/m + gain, then u += dt v, for particle i of a block, whose state is z; kick_per_mass : kick/m. */
static inline void kick_and_drift_particle(const v4 f[FORCES], int i, double kick_per_mass, const double gain[D],
                                           double dt, double *z)
{
    for (int c = 0; c < D; c++) {
        z[D + c] += kick_per_mass * f[i][c] + gain[c];
        z[c] += dt * z[D + c];
    }
}

/* Cofactors J F⁻ᵀ of F (entries by columns, every `stride` numbers); returns J. */
static inline double cofactors_of(const double *F, int stride, double C[D][D])
{
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            const int r = (i + 1) % D, t = (i + 2) % D, c = (j + 1) % D, d = (j + 2) % D;
            C[i][j] = F[stride * (r + D * c)] * F[stride * (t + D * d)]
                    - F[stride * (r + D * d)] * F[stride * (t + D * c)];
        }
    return F[0] * C[0][0] + F[stride * D] * C[0][1] + F[stride * 2 * D] * C[0][2];
}

/* Largest eigenvalue of a symmetric matrix, by the cosine that solves its cubic (Smith 1961). */
static inline double largest_eigenvalue(const double A[D][D])
{
    const double mean = (A[0][0] + A[1][1] + A[2][2]) / 3, a = A[0][0] - mean, b = A[1][1] - mean, c = A[2][2] - mean;
    const double d = A[0][1], e = A[0][2], f = A[1][2];
    const double square = (a * a + b * b + c * c) / 6 + (d * d + e * e + f * f) / 3;
    if (!(square > 0)) return mean;
    const double half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / (square * sqrt(square));
    return mean + 2 * sqrt(square) * cos(acos(fmax(-1, fmin(1, half))) / 3);
}
