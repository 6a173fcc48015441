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

static inline void add_to_corners(double *force, const long node[D], const double f[D][D])
{
    for (int i = 0; i < D; i++)
        for (int c = 0; c < D; c++) force[D * node[i] + c] += f[i][c];
}

/* What the substrate gives to a corner of a facet, each in places of bond_impulse of its own: along the normal, and
 * along the D - 1 axes of the substrate by drag, and by what else there is, the push and ligands. */
enum { BY_BONDS, BY_DRAG, BY_PUSH = BY_DRAG + D - 1, IMPULSES = BY_PUSH + D - 1 };

static inline double *impulse_at(const KernelData *s, const Facet *e, int corner, int kind)
{
    return s->bond_impulse + IMPULSES * (D * e->number + corner) + kind;
}

/* Bonds to the substrate close within a few steps.  The forces at the ends of a step dt do the work of the trapezoidal
 * rule, which misses dt² v³ d³U/dx³/12 a time of what bonds lose in energy, v being the speed.  So a step has in addition
 * -1/16 of the second difference of the force between the gaps a step before, now and a step later.  For the shortest
 * steps it would take 1/12; speeds are half a step old, and 1/16 was measured best (docs/stability.md). */
static inline double in_motion(int at) { return at ? -1.0 / 16 : 2.0 / 16; }

/* Whether a gap of the facet changes by a hundredth in a step of dt: of slower ones the difference is below 1e-3. */
static inline int in_haste(const KernelData *s, const Facet *e, double dt)
{
    for (int i = 0; i < D; i++)
        if (fabs(dt * velocity(s, e->node[i], NORMAL)) > 0.01 * e->gap[i]) return 1;
    return 0;
}

/* Gaps of the corners of a facet a time later, at their speeds. */
static inline void moved_gaps(const KernelData *s, const Facet *e, double time, double gap[D])
{
    for (int i = 0; i < D; i++) gap[i] = e->gap[i] + time * velocity(s, e->node[i], NORMAL);
}
