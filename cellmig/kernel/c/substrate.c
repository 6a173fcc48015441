/* F_cs of equation (2): adhesion to the plane y = 0, or z = 0 in space, integrated over the facets near it. */

/* Forces; energies by the first corners of the facets, if asked for; impulses of a time dt. */
void add_substrate(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long k = 0; k < s->n_near; k++) {
        const Facet e = facet_at(s, s->near[k]);
        double f[D][D], stored, impulse[D];
        for (int i = 0; i < D; i++)
            if (e.gap[i] < s->least_gap[0]) s->least_gap[0] = e.gap[i];
        substrate_facet(s->substrate, e.size, GAPS(e.gap), dt, f, &stored, impulse);
        if (LIGAND) {
            const double share = pull_along(s, &e, stored, force, dt);
            for (int i = 0; i < D; i++) f[i][NORMAL] *= share;
            for (int i = 0; i < D; i++) impulse[i] *= share;
            stored *= share;
        }
        add_to_corners(force, e.node, f);
        for (int i = 0; i < D; i++) *impulse_at(s, &e, i, BY_BONDS) += impulse[i];
        if (energy) energy[e.node[0]] += stored;
    }
}

/* What a step of dt adds to these forces for the motion of the gaps in it: see surface.h. */
void add_substrate_in_motion(const KernelData *s, double dt)
{
    for (long k = 0; k < s->n_near; k++) {
        const Facet e = facet_at(s, s->near[k]);
        const double share = LIGAND ? ligand_below(s, &e) : 1;
        for (int place = 0; place < PLACES; place++) {
            double gap[D], f[D][D], stored, impulse[D];
            moved_gaps(s, &e, place, dt, gap);
            substrate_facet(s->substrate, in_motion(place) * share * e.size, GAPS(gap), dt, f, &stored, impulse);
            add_to_corners(s->force, e.node, f);
            for (int i = 0; i < D; i++) *impulse_at(s, &e, i, BY_BONDS) += impulse[i];
        }
    }
}
