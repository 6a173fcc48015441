/* The operators of viscosity and of sound on the current configuration, whose fastest modes the step control follows. */

/* Accelerations out (n_owned, 4) of x and y at `axis`, by isotropic stresses with these moduli by stencil against the
 * gradient of the same two numbers of `mode` (n_local, 4). */
void respond(const KernelData *s, const double *shear, const double *bulk, const double *mode, double *out, long at)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block *block = block_at(s, b);
        const double *F = s->F + 16 * b;
        const v4 f[D][D] = {{load(F), load(F + 8)}, {load(F + 4), load(F + 12)}}, V = load(s->volume + 4L * block->stencil);
        v4 r[1][4], P[D][D];
        gather(s, block, 1, mode + at, r);
        const v4 R[D][D] = {{r[0][0], r[0][2]}, {r[0][1], r[0][3]}};
        isotropic_stress(0, V * load(shear + 4L * block->stencil), V * load(bulk + 4L * block->stencil), f, R, P);
        store_stress(s, block, P);
    }
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = *block_at(s, b);
        v4 f[1][2];
        gather_stress(s, &block, 1, f);
        for (int i = 0; i < block.lanes; i++)
            for (int c = 0; c < D; c++)
                out[4L * (block.row + i) + at + c] = -s->inverse_mass[block.row + i] * f[0][i / 2][2 * (i % 2) + c];
    }
}
