/* F_cs of equation (2) in space: adhesion to the plane z = 0, integrated over the triangles near it. */

static const double STILL = 1e-3; /* change of a gap in a step, over the gap */

/* Forces along z of n triangles, and their energies. */
static void pull_down(const KernelData *s, const Facet *e, int n, double pull[D][TOGETHER], double stored[TOGETHER])
{
    int order[TOGETHER];
    double size[TOGETHER], gap[D][TOGETHER], kind[TOGETHER];
    sizes_and_gaps(e, n, size, gap);
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

/* A force along z on a corner of triangle e, and its impulse of a time dt. */
static inline void pull_corner(const KernelData *s, const Facet *e, int i, double *force, double pull, double dt)
{
    force[D * e->node[i] + NORMAL] += pull;
    *impulse_at(s, e, i, BY_BONDS) += dt * pull;
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
            for (int i = 0; i < D; i++) pull_corner(s, e + m, i, force, pull[i][m], dt);
            if (energy) energy[e[m].node[0]] += stored[m];
        }
    }
}

/* Whether gaps change by so little in a step that what it adds for their motion is below 2e-6 of the force. */
static inline int is_still(const KernelData *s, const Facet *e, double dt)
{
    double least = INFINITY, most = 0;
    for (int i = 0; i < D; i++) {
        least = d_minimum(least, e->gap[i]);
        most = d_maximum(most, fabs(velocity(s, e->node[i], NORMAL)));
    }
    return most * dt < STILL * least;
}

/* What a step of dt adds to these forces for the motion of the gaps in it: see surface.h. */
void add_substrate_in_motion(const KernelData *s, double dt)
{
    Facet e[TOGETHER], moved[TOGETHER];
    double share[TOGETHER], pull[D][TOGETHER], stored[TOGETHER];
    for (long from = 0, n; from < s->n_near;) {
        double sum[D][TOGETHER] = {{0}}; /* triangle by triangle: how they are grouped depends on the rank */
        for (n = 0; n < TOGETHER && from < s->n_near; from++) {
            moved[n] = e[n] = facet_at(s, s->near[from]);
            if (is_still(s, e + n, dt)) continue;
            share[n] = LIGAND ? ligand_below(s, e + n) : 1;
            n++;
        }
        for (int place = 0; place < PLACES; place++) {
            for (int m = 0; m < n; m++) {
                moved[m].size = e[m].size * (in_motion(place) * share[m]);
                moved_gaps(s, e + m, place, dt, moved[m].gap);
            }
            pull_down(s, moved, (int)n, pull, stored);
            for (int i = 0; i < D; i++)
                for (int m = 0; m < n; m++) sum[i][m] += pull[i][m];
        }
        for (int m = 0; m < n; m++)
            for (int i = 0; i < D; i++) pull_corner(s, e + m, i, s->force, sum[i][m], dt);
    }
}
