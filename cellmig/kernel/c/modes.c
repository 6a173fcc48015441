/* The operators of viscosity and of sound in the current configuration, whose fastest modes limit the step. */

/* DO(n) as EACH_BLOCK does, but for MOST blocks or for one: the compiler makes less of the step with more beside it. */
#define EACH_GROUP(from, end, DO)                                                                                     \
    for (long b = (from), end_ = (end), n_; b < end_; b += n_) {                                                      \
        n_ = together(s, b, end_) == MOST ? MOST : 1;                                                                 \
        if (n_ == MOST) DO(MOST);                                                                                     \
        else DO(1);                                                                                                   \
    }

/* Isotropic stresses of n blocks of one stencil at b by moduli against shear and dilation, for one of the `mode`s. */
INLINED void mode_stress(const KernelData *s, long b, const int n, const double *shear, const double *bulk,
                         const double *mode)
{
    const Block *block = block_at(s, b);
    const v4 V = load(s->volume + 4L * block->stencil), G = load(shear + 4L * block->stencil);
    const v4 K = V * load(bulk + 4L * block->stencil), none[D] = {{0}};
    v4 r[MOST][D * D];
    gather(s, block, n, mode, r);
    for (int m = 0; m < n; m++) {
        v4 F[D][D], R[D][D], P[D][D], A[D][D], pressure, rate;
        load_F(s, b + m, F);
        matrix_of(r[m], R);
        bulk_damping_stress(0, K, F, R, P, &pressure, &rate);
        shear_stress(0, V * G, F, R, A);
        add_stress(P, A);
        store_stress(s, block + m, P, none);
    }
}

/* Accelerations of n blocks of one stencil at b by these stresses. */
INLINED void mode_acceleration(const KernelData *s, long b, const int n, double *out)
{
    const Block *block = block_at(s, b);
    v4 f[MOST][FORCES];
    gather_stress(s, block, n, 0, f);
    for (int m = 0; m < n; m++)
        for (int i = 0; i < block->lanes; i++)
            for (int c = 0; c < D; c++) {
                const long row = block[m].row + i;
                out[2 * D * row + c] = -s->inverse_mass[row] * force_on(f[m], i, c);
            }
}

/* Accelerations (n_owned, 2 D) of D of the numbers of `mode` (n_local, 2 D), from `at` on, by isotropic stresses with
 * moduli against shear and dilation, by stencil. */
void respond(const KernelData *s, const double *shear, const double *bulk, const double *mode, double *out, long at)
{
#define RESPOND(n) mode_stress(s, b, n, shear, bulk, mode + at)
    EACH_GROUP(0, s->n_owned_blocks, RESPOND)
    EACH_GROUP(s->n_owned_blocks, s->n_blocks, RESPOND)
#define ACCELERATE(n) mode_acceleration(s, b, n, out + at)
    EACH_GROUP(0, s->n_owned_blocks, ACCELERATE)
}
