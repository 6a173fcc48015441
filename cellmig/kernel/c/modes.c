/* What limits the step: ½ dt M⁻¹ C + ¼ dt² M⁻¹ K of the current configuration, with all damping C and stiffness K of
 * stresses.  Leapfrog is stable where its largest eigenvalue is below 1. */

/* DO(n) as EACH_BLOCK does, but for MOST blocks or for one: the compiler makes less of the step with more beside it. */
#define EACH_GROUP(from, end, DO)                                                                                     \
    for (long b = (from), end_ = (end), n_; b < end_; b += n_) {                                                      \
        n_ = together(s, b, end_) == MOST ? MOST : 1;                                                                 \
        if (n_ == MOST) DO(MOST);                                                                                     \
        else DO(1);                                                                                                   \
    }

/* Stresses of n blocks of one stencil at b by `mode`: `damping` times those of rates, `squared` times those of
 * displacements. */
INLINED void mode_stress(const KernelData *s, long b, const int n, double damping, double squared, const double *mode)
{
    const Block *block = block_at(s, b);
    const long at = 4L * block->stencil;
    const v4 V = load(s->volume + at);
    const v4 shear = V * (damping * load(s->viscosity + at) + squared * load(s->shear_modulus + at));
    const v4 dilation = V * (damping * load(s->bulk_damping + at) + squared * load(s->dilation_modulus + at));
    v4 r[MOST][D * D], rate[MOST][D];
    gather_both(s, block, n, BENDS, mode, r, rate);
    for (int m = 0; m < n; m++) {
        v4 F[D][D], R[D][D], P[D][D], A[D][D], bend[D], bent[D] = {{0}}, pressure, of_volume;
        load_F(s, b + m, F);
        matrix_of(r[m], R);
        bulk_damping_stress(0, dilation, F, R, P, &pressure, &of_volume);
        shear_stress(0, shear, F, R, A);
        add_stress(P, A);
        if (STABILISED) {
            for (int c = 0; c < D; c++) bend[c] = load(s->bend + 4 * (D * (b + m) + c));
            stabilisation_stress(0, damping * load(s->bending_weight + at), F, R, bend, rate[m], bent, A);
            add_stress(P, A);
        }
        if (STIFFENED)
            for (int c = 0; c < D; c++) bent[c] += squared * load(s->bending_modulus + at) * rate[m][c];
        store_stress(s, block + m, P, bent);
    }
}

/* What n blocks of one stencil at b make of it, over the masses. */
INLINED void mode_response(const KernelData *s, long b, const int n, double *out)
{
    const Block *block = block_at(s, b);
    v4 f[MOST][FORCES];
    gather_stress(s, block, n, BENDS, f);
    for (int m = 0; m < n; m++)
        for (int i = 0; i < block->lanes; i++)
            for (int c = 0; c < D; c++) {
                const long row = block[m].row + i;
                out[2 * D * row + c] = -s->inverse_mass[row] * force_on(f[m], i, c);
            }
}

/* The first for some blocks. */
static void mode_stress_some(const KernelData *s, long from, long end, double damping, double squared,
                             const double *mode)
{
#define RESPOND(n) mode_stress(s, b, n, damping, squared, mode)
    EACH_GROUP(from, end, RESPOND)
}

/* The operator with the factors `damping` of C and `squared` of K on the first D of the numbers of `mode`
 * (n_local, 2 D), in those of out (n_owned, 2 D). */
void respond(const KernelData *s, double damping, double squared, const double *mode, double *out)
{
    mode_stress_some(s, 0, s->n_owned_blocks, damping, squared, mode);
    mode_stress_some(s, s->n_owned_blocks, s->n_blocks, damping, squared, mode);
#define ACCELERATE(n) mode_response(s, b, n, out)
    EACH_GROUP(0, s->n_owned_blocks, ACCELERATE)
}
