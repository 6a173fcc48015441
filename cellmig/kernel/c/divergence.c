/* Pass 2 of the internal force: the divergence of the stress, and the update of the state. */

/* Forces on the particles of blocks b … b + n - 1, of one stencil: of stresses; of both stabilisations; and s->force,
 * which is reset. */
INLINED void divergence(const KernelData *s, long b, const int n, v4 f[][FORCES])
{
    const Block *block = block_at(s, b);
    gather_stress(s, block, n, BENDS, f);
    for (int m = 0; m < n; m++) {
        if (!block[m].loaded) continue;
        double *force = s->force + D * (long)block[m].row;
        add_forces(f[m], force, block->lanes);
        memset(force, 0, sizeof(double) * D * (size_t)block->lanes);
    }
}

/* Kick and drift of n blocks of one stencil at b. */
INLINED void kick_and_drift_blocks(const KernelData *s, long b, const int n, double kick, double dt)
{
    const Block *block = block_at(s, b);
    const double *per_mass = s->per_mass + 4L * block->stencil;
    double gain[D];
    for (int c = 0; c < D; c++) gain[c] = kick * s->acceleration[c];
    v4 f[MOST][FORCES];
    divergence(s, b, n, f);
    for (int m = 0; m < n; m++)
        for (int i = 0; i < block->lanes; i++)
            kick_and_drift_particle(f[m], i, kick * per_mass[i], gain, dt, s->state + 2 * D * (long)(block[m].row + i));
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
