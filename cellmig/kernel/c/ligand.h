/* The density of ligands on the substrate, over that of the bonds' law, by uniform cubic B-splines. */

/* Weights of the four samples around a place that is a share u of the spacing beyond the second, and their slopes. */
static inline void spline(double u, double weight[4], double slope[4])
{
    const double r = 1 - u;
    weight[0] = r * r * r / 6;
    weight[1] = (4 - u * u * (6 - 3 * u)) / 6;
    weight[2] = (4 - r * r * (6 - 3 * r)) / 6;
    weight[3] = u * u * u / 6;
    slope[0] = -0.5 * r * r;
    slope[1] = u * (1.5 * u - 2);
    slope[2] = r * (2 - 1.5 * r);
    slope[3] = 0.5 * u * u;
}

/* Number of the first of the four samples along an axis, the sums over them beginning with the first of the table. */
static inline long samples_around(const KernelData *s, const Facet *e, int axis, double weight[4], double slope[4])
{
    double x = 0;
    for (int i = 0; i < D; i++) x += coordinate(s, e->node[i], TANGENT + axis) / D;
    const long first = s->ligand_first[axis], count = s->ligand_count[axis];
    const double place = fmin(fmax(x / s->ligand_spacing, (double)first + 1), (double)(first + count - 3));
    const double below = floor(place);
    spline(place - below, weight, slope);
    return (long)below - first - 1;
}

/* The share below the middle of facet e, and its slopes along the substrate; sums over the samples around. */
static inline double ligand_at(const KernelData *s, const Facet *e, double slope[D - 1])
{
    double weight[D - 1][4], by[D - 1][4], share = 0;
    long at[D - 1];
    for (int c = 0; c < D - 1; c++) {
        at[c] = samples_around(s, e, c, weight[c], by[c]);
        slope[c] = 0;
    }
    const long columns = s->ligand_count[D - 2];
    for (int i = 0; i < 4; i++) {
        const double *samples = s->ligand + (D == 2 ? at[0] : (at[0] + i) * columns + at[D - 2]);
        if (D == 2) {
            share += weight[0][i] * samples[i];
            slope[0] += by[0][i] * samples[i];
            continue;
        }
        double along = 0, across = 0;
        for (int j = 0; j < 4; j++) {
            along += weight[D - 2][j] * samples[j];
            across += by[D - 2][j] * samples[j];
        }
        share += weight[0][i] * along;
        slope[0] += by[0][i] * along;
        if (D > 2) slope[D - 2] += weight[0][i] * across;
    }
    for (int c = 0; c < D - 1; c++) slope[c] /= s->ligand_spacing;
    return share;
}

/* The share below a facet that would store an energy `stored` with all ligands; forces on it to where ligands are,
 * equal on all corners, minus the gradient of share times energy.  The substrate takes the reaction: its impulse of a
 * time dt is that along the substrate which is no drag. */
static inline double pull_along(const KernelData *s, const Facet *e, double stored, double *force, double dt)
{
    double slope[D - 1];
    const double share = ligand_at(s, e, slope);
    for (int i = 0; i < D; i++)
        for (int c = 0; c < D - 1; c++) {
            const double along = -slope[c] * stored / D;
            force[D * e->node[i] + TANGENT + c] += along;
            *impulse_at(s, e, i, BY_PUSH + c) += dt * along;
        }
    return share;
}

/* The share alone, for drag and push. */
static inline double ligand_below(const KernelData *s, const Facet *e)
{
    double slope[D - 1];
    return ligand_at(s, e, slope);
}
