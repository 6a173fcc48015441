/* The operators of viscosity and of sound in the current configuration, whose fastest modes limit the step. */

/* Accelerations (n_owned, 4) of the numbers `at` and at + 1 of `mode` (n_local, 4), by isotropic stresses with moduli
 * against shear and dilation, by stencil. */
void respond(const KernelData *s, const double *shear, const double *bulk, const double *mode, double *out, long at)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block *block = block_at(s, b);
        const double *f = s->F + 16 * b;
        const v4 F[D][D] = {{load(f), load(f + 8)}, {load(f + 4), load(f + 12)}};
        const v4 V = load(s->volume + 4L * block->stencil), G = load(shear + 4L * block->stencil);
        v4 r[1][4], P[D][D], A[D][D], pressure, rate;
        gather(s, block, 1, mode + at, r);
        const v4 R[D][D] = {{r[0][0], r[0][2]}, {r[0][1], r[0][3]}};
        bulk_damping_stress(0, V * load(bulk + 4L * block->stencil), F, R, P, &pressure, &rate);
        shear_stress(0, V * G, F, R, A);
        add_stress(P, A);
        store_stress(s, block, P);
    }
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = *block_at(s, b);
        v4 f[1][2];
        gather_stress(s, &block, 1, 0, f);
        for (int i = 0; i < block.lanes; i++)
            for (int c = 0; c < D; c++)
                out[4L * (block.row + i) + at + c] = -s->inverse_mass[block.row + i] * f[0][i / 2][2 * (i % 2) + c];
    }
}
