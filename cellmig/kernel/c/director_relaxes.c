/* Relaxation of the director, which turns by mobility x torque. */

/* V times the derivatives of the energy by the gradients of the director, from which torques follow. */
static void director_fluxes(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block *block = block_at(s, b);
        const v4 V = load(s->volume + 4L * block->stencil);
        v4 g[M][D], F[D][D], flux[M][D] = {{{0}}};
        load_director_gradient(s, b, g);
        load_F(s, b, F);
        director_flux(s, block->material, F, g, flux);
        for (int k = 0; k < M * D; k++) flux[k / D][k % D] *= V;
        store_flux(s, b, flux);
    }
}

/* Directors of anchors, gradients and axes, before stresses need them. */
int director_ready(const KernelData *s)
{
    anchor_director(s);
    if (exchange(s, s->director_vec)) return 1;
    director_field(s);
    return 0;
}

/* A step of the directors; the mobility of anchors is 0. */
int director_step(const KernelData *s, double dt)
{
    director_fluxes(s);
    director_torque(s);
    if (s->n_anchors_anywhere && exchange(s, s->director_vec)) return 1;
    anchor_couple(s);
    for (long i = 0; i < s->n_owned; i++) {
        double *own = s->director + 2L * M * i, turn[M];
        for (int m = 0; m < M; m++) {
            const double rate = s->director_mobility[i] * own[M + m];
            turn[m] = dt * rate;
            s->viscous_loss[i] += dt * rate * own[M + m];
        }
        if (dt * s->director_mobility[i] != 0) turn_by(own, turn);
    }
    return 0;
}

/* Makes the loss of a step dt of the directors trapezoidal, for torques (n_owned, M) before it and those of now. */
void complete_loss(const KernelData *s, const double *before, double dt)
{
    for (long i = 0; i < s->n_owned; i++)
        for (int m = 0; m < M; m++) {
            const double torque = before[M * i + m], change = s->director[2L * M * i + M + m] - torque;
            s->viscous_loss[i] += 0.5 * dt * s->director_mobility[i] * torque * change;
        }
}
