/* F_d of equation (2): push of the leading edge along +x. */

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

/* Forces; impulses and trapezoidal work of the steps, unless `energy` says that forces alone are asked for.  push[D e]
 * and on hold β α N σ/D of the corners of facet e, `pushed` their forces at the start of the step. */
void add_protrusion(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    find_hold(s);
    for (long k = 0; k < s->n_near; k++) {
        const Facet e = facet_at(s, s->near[k]);
        const double *push = s->push + D * e.number;
        double *pushed = s->pushed + D * e.number, f[D][D], ahead[D], most = 0;
        for (int i = 0; i < D; i++)
            if (push[i] > most) most = push[i];
        if (most == 0) continue;
        const double middle = s->middle[s->mover_of[e.number]], hold = s->hold[s->mover_of[e.number]];
        for (int i = 0; i < D; i++) ahead[i] = coordinate(s, e.node[i], TANGENT) - middle;
        protrusion_force(s->protrusion, push, hold, e.size, ahead, e.gap, f);
        add_to_corners(force, e.node, f);
        for (int i = 0; i < D && !energy; i++) {
            const double now = f[i][TANGENT], v = velocity(s, e.node[i], TANGENT);
            s->protrusion_impulse[e.node[i]] += dt * now;
            *impulse_at(s, &e, i, BY_PUSH) += dt * now;
            s->external_work[e.node[i]] += 0.5 * (accounted_dt * pushed[i] + dt * now) * v;
            pushed[i] = now;
        }
    }
}
