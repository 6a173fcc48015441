/* Laws of bonds between pieces of a triangle T and faces of another surface. */

/* A piece over a face: shares of the corners of T at its own, and what sums what acts there. */
typedef struct { v4 on[3]; int32_t action; } FacePiece;

/* Pieces of one law that wait for it; whether changes with the gaps are asked for, and for which pieces. */
typedef struct {
    const double *law;
    int n, change;
    Pieces *of;
    double area[MOST_PIECES], gap[3][MOST_PIECES];
    FacePiece piece[MOST_PIECES];
} FacePieces;

/* Adds what acts on the pieces that wait. */
static void add_over_faces(FacePieces *found)
{
    const int n = found->n;
    int order[MOST_PIECES];
    double kind[MOST_PIECES], acts[3][MOST_PIECES], energy[MOST_PIECES], stiff[MOST_PIECES], bend[6][MOST_PIECES];
    const double (*gap)[MOST_PIECES] = found->gap;
    for (int m = 0; m < n; m += 4)
        store(kind + m, contact_face_kind(found->law, load(gap[0] + m), load(gap[1] + m), load(gap[2] + m)));
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        v4 loads[3], stored[1], may[1], stiffness[1] = {{0}}, tangent[6] = {{0}};
        const v4 area = pick(found->area, of), a = pick(gap[0], of), b = pick(gap[1], of), c = pick(gap[2], of);
        contact_face(found->law, area, a, b, c, loads, stored, may);
        if (signs(-may[0])) contact_face_stiffness(found->law, area, a, b, c, stiffness);
        if (found->change) contact_face_tangent(found->law, area, a, b, c, tangent);
        for (int k = 0; k < 3; k++) put(acts[k], of, loads[k]);
        for (int k = 0; k < 6; k++) put(bend[k], of, tangent[k]);
        put(energy, of, stored[0]);
        put(stiff, of, stiffness[0]);
    }
    for (int m = 0; m < n; m++) {
        const v4 *on = found->piece[m].on;
        OverFace *r = over_face_of(found->of, found->piece[m].action);
        for (int c = 0; c < 3; c++) {
            const int next = (c + 1) % 3, last = (c + 2) % 3; /* changes 11, 22, 33, 23, 31, 12 */
            const v4 by = bend[c][m] * on[c] + bend[3 + last][m] * on[next] + bend[3 + next][m] * on[last];
            for (int k = 0; k < 3; k++) r->tangent[k] = fma4(splat(on[c][k]), by, r->tangent[k]);
            r->load = fma4(splat(acts[c][m]), on[c], r->load);
            r->stiff = fma4(splat(stiff[m] / 3), on[c], r->stiff);
            r->gap[3] = d_minimum(r->gap[3], NEARLY * fabs(gap[c][m]));
        }
        r->load[3] += energy[m];
    }
    found->n = 0;
}

/* Has a polygon over a face wait for what acts there, from where that is now. */
static void wait_over_face(const Triangle *T, const Face *f, const v4 *on, long n, int32_t action, FacePieces *found)
{
    const Four four = planes_on(T, &f->planes);
    v4 below[MOST_CORNERS];
    for (long k = 0; k < n; k++) below[k] = value_at(&four, on[k]);
    begin_over_face(over_face_of(found->of, action), &four);
    if (found->law != T->law || found->n + n > MOST_PIECES) add_over_faces(found);
    found->law = T->law;
    for (int k = 0; k + 2 < n; k++) {
        const int corner[3] = {0, k + 1, k + 2};
        FacePiece *piece = found->piece + found->n;
        double nearest = INFINITY;
        for (int c = 0; c < 3; c++) {
            piece->on[c] = on[corner[c]];
            nearest = d_minimum(nearest, found->gap[c][found->n] = below[corner[c]][3]);
        }
        if (nearest >= T->within) continue;
        piece->action = action;
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
