/* The director in two dimensions: its angle, its axis h, and the gradient of the angle. */

static inline double wrapped(double a) { return a - 2 * M_PI * rint(a / (2 * M_PI)); }

/* Reference gradient of the angle at the particles, and h, by blocks. */
void director_field(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block block = *block_at(s, b);
        const double *angle = s->director + 2L * block.shift;
        double *gradient = s->director_gradient + 4 * D * b, *axis = s->director_axis + 4 * D * b;
        for (int i = 0; i < block.lanes; i++) {
            const double own = s->director[2L * (block.row + i)];
            double g[D] = {0, 0};
            for (long k = s->first[block.stencil]; k < s->first[block.stencil + 1]; k++) {
                const coefficient *a = s->gradient + 8 * k + 4 * (i / 2) + i % 2;
                const double d = wrapped(angle[s->column[4 * k + i] / 2] - own);
                for (int c = 0; c < D; c++) g[c] += a[2 * c] * d;
            }
            for (int c = 0; c < D; c++) gradient[4 * c + i] = g[c];
            axis[i] = cos(own);
            axis[4 + i] = sin(own);
        }
    }
}
