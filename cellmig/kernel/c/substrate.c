/* F_cs of equation (2): adhesion to the plane y = 0, integrated along the segments near it. */

/* Forces; energies by the first ends of the segments, if asked for; impulses of a time dt. */
void add_substrate(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long k = 0; k < s->n_near; k++) {
        const Facet e = facet_at(s, s->near[k]);
        double f[2][D], stored, impulse[2];
        if (e.gap[0] < s->least_gap[0]) s->least_gap[0] = e.gap[0];
        substrate_segment(s->substrate, e.size, e.gap[0], e.gap[1], dt, f, &stored, impulse);
        add_to_corners(force, e.node, f);
        for (int i = 0; i < 2; i++) *impulse_at(s, &e, i, BY_BONDS) += impulse[i];
        if (energy) energy[e.node[0]] += stored;
    }
}
