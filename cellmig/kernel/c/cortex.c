/* Tension of the surfaces, along their segments. */

/* Forces; energies by the first ends of the segments, if asked for. */
void add_cortex(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long e = 0; e < s->n_facets; e++) {
        const long node[2] = {s->facet[2 * e], s->facet[2 * e + 1]};
        double edge[D], f[2][D];
        edge_between(s, node[0], node[1], edge);
        cortex_force(s->cortex, s->facet_size[e], edge, f);
        add_to_corners(force, node, f);
        if (energy) energy[node[0]] += cortex_energy(s->cortex, s->facet_size[e], edge);
    }
}
