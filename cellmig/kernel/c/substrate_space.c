/* F_cs of equation (2) in space: adhesion to the plane z = 0, integrated over the triangles near it. */

/* Forces along z of n triangles, and their energies. */
static void pull_down(const KernelData *s, const Facet *e, int n, double pull[D][TOGETHER], double stored[TOGETHER])
{
    int order[TOGETHER];
    double size[TOGETHER], gap[D][TOGETHER], kind[TOGETHER];
    for (int m = 0; m < n; m++) {
        size[m] = e[m].size;
        for (int i = 0; i < D; i++) gap[i][m] = e[m].gap[i];
    }
    for (int m = 0; m < n; m += 4)
        store(kind + m, substrate_kind(s->substrate, load(gap[0] + m), load(gap[1] + m), load(gap[2] + m)));
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        v4 f[D], energy;
        substrate_facet(s->substrate, pick(size, of), pick(gap[0], of), pick(gap[1], of), pick(gap[2], of), f, &energy);
        for (int i = 0; i < D; i++) put(pull[i], of, f[i]);
        put(stored, of, energy);
    }
}

/* Forces; energies by the first corners of the triangles, if asked for; impulses of a time dt. */
void add_substrate(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    Facet e[TOGETHER];
    double pull[D][TOGETHER], stored[TOGETHER];
    for (long from = 0; from < s->n_near; from += TOGETHER) {
        const int n = (int)(s->n_near - from < TOGETHER ? s->n_near - from : TOGETHER);
        for (int m = 0; m < n; m++) {
            e[m] = facet_at(s, s->near[from + m]);
            for (int i = 0; i < D; i++) s->least_gap[0] = d_minimum(e[m].gap[i], s->least_gap[0]);
        }
        pull_down(s, e, n, pull, stored);
        for (int m = 0; m < n; m++) {
            if (LIGAND) {
                const double share = pull_along(s, e + m, stored[m], force, dt);
                for (int i = 0; i < D; i++) pull[i][m] *= share;
                stored[m] *= share;
            }
            for (int i = 0; i < D; i++) {
                force[D * e[m].node[i] + NORMAL] += pull[i][m];
                *impulse_at(s, e + m, i, BY_BONDS) += dt * pull[i][m];
            }
            if (energy) energy[e[m].node[0]] += stored[m];
        }
    }
}
