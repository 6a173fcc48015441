/* Relaxation of the director, whose angle changes by mobility x torque, and its anchoring at the membrane. */

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

/* Torque on the owned particles: the divergence of the fluxes, V times the derivative of the energy by the gradient. */
static void director_torque(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block block = *block_at(s, b);
        const double *gradient = s->director_gradient + 4 * D * b;
        const v4 g[D] = {load(gradient), load(gradient + 4)};
        v4 F[D][D], flux[D] = {{0}};
        load_F(s, b, F);
        director_flux(s, block.material, F, g, flux);
        for (int i = 0; i < block.lanes; i++)
            for (int c = 0; c < D; c++)
                s->director_flux[D * (long)(block.row + i) + c] = s->volume[4L * block.stencil + i] * flux[c][i];
    }
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

/* Angles of anchors, gradients and axes, before stresses need them. */
static int director_ready(const KernelData *s)
{
    anchor_director(s);
    if (exchange(s, s->director_vec)) return 1;
    director_field(s);
    return 0;
}

/* A step of the angles; the mobility of anchors is 0. */
static int director_step(const KernelData *s, double dt)
{
    director_torque(s);
    if (s->n_anchors_anywhere && exchange(s, s->director_vec)) return 1;
    anchor_couple(s);
    for (long i = 0; i < s->n_owned; i++) {
        const double rate = s->director_mobility[i] * s->director[2 * i + 1];
        s->director[2 * i] += dt * rate;
        s->viscous_loss[i] += dt * rate * s->director[2 * i + 1];
    }
    return 0;
}
