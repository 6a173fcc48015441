/* Laws of bonds between points of a triangle T in the cones and the vertices of another surface. */

/* A point of T that counts for a vertex, and what sums what acts there. */
typedef struct { v4 on; int32_t action; } Point;

/* Points of one law that wait for it, as pieces over faces do: their reference areas, and squares of distances. */
typedef struct {
    const double *law;
    int n, change;
    Pieces *of;
    double area[MOST_PIECES], square[MOST_PIECES];
    Point point[MOST_PIECES];
} Points;

/* Adds what acts on the points that wait. */
static void add_beside_vertices(Points *found)
{
    for (int n = found->n; n % 4; n++) found->area[n] = 0, found->square[n] = 1; /* others that do not count */
    for (int m = 0; m < found->n; m += 4) {
        v4 loads[1], stored[1], may[1], stiffness[1] = {{0}}, tangent[1] = {{0}};
        const v4 area = load(found->area + m), square = load(found->square + m), r = v4_sqrt(square);
        contact_vertex(found->law, area, r, loads, stored, may);
        if (signs(-may[0])) contact_vertex_stiffness(found->law, area, r, stiffness);
        if (found->change) contact_vertex_tangent(found->law, area, r, tangent);
        loads[0] /= r;
        const v4 bend = 0.5 * (tangent[0] - loads[0]) / square;
        for (int i = 0; i < 4 && m + i < found->n; i++) {
            const Point *point = found->point + m + i;
            Beside *action = beside_of(found->of, point->action);
            v4 of[2];
            shared(point->on, of);
            add_beside(action, point->on, of, loads[0][i], stored[0][i], square[i], stiffness[0][i]);
            if (!found->change) continue;
            const v4 to[2] = {bend[i] * of[0], bend[i] * of[1]};
            bend_beside(action, of, to);
        }
    }
    found->n = 0;
}

/* Has n points beside the vertex at x wait for what acts there, from where they are now. */
static void wait_beside_vertex(const Triangle *T, const double *x, const v4 *on, long n, int32_t action, Points *found)
{
    v4 product[2], of[2];
    const Corners c = corners_beside(T, x);
    products(&c, product);
    begin_beside(beside_of(found->of, action), product);
    if (found->law != T->law) add_beside_vertices(found);
    found->law = T->law;
    for (long m = 0; m < n; m++) {
        if (found->n == MOST_PIECES) add_beside_vertices(found);
        Point *point = found->point + found->n;
        shared(point->on = on[m], of);
        found->area[found->n] = on[m][3];
        found->square[found->n++] = d_maximum(square_at(of, product), TOUCHING * TOUCHING);
        point->action = action;
    }
}

/* The least distance of points from the vertex. */
static double least_from_vertex(const Triangle *T, const double *x, const Pieces *found)
{
    v4 product[2], of[2];
    const Corners c = corners_beside(T, x);
    double least = INFINITY;
    products(&c, product);
    for (long m = 0; m < found->used; m++) {
        shared(found->on[m], of);
        least = d_minimum(least, square_at(of, product));
    }
    return sqrt(d_maximum(least, 0));
}
