/* How firmly cells hold on to the substrate against the push of their leading edges, and the accounts of this. */

/* Of each cell that protrudes, the middle of its surface along x, and how firmly its front half holds on to the
 * substrate.  Every rank that owns a part of the cell sums over all of it, in the same order. */
static void find_hold(const KernelData *s)
{
    for (long c = 0; c < s->n_movers; c++) {
        double middle = 0, bonded = 0;
        for (long k = s->first_mover[c]; k < s->first_mover[c + 1]; k++)
            middle += s->mover_weight[k] * coordinate(s, s->mover[k], TANGENT);
        for (long k = s->first_grip[c]; k < s->first_grip[c + 1] && bonded < s->firm; k++) {
            const Facet e = facet_at(s, s->grip[k]);
            double x = 0;
            for (int i = 0; i < D; i++) x += coordinate(s, e.node[i], TANGENT) / D;
            bonded += protrusion_grip(s->protrusion, e.size, x - middle, GAPS(e.gap));
        }
        s->middle[c] = middle;
        s->hold[c] = protrusion_hold(s->protrusion, bonded);
    }
}

/* Accounts of a force `now` on corner i of facet e along x. */
static inline void account_push(const KernelData *s, const Facet *e, int i, double now, double accounted_dt, double dt)
{
    double *pushed = s->pushed + D * e->number + i;
    const double v = velocity(s, e->node[i], TANGENT);
    s->protrusion_impulse[e->node[i]] += dt * now;
    *impulse_at(s, e, i, BY_PUSH) += dt * now;
    s->external_work[e->node[i]] += 0.5 * (accounted_dt * *pushed + dt * now) * v;
    *pushed = now;
}
