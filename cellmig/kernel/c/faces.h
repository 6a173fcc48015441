/* Pieces of a triangle T over faces of another surface, and what bonds do there. */

static inline void add4(double *sum, v4 a) { store(sum, load(sum) + a); }

/* A load on three corners by their shares, along a direction. */
static inline void pull(double *const force[3], v4 shares, v4 along)
{
    for (int k = 0; k < 3; k++) add4(force[k], shares[k] * along);
}

/* A stiffness on three corners by their shares. */
static inline void stiffen(double *const force[3], v4 shares, double stiffness)
{
    for (int k = 0; k < 3; k++) force[k][3] += shares[k] * stiffness;
}

/* A piece over a face: its corners, as shares of those of T and of the face, the normal, and what it acts on. */
typedef struct { v4 on[3], below[3], normal; double *on_T[3], *on_face[3], *energy; } FacePiece;

/* Pieces of one law that wait for what acts on them. */
typedef struct {
    const double *law;
    int n;
    double area[MOST_PIECES], gap[3][MOST_PIECES];
    FacePiece piece[MOST_PIECES];
} FacePieces;

/* What acts on the pieces that wait. */
static void act_on_faces(FacePieces *found)
{
    const int n = found->n;
    int order[MOST_PIECES];
    double kind[MOST_PIECES], acts[3][MOST_PIECES], energy[MOST_PIECES], stiff[MOST_PIECES];
    const double (*gap)[MOST_PIECES] = found->gap;
    for (int m = 0; m < n; m += 4)
        store(kind + m, contact_face_kind(found->law, load(gap[0] + m), load(gap[1] + m), load(gap[2] + m)));
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        v4 loads[3], stored[1], may[1], stiffness[1] = {{0}};
        const v4 area = pick(found->area, of), a = pick(gap[0], of), b = pick(gap[1], of), c = pick(gap[2], of);
        contact_face(found->law, area, a, b, c, loads, stored, may);
        if (signs(-may[0])) contact_face_stiffness(found->law, area, a, b, c, stiffness);
        for (int k = 0; k < 3; k++) put(acts[k], of, loads[k]);
        put(energy, of, stored[0]);
        put(stiff, of, stiffness[0]);
    }
    for (int m = 0; m < n; m++) {
        const FacePiece *piece = found->piece + m;
        v4 on = {0}, below = {0};
        for (int c = 0; c < 3; c++) {
            on = fma4(splat(acts[c][m]), piece->on[c], on);
            below = fma4(splat(acts[c][m]), piece->below[c], below);
        }
        pull(piece->on_T, -on, piece->normal);
        pull(piece->on_face, below, piece->normal);
        *piece->energy += energy[m];
        if (stiff[m] == 0) continue;
        stiffen(piece->on_T, piece->on[0] + piece->on[1] + piece->on[2], stiff[m] / 3);
        stiffen(piece->on_face, piece->below[0] + piece->below[1] + piece->below[2], stiff[m] / 3);
    }
    found->n = 0;
}

/* What acts on a polygon over a face, from where that is now. */
static void act_over_face(const Triangle *T, const Face *f, double *const force[3], const v4 *on, long n,
                          FacePieces *found)
{
    const Four four = planes_on(T, &f->planes);
    v4 below[MOST_CORNERS];
    for (long k = 0; k < n; k++) below[k] = value_at(&four, on[k]);
    if (found->law != T->law || found->n + n > MOST_PIECES) act_on_faces(found);
    found->law = T->law;
    for (int k = 0; k + 2 < n; k++) {
        const int corner[3] = {0, k + 1, k + 2};
        FacePiece *piece = found->piece + found->n;
        double nearest = INFINITY;
        for (int c = 0; c < 3; c++) {
            piece->on[c] = on[corner[c]];
            piece->below[c] = below[corner[c]];
            nearest = d_minimum(nearest, found->gap[c][found->n] = below[corner[c]][3]);
            piece->on_T[c] = T->force[c];
            piece->on_face[c] = force[c];
        }
        if (nearest >= T->within) continue;
        piece->normal = f->normal;
        piece->energy = T->energy;
        found->area[found->n++] = T->area * fan(on, k);
    }
}

/* The least gap of a polygon over a face. */
static double least_gap_over(const Triangle *T, const Face *f, const Pieces *found)
{
    const Four four = planes_on(T, &f->planes);
    double least = INFINITY;
    for (long k = 0; k < found->used; k++) least = d_minimum(least, value_at(&four, found->on[k])[3]);
    return d_maximum(least, 0);
}
