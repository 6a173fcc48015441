/* How firmly cells hold on to the substrate against their push, which facets are pushed, and the accounts of this. */

/* How far ahead of the middle of a cell a facet is, along drive m. */
static inline double ahead_of_middle(const KernelData *s, const Drive *drive, long m, const Facet *e)
{
    double x = 0;
    for (int i = 0; i < D; i++) x += along(s, drive, e->node[i]) / D;
    return x - s->middle[m];
}

static double bonded_along(const KernelData *s, const Drive *drive, long m);

/* Of each drive of each cell that protrudes, how firmly its front half holds on to the substrate, by all of it, as its
 * middle is summed. */
static void find_hold(const KernelData *s)
{
    for (long m = 0; m < SIDES * s->n_movers; m++) {
        const Drive *drive = aim(s, m / SIDES, m);
        s->hold[m] = protrusion_hold(s->protrusion, bonded_along(s, drive, m));
    }
}

/* Whether facet e is pushed, or was at the start of the step. */
static int is_pushed(const KernelData *s, long e)
{
    for (int i = 0; i < D; i++) {
        if (s->push[D * e + i] > 0) return 1;
        for (int c = 0; c < PLANE && GUIDED; c++)
            if (s->pushed[PLANE * (D * e + i) + c] != 0) return 1;
    }
    return 0;
}

/* Accounts of a force `now` on corner i of facet e along the substrate. */
static inline void account_push(const KernelData *s, const Facet *e, int i, const double now[PLANE],
                                double accounted_dt, double dt)
{
    double *pushed = s->pushed + PLANE * (D * e->number + i);
    s->protrusion_impulse[e->node[i]] += dt * now[0];
    for (int c = 0; c < PLANE; c++) {
        const double v = velocity(s, e->node[i], TANGENT + c);
        impulse_at(s, e, i, BY_PUSH)[c] += dt * now[c];
        s->external_work[e->node[i]] += 0.5 * (accounted_dt * pushed[c] + dt * now[c]) * v;
        pushed[c] = now[c];
    }
}
