/* Pass 2 of the internal force: the divergence of the stress, and the update of the state. */

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
INLINED void gather_stress(const KernelData *s, const Block *block, const int n, const int laplacians, v4 f[][2])
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

/* Forces on the particles of blocks b … b + n - 1, of one stencil: of stresses; of both stabilisations; and s->force,
 * which is reset. */
INLINED void divergence(const KernelData *s, long b, const int n, v4 f[][2])
{
    const Block *block = block_at(s, b);
    gather_stress(s, block, n, BENDS, f);
    for (int m = 0; m < n; m++) {
        if (!block[m].loaded) continue;
        double outside[8] = {0}, *force = s->force + D * (long)block[m].row;
        const size_t size = sizeof(double) * D * (size_t)block->lanes;
        memcpy(outside, force, size);
        memset(force, 0, size);
        for (int i = 0; i < 2; i++) f[m][i] += load(outside + 4 * i);
    }
}

/* Kick and drift of n blocks of one stencil at b. */
INLINED void kick_and_drift_blocks(const KernelData *s, long b, const int n, double kick, double dt)
{
    const Block *block = block_at(s, b);
    const v4 none = {0}, gravity = {0, 0, kick * s->acceleration[0], kick * s->acceleration[1]};
    const double *per_mass = s->per_mass + 4L * block->stencil;
    v4 f[MOST][2];
    divergence(s, b, n, f);
    for (int m = 0; m < n; m++) {
        const v4 rows[4] = {
            SHUFFLE(f[m][0], none, 4, 4, 0, 1), SHUFFLE(f[m][0], none, 4, 4, 2, 3),
            SHUFFLE(f[m][1], none, 4, 4, 0, 1), SHUFFLE(f[m][1], none, 4, 4, 2, 3)};
        for (int i = 0; i < block->lanes; i++) {
            double *z = s->state + 2 * D * (long)(block[m].row + i);
            v4 x = load(z) + kick * per_mass[i] * rows[i] + gravity;
            x += dt * SHUFFLE(x, none, 2, 3, 4, 4);
            store(z, x);
        }
    }
}

/* v += kick (f/m + g), then u += dt v, for the particles of some blocks. */
static void kick_and_drift_some(const KernelData *s, long from, long end, double kick, double dt)
{
#define KICK(n) kick_and_drift_blocks(s, b, n, kick, dt)
    EACH_BLOCK(from, end, KICK)
}

/* The same for all owned particles. */
void kick_and_drift(const KernelData *s, double kick, double dt)
{
    kick_and_drift_some(s, 0, s->n_owned_blocks, kick, dt);
}
