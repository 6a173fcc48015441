/* Segments of surfaces, on which the surface terms act. */

/* A segment: its number, both ends, its length at rest, the gaps of its ends to the substrate. */
typedef struct { long number, node[2]; double length, gap[2]; } Segment;

static inline Segment segment_at(const KernelData *s, long e)
{
    const long i = s->segment[2 * e], j = s->segment[2 * e + 1];
    return (Segment){e, {i, j}, s->length[e], {coordinate(s, i, NORMAL), coordinate(s, j, NORMAL)}};
}

static inline void add_to_ends(double *force, const long node[2], const double f[2][D])
{
    for (int i = 0; i < 2; i++)
        for (int c = 0; c < D; c++) force[D * node[i] + c] += f[i][c];
}

/* What the substrate gives to either end of a segment, each in a place of bond_impulse of its own. */
enum { BY_BONDS, BY_DRAG, BY_PUSH };

static inline double *impulse_at(const KernelData *s, const Segment *e, int end, int kind)
{
    return s->bond_impulse + 6 * e->number + 3 * end + kind;
}
