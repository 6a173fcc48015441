/* A triangle T over a face of another surface as a whole: forces along the face that are in balance. */

/* The part of a triangle over a face: its reference area, at its centre the shares of the corners of both, and the gap
 * between them in the fourth place of those of the face. */
typedef struct { double area; v4 on, at; } Overlap;

/* The part with these pieces. */
static inline Overlap overlap_of(const Triangle *T, const Face *f, const v4 *on, long n)
{
    const Four four = planes_on(T, &f->planes);
    Overlap o = {0};
    for (int k = 0; k + 2 < n; k++) {
        const double area = fan(on, k);
        o.on += area / 3 * (on[0] + on[k + 1] + on[k + 2]);
        o.area += area;
    }
    o.on /= o.area;
    o.at = value_at(&four, o.on);
    for (int i = 0; i < 3; i++) o.at += SKEW[i] * f->planes.slope[i]; /* else bodies that move as one would slide */
    o.area *= T->area;
    return o;
}

/* Adds a force on T along a face at their overlap, and the opposite on the face, with a couple. */
static inline void drag_along(const Triangle *T, const Face *f, const Overlap *o, v4 drag, double *const force[3])
{
    for (int k = 0; k < 3; k++) {
        double couple = 0;
        for (int i = 0; i < 3; i++) couple += o->at[3] * f->planes.slope[i][k] * drag[i];
        add4(T->force[k], o->on[k] * drag);
        add4(force[k], couple * f->normal - o->at[k] * drag);
    }
}
