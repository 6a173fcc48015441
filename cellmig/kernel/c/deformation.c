/* Deformation gradients F and their rates, by blocks, lanes 00 10 01 11. */

/* F = I + ∇u, and Laplacians C u, from the displacements as they are. */
void deformation(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        v4 h[1][4], bend[1][D];
        gather_both(s, block_at(s, b), 1, BENDS, s->state, h, bend);
        h[0][0] += 1.0;
        h[0][3] += 1.0;
        for (int c = 0; c < 4; c++) store(s->F + 16 * b + 4 * c, h[0][c]);
        for (int c = 0; BENDS && c < D; c++) store(s->bend + 4 * (D * b + c), bend[0][c]);
    }
}

/* Ḟ = ∇v. */
void velocity_gradient(const KernelData *s, double *out)
{
    for (long b = 0; b < s->n_blocks; b++) {
        v4 r[1][4];
        gather(s, block_at(s, b), 1, s->state + D, r);
        for (int c = 0; c < 4; c++) store(out + 16 * b + 4 * c, r[0][c]);
    }
}

/* Extends `range`, the least and the largest J, by the lanes that a block has. */
static inline void extend_range(const v4 f[4], int lanes, v4 range[2])
{
    v4 J = f[0] * f[3] - f[1] * f[2];
    for (int i = lanes; i < 4; i++) J[i] = J[0];
    range[0] = smaller(range[0], J);
    range[1] = larger(range[1], J);
}
