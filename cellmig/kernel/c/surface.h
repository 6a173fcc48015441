/* Facets of surfaces, on which the surface terms act: segments in two dimensions, triangles in three. */

/* A facet: its number, its corners, its length or area at rest, the gaps of its corners to the substrate. */
typedef struct { long number, node[D]; double size, gap[D]; } Facet;

/* Facet e of this rank. */
static inline Facet facet_at(const KernelData *s, long e)
{
    Facet facet = {.number = e, .size = s->facet_size[e]};
    for (int i = 0; i < D; i++) {
        facet.node[i] = s->facet[D * e + i];
        facet.gap[i] = coordinate(s, facet.node[i], NORMAL);
    }
    return facet;
}

/* Sizes and gaps of n facets. */
static inline void sizes_and_gaps(const Facet *e, int n, double size[TOGETHER], double gap[D][TOGETHER])
{
    for (int m = 0; m < n; m++) {
        size[m] = e[m].size;
        for (int i = 0; i < D; i++) gap[i][m] = e[m].gap[i];
    }
}

static inline void add_to_corners(double *force, const long node[D], const double f[D][D])
{
    for (int i = 0; i < D; i++)
        for (int c = 0; c < D; c++) force[D * node[i] + c] += f[i][c];
}

/* Adds a force of friction on a particle to those that rubbing.c accounts, if it is of this rank. */
static inline void rub(const KernelData *s, long i, const double f[D])
{
    for (int c = 0; i < s->n_owned && c < D; c++) s->rubs[D * i + c] += f[c];
}

/* What the substrate gives to a corner of a facet, each in places of bond_impulse of its own: along the normal, and
 * along the D - 1 axes of the substrate by drag, and by what else there is, the push and ligands. */
enum { BY_BONDS, BY_DRAG, BY_PUSH = BY_DRAG + D - 1, IMPULSES = BY_PUSH + D - 1 };

static inline double *impulse_at(const KernelData *s, const Facet *e, int corner, int kind)
{
    return s->bond_impulse + IMPULSES * (D * e->number + corner) + kind;
}

/* Bonds to the substrate close within a few steps.  The forces at the ends of a step dt do the work of the trapezoidal
 * rule, which misses dt² v³ d³U/dx³/12 a time of what bonds lose in energy, v being the speed.  So a step has in
 * addition -1/12 of the second difference of the force between gaps that are a step apart.  Their middle is a third of
 * a step back, since speeds are half a step old: then the work is right to the next order, too. */
enum { PLACES = 3 };

static inline double in_motion(int place) { return place == 1 ? 2.0 / 12 : -1.0 / 12; }

/* Gaps of the corners of a facet at one of the places, at their speeds. */
static inline void moved_gaps(const KernelData *s, const Facet *e, int place, double dt, double gap[D])
{
    const double time = (place - 4.0 / 3) * dt;
    for (int i = 0; i < D; i++) gap[i] = e->gap[i] + time * velocity(s, e->node[i], NORMAL);
}
