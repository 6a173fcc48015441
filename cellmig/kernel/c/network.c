/* Networks whose bonds break and form again: A of the rows, by blocks, entries by columns. */

/* Adds to an account of each lane. */
static inline void add(double *account, v4 amount) { store(account, load(account) + amount); }

/* A of block b. */
static inline void load_network(const KernelData *s, long b, v4 A[D][D])
{
    v4 a[D * D];
    for (int k = 0; k < D * D; k++) a[k] = load(s->network + 4 * (D * D * b + k));
    matrix_of(a, A);
}

/* What a network loses in a time at F. */
INLINED void lose(const KernelData *s, long b, const int material, const v4 F[D][D], const v4 A[D][D], double time)
{
    v4 rate[1];
    network_loss(s, material, F, A, rate);
    add(s->step_memory[b].network_loss, time * load(s->volume + 4L * block_at(s, b)->stencil) * rate[0]);
}

/* Shares of the bonds that form anew at the begin and the end of steps of a time. */
static inline void set_network_step(const KernelData *s, double time)
{
#define SHARES(i) if (has_network_shares(i)) network_shares(s, i, time, s->network_step + 2 * (i));
    EACH_MATERIAL(SHARES)
}

/* Bonds of a block break and form while it is deformed from F0 to F1 in a time, for which the shares are set; the loss
 * is that of the middle. */
INLINED void renew_network(const KernelData *s, long b, const int material, const v4 F0[D][D], const v4 F1[D][D],
                           double time)
{
    if (!has_network_renewed(material)) return;
    const double *share = s->network_step + 2 * material;
    v4 A[D][D], begin[D][D], end[D][D], F[D][D];
    load_network(s, b, A);
    network_renewed(s, material, F0, A, splat(share[0]), begin);
    network_renewed(s, material, F1, begin, splat(share[1]), end);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) {
            store(s->network + 4 * (D * D * b + i + D * j), end[i][j]);
            A[i][j] = 0.5 * (A[i][j] + end[i][j]);
            F[i][j] = 0.5 * (F0[i][j] + F1[i][j]);
        }
    lose(s, b, material, F, A, time);
}

/* The same for all blocks, from F as it was to that of the displacements as they are. */
static inline void networks_follow(const KernelData *s, double time)
{
    set_network_step(s, time);
    for (long b = 0; b < s->n_blocks; b++) {
        v4 h[1][D * D], bend[1][D], F0[D][D], F1[D][D];
        deformation_of_block(s, b, h, bend);
        matrix_of(h[0], F1);
        load_F(s, b, F0);
        renew_network(s, b, block_at(s, b)->material, F0, F1, time);
    }
}

/* Losses in a time dt at the state as it is, which may be within a step. */
static inline void networks_lose(const KernelData *s, double dt)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const int material = block_at(s, b)->material;
        if (!has_network_renewed(material)) continue;
        v4 A[D][D], now[D][D], F[D][D];
        load_F(s, b, F);
        load_network(s, b, A);
        network_renewed(s, material, F, A, splat(s->network_share[material]), now);
        lose(s, b, material, F, now, dt);
    }
}
