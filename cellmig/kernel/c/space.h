/* Three dimensions: a neighbour's G and C are one vector (x, y, z, C) for each of the four particles of a block. */

enum { FORCES = 4 }; /* vectors for the forces on a block, one for each particle */

/* What formulas of facets take: gaps of the corners; edges from the first corner to the others; velocities along the
 * substrate. */
#define GAPS(gap) gap[0], gap[1], gap[2]
#define EDGES(edge) edge[0], edge[1]
#define SLIDING(v) v[0], v[1], v[2]

/* Component c of the force on particle i of a block. */
static inline double force_on(const v4 f[FORCES], int i, int c) { return f[i][c]; }

/* Particles of a block at a time, whose sums fill the registers. */
#define LANES(n) ((n) == 1 ? 4 : 2)

/* Σ G x field over the neighbours of n blocks of one stencil, entries by columns, and if they are asked for Laplacians
 * Σ C field by lanes. */
INLINED void gather_both(const KernelData *s, const Block *block, const int n, const int laplacians,
                         const double *field, v4 grad[][D * D], v4 bend[][D])
{
    v4 sum[MOST][D][4];
    for (int from = 0; from < 4; from += LANES(n)) {
        v4 acc[MOST][D][4] = {{{{0}}}};
        for (long k = s->first[block->stencil]; k < s->first[block->stencil + 1]; k++) {
            const coefficient *g = s->gradient + 16 * k + 4 * from;
            size_t at[4];
            neighbours(s->column + 4 * k, at);
            __builtin_prefetch(g + 16 * AHEAD);
            for (int i = 0; i < LANES(n); i++) {
                const v4 a = four_of(g + 4 * i);
                for (int m = 0; m < n; m++) {
                    const double *x = field + 2 * D * (long)block[m].shift + at[from + i];
                    for (int c = 0; c < D; c++) acc[m][c][i] = fma4(splat(x[c]), a, acc[m][c][i]);
                }
            }
        }
        for (int m = 0; m < n; m++)
            for (int c = 0; c < D; c++)
                for (int i = 0; i < LANES(n); i++) sum[m][c][from + i] = acc[m][c][i];
    }
    for (int m = 0; m < n; m++)
        for (int c = 0; c < D; c++) {
            v4 columns[4];
            transpose(sum[m][c], columns);
            for (int k = 0; k < D; k++) grad[m][c + D * k] = columns[k];
            if (laplacians) bend[m][c] = columns[D];
        }
}

/* Rows of block b: of Q (V P_c0, V P_c1, V P_c2, what resists Laplacians of c), c after c; lanes that the block lacks
 * have no volume. */
static inline void store_rows(double *Q, const Block *block, const v4 P[D][D], const v4 q[D])
{
    Q += 12L * block->row;
    for (int c = 0; c < D; c++) {
        const v4 lanes[4] = {P[c][0], P[c][1], P[c][2], q[c]};
        v4 rows[4];
        transpose(lanes, rows);
        for (int i = 0; i < block->lanes; i++) store(Q + 12 * i + 4 * c, rows[i]);
    }
}

static inline void store_stress(const KernelData *s, const Block *block, const v4 P[D][D], const v4 q[D])
{
    store_rows(s->Q, block, P, q);
}

/* Forces of Q on n blocks of one stencil, particle by particle: Σ V P x H, the adjoint of the gradient, and in the same
 * sums that of the Laplacian, where there is one. */
INLINED void gather_rows(const KernelData *s, const double *rows, const Block *block, const int n, const int laplacians,
                         v4 f[][FORCES])
{
    for (int from = 0; from < 4; from += LANES(n)) {
        v4 acc[MOST][4][D] = {{{{0}}}};
        for (long k = s->first[block->stencil]; k < s->first[block->stencil + 1]; k++) {
            const coefficient *h = s->adjoint + 16 * k + 4 * from;
            size_t at[4];
            neighbours(s->column + 4 * k, at);
            __builtin_prefetch(h + 16 * AHEAD);
            for (int i = 0; i < LANES(n); i++) {
                const v4 a = four_of(h + 4 * i);
                for (int m = 0; m < n; m++) {
                    const double *Q = rows + 12L * block[m].shift + 2 * at[from + i];
                    for (int c = 0; c < D; c++) acc[m][i][c] = fma4(load(Q + 4 * c), a, acc[m][i][c]);
                }
            }
        }
        for (int m = 0; m < n; m++)
            for (int i = 0; i < LANES(n); i++) {
                const v4 parts[4] = {acc[m][i][0], acc[m][i][1], acc[m][i][2]};
                v4 by_entry[4];
                transpose(parts, by_entry);
                f[m][from + i] = (by_entry[0] + by_entry[1]) + by_entry[2];
                if (laplacians) f[m][from + i] += by_entry[3];
            }
    }
}

INLINED void gather_stress(const KernelData *s, const Block *block, const int n, const int laplacians, v4 f[][FORCES])
{
    gather_rows(s, s->Q, block, n, laplacians, f);
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
    const double det = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e);
    const double half = 0.5 * det / (square * sqrt(square));
    return mean + 2 * sqrt(square) * cos(acos(fmax(-1, fmin(1, half))) / 3);
}
