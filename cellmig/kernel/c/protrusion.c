/* F_d of equation (2): push of the leading edge. */

/* Length of closed bonds under the front half of a cell along a drive, up to what holds it. */
static double bonded_along(const KernelData *s, const Drive *drive, long m)
{
    const long c = m / SIDES;
    double bonded = 0;
    for (long k = s->first_grip[c]; k < s->first_grip[c + 1] && bonded < s->firm; k++) {
        const Facet e = facet_at(s, s->grip[k]);
        bonded += protrusion_grip(s->protrusion, e.size, ahead_of_middle(s, drive, m, &e), GAPS(e.gap));
    }
    return bonded;
}

/* Forces; impulses and trapezoidal work of the steps, unless `energy` says that forces alone are asked for.  push[D e]
 * and on hold β α N σ/D of the corners of facet e, `pushed` their forces at the start of the step. */
void add_protrusion(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    find_hold(s);
    for (long k = 0; k < s->n_near; k++) {
        if (!is_pushed(s, s->near[k])) continue;
        const Facet e = facet_at(s, s->near[k]);
        const long mover = s->mover_of[e.number];
        double now[D][PLANE] = {{0}};
        for (long m = SIDES * mover; m < SIDES * (mover + 1); m++) {
            const Drive *drive = drive_at(s, m);
            double f[D][D], ahead[D];
            for (int i = 0; i < D; i++) ahead[i] = along(s, drive, e.node[i]) - s->middle[m];
            protrusion_force(s->protrusion, s->push + D * e.number, s->hold[m], e.size, ahead, e.gap, f);
            for (int i = 0; i < D; i++)
                for (int c = 0; c < PLANE; c++) now[i][c] += drive->strength * f[i][TANGENT] * drive->direction[c];
        }
        for (int i = 0; i < D; i++) {
            for (int c = 0; c < PLANE; c++) force[D * e.node[i] + TANGENT + c] += now[i][c];
            if (!energy) account_push(s, &e, i, now[i], accounted_dt, dt);
        }
    }
}
