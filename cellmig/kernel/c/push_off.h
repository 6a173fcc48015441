/* How firmly cells hold on to other bodies against their push off these, and the accounts of this push. */

/* Aims all drives, for which nothing holds yet. */
static void aim_all(const KernelData *s)
{
    for (long m = 0; m < SIDES * s->n_movers; m++) {
        aim(s, m / SIDES, m);
        s->hold_off[m] = 0;
    }
}

/* What holds all drives, by closed bonds, becomes the share of their push. */
static void hold_all(const KernelData *s)
{
    for (long m = 0; m < SIDES * s->n_movers; m++) s->hold_off[m] = push_off_hold(s->push_off + 1, s->hold_off[m]);
}

/* Trapezoidal work of the steps on both bodies; `pushed_off` are the forces of the last kick. */
static void account_push_off(const KernelData *s, double accounted_dt, double dt)
{
    for (long k = 0; k < D * s->n_own_surface; k++) {
        const long i = s->own_surface[k / D];
        s->external_work[i] += 0.5 * accounted_dt * s->pushed_off[k] * velocity(s, i, k % D);
        s->pushed_off[k] = 0;
    }
    for (long k = 0; k < D * s->n_contact_nodes; k++) {
        const long on = s->contact_own[k / D];
        if (on < 0) continue;
        const long i = s->own_surface[on];
        const double f = contact_load(s, k / D)[k % D];
        s->pushed_off[D * on + k % D] += f;
        s->external_work[i] += 0.5 * dt * f * velocity(s, i, k % D);
    }
}
