/* The angle of the director turns, or is anchored at the membrane. */

/* Torque on the owned particles from V times the derivative of the energy by the gradient. */
static void director_torque(const KernelData *s)
{
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = *block_at(s, b);
        const double *flux = s->director_flux + D * (long)block.shift;
        for (int i = 0; i < block.lanes; i++) {
            double torque = 0;
            for (long k = s->first[block.stencil]; k < s->first[block.stencil + 1]; k++) {
                const coefficient *h = s->adjoint + 8 * k + 4 * (i / 2) + i % 2;
                const uint32_t j = s->column[4 * k + i] / 2;
                torque += h[0] * flux[j] + h[2] * flux[j + 1];
            }
            s->director[2L * (block.row + i) + 1] = torque;
        }
    }
}

/* Stores V times that derivative for the rows of block b. */
static inline void store_flux(const KernelData *s, long b, const v4 flux[M][D])
{
    const Block *block = block_at(s, b);
    for (int i = 0; i < block->lanes; i++)
        for (int c = 0; c < D; c++) s->director_flux[D * (long)(block->row + i) + c] = flux[0][c][i];
}

static inline void turn_by(double director[M], const double turn[M]) { director[0] += turn[0]; }

/* Anchored particles take the angle of the membrane, the vector between their neighbours along it. */
static void anchor_director(const KernelData *s)
{
    for (long k = 0; k < s->n_anchors; k++) {
        const int32_t *a = s->anchor + 3 * k; /* particles before, at, after */
        double edge[D];
        edge_between(s, a[0], a[2], edge);
        if (s->anchor_owned[k]) s->director[2 * a[1]] = atan2(edge[1], edge[0]) + s->anchor_offset[k];
    }
}

/* What an anchor takes of the torque acts on the membrane as a couple. */
static void anchor_couple(const KernelData *s)
{
    for (long k = 0; k < s->n_anchors; k++) {
        const int32_t *a = s->anchor + 3 * k;
        const long node[2] = {a[0], a[2]};
        double edge[D], f[D][D];
        edge_between(s, a[0], a[2], edge);
        couple_force(0, s->director[2 * a[1] + 1], edge, f);
        add_to_corners(s->force, node, f);
    }
}
