/* F_d of equation (2): push of the leading edge along +x. */

/* Forces; impulses and trapezoidal work of the steps, unless `energy` says that forces alone are asked for.  push[D e]
 * and on hold β α N σ/D of the corners of facet e, `pushed` their forces at the start of the step. */
void add_protrusion(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    find_hold(s);
    for (long k = 0; k < s->n_near; k++) {
        const Facet e = facet_at(s, s->near[k]);
        const double *push = s->push + D * e.number;
        double f[D][D], ahead[D], most = 0;
        for (int i = 0; i < D; i++)
            if (push[i] > most) most = push[i];
        if (most == 0) continue;
        const double middle = s->middle[s->mover_of[e.number]], hold = s->hold[s->mover_of[e.number]];
        for (int i = 0; i < D; i++) ahead[i] = coordinate(s, e.node[i], TANGENT) - middle;
        protrusion_force(s->protrusion, push, hold, e.size, ahead, e.gap, f);
        add_to_corners(force, e.node, f);
        for (int i = 0; i < D && !energy; i++) account_push(s, &e, i, f[i][TANGENT], accounted_dt, dt);
    }
}
