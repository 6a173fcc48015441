/* The director in space: a unit vector, whose gradients and Laplacians are those of a displacement. */

/* Reference gradients and Laplacians of the components of h at the particles, and h, by blocks. */
void director_field(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block *block = block_at(s, b);
        v4 g[1][D * D], bend[1][D];
        gather_both(s, block, 1, 1, s->director, g, bend);
        for (int k = 0; k < D * D; k++) store(s->director_gradient + 4 * (D * D * b + k), g[0][k / D + D * (k % D)]);
        for (int c = 0; c < D; c++) store(s->director_bend + 4 * (D * b + c), bend[0][c]);
        for (int i = 0; i < block->lanes; i++)
            for (int c = 0; c < D; c++)
                s->director_axis[4 * (D * b + c) + i] = s->director[2 * D * (long)(block->row + i) + c];
    }
}
