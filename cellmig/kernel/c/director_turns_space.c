/* The unit vector of the director turns, or is anchored at the membrane. */

/* Stores V times the derivative of the energy by the gradients for the rows of block b, as of a stress, with that of
 * the energy of short waves that nodal integrals miss.  They would grow: they lower the energy of curved fields. */
static inline void store_flux(const KernelData *s, long b, const v4 flux[M][D])
{
    const Block *block = block_at(s, b);
    v4 bent[D];
    for (int c = 0; c < D; c++)
        bent[c] = load(s->director_modulus + 4L * block->stencil) * load(s->director_bend + 4 * (D * b + c));
    store_rows(s->director_flux, block, flux, bent);
}

/* Torque on the owned particles, the part across their director. */
static void director_torque(const KernelData *s)
{
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block *block = block_at(s, b);
        v4 f[1][FORCES];
        gather_rows(s, s->director_flux, block, 1, 1, f);
        for (int i = 0; i < block->lanes; i++) {
            double *own = s->director + 2L * M * (block->row + i), along = 0;
            for (int c = 0; c < M; c++) along += own[c] * f[0][i][c];
            for (int c = 0; c < M; c++) own[M + c] = f[0][i][c] - along * own[c];
        }
    }
}

/* Turns a director by a small amount. */
static inline void turn_by(double director[M], const double turn[M])
{
    for (int c = 0; c < M; c++) director[c] += turn[c];
    const double length = sqrt(dot3(director, director));
    for (int c = 0; c < M; c++) director[c] /= length;
}

/* Edges of triangle r of those around an anchor at a particle, from there to its other corners. */
static inline void edges_around(const KernelData *s, long at, long r, double first[D], double second[D])
{
    edge_between(s, at, s->anchor_ring[2 * r], first);
    edge_between(s, at, s->anchor_ring[2 * r + 1], second);
}

/* The normal of the membrane at anchor k, and a tangent that its particles carry along. */
static void membrane_at(const KernelData *s, long k, double normal[D], double tangent[D])
{
    for (int c = 0; c < D; c++) normal[c] = tangent[c] = 0;
    for (long r = s->first_anchor_ring[k]; r < s->first_anchor_ring[k + 1]; r++) {
        double first[D], second[D], area[D];
        edges_around(s, s->anchor[k], r, first, second);
        cross3(first, second, area);
        for (int c = 0; c < D; c++) {
            normal[c] += area[c];
            tangent[c] += s->anchor_weight[r] * first[c];
        }
    }
}

/* Anchored particles keep the parts of their director along the normal and the tangent. */
static void anchor_director(const KernelData *s)
{
    for (long k = 0; k < s->n_anchors; k++) {
        double *normal = s->anchor_frame + 2 * D * k, *tangent = normal + D;
        membrane_at(s, k, normal, tangent);
        if (s->anchor_owned[k])
            anchor_direction(0, normal, tangent, s->anchor_offset[2 * k], s->anchor_offset[2 * k + 1],
                             s->director + 2L * M * s->anchor[k]);
    }
}

/* What an anchor takes of the torque acts on the membrane as a couple. */
static void anchor_couple(const KernelData *s)
{
    for (long k = 0; k < s->n_anchors; k++) {
        const double *director = s->director + 2L * M * s->anchor[k], *normal = s->anchor_frame + 2 * D * k;
        double by_normal[D], by_tangent[D];
        anchor_reaction(0, normal, normal + D, director, director + M, by_normal, by_tangent);
        for (long r = s->first_anchor_ring[k]; r < s->first_anchor_ring[k + 1]; r++) {
            const long node[D] = {s->anchor[k], s->anchor_ring[2 * r], s->anchor_ring[2 * r + 1]};
            double first[D], second[D], f[D][D];
            edges_around(s, s->anchor[k], r, first, second);
            cross3(second, by_normal, f[1]);
            cross3(by_normal, first, f[2]);
            for (int c = 0; c < D; c++) {
                f[1][c] += s->anchor_weight[r] * by_tangent[c];
                f[0][c] = -(f[1][c] + f[2][c]);
            }
            add_to_corners(s->force, node, f);
        }
    }
}
