/* Tension of the surfaces, in their facets. */

/* Forces; energies by the first corners of the facets, if asked for. */
void add_cortex(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long k = 0; k < s->n_taut; k++) {
        const Facet facet = facet_at(s, s->taut[k]);
        double edge[D - 1][D], f[D][D];
        for (int i = 1; i < D; i++) edge_between(s, facet.node[0], facet.node[i], edge[i - 1]);
        cortex_force(s->cortex, facet.size, EDGES(edge), f);
        add_to_corners(force, facet.node, f);
        if (energy) energy[facet.node[0]] += cortex_energy(s->cortex, facet.size, EDGES(edge));
    }
}
