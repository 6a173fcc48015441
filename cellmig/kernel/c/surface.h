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
