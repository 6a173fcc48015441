/* Deformation gradients F and their rates, by blocks, entries by columns. */

/* F = I + ∇u of block b, and Laplacians C u, from the displacements as they are; where neighbours have been found anew,
 * `base` has what both are for u = 0. */
static inline void deformation_of_block(const KernelData *s, long b, v4 F[1][D * D], v4 bend[1][D])
{
    gather_both(s, block_at(s, b), 1, BENDS, s->state, F, bend);
    const double *base = s->base + 4 * D * (D + 1) * b;
    for (int c = 0; !RENEWED && c < D; c++) F[0][(D + 1) * c] += 1.0;
    for (int k = 0; RENEWED && k < D * D; k++) F[0][k] += load(base + 4 * k);
    for (int c = 0; RENEWED && BENDS && c < D; c++) bend[0][c] += load(base + 4 * (D * D + c));
}

/* F and Laplacians of all blocks. */
void deformation(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        v4 h[1][D * D], bend[1][D];
        deformation_of_block(s, b, h, bend);
        for (int k = 0; k < D * D; k++) store(s->F + 4 * (D * D * b + k), h[0][k]);
        for (int c = 0; BENDS && c < D; c++) store(s->bend + 4 * (D * b + c), bend[0][c]);
    }
}

/* Ḟ = ∇v. */
void velocity_gradient(const KernelData *s, double *out)
{
    for (long b = 0; b < s->n_blocks; b++) {
        v4 r[1][D * D];
        gather(s, block_at(s, b), 1, s->state + D, r);
        for (int k = 0; k < D * D; k++) store(out + 4 * (D * D * b + k), r[0][k]);
    }
}

/* Extends `range`, the least and the largest J, by the lanes that a block has. */
static inline void extend_range(const v4 f[D * D], int lanes, v4 range[2])
{
    v4 F[D][D];
    matrix_of(f, F);
    v4 J = volume_ratio(0, F);
    for (int i = lanes; i < 4; i++) J[i] = J[0];
    range[0] = smaller(range[0], J);
    range[1] = larger(range[1], J);
}
