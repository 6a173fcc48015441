/* The operators of viscosity and of sound in the current configuration, whose fastest modes limit the step. */

/* Accelerations (n_owned, 2 D) of D of the numbers of `mode` (n_local, 2 D), from `at` on, by isotropic stresses with
 * moduli against shear and dilation, by stencil. */
void respond(const KernelData *s, const double *shear, const double *bulk, const double *mode, double *out, long at)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block *block = block_at(s, b);
        const v4 V = load(s->volume + 4L * block->stencil), G = load(shear + 4L * block->stencil);
        v4 F[D][D], r[1][D * D], R[D][D], P[D][D], A[D][D], pressure, rate, none[D] = {{0}};
        load_F(s, b, F);
        gather(s, block, 1, mode + at, r);
        matrix_of(r[0], R);
        bulk_damping_stress(0, V * load(bulk + 4L * block->stencil), F, R, P, &pressure, &rate);
        shear_stress(0, V * G, F, R, A);
        add_stress(P, A);
        store_stress(s, block, P, none);
    }
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = *block_at(s, b);
        v4 f[1][FORCES];
        gather_stress(s, &block, 1, 0, f);
        for (int i = 0; i < block.lanes; i++)
            for (int c = 0; c < D; c++)
                out[2 * D * (long)(block.row + i) + at + c] = -s->inverse_mass[block.row + i] * force_on(f[0], i, c);
    }
}
