/* Points of a triangle T in the cones over vertices of another surface, and what bonds do there. */

/* A point of T that counts for a vertex: the vector from this, and what it acts on. */
typedef struct { v4 on, away; double *on_T[3], *on_vertex, *energy; } Point;

/* Points of one law that wait for what acts on them: their reference areas, and squares of their distances. */
typedef struct {
    const double *law;
    int n;
    double area[MOST_PIECES], square[MOST_PIECES];
    Point point[MOST_PIECES];
} Points;

/* What acts on the points that wait. */
static void act_on_points(Points *found)
{
    for (int n = found->n; n % 4; n++) found->area[n] = 0, found->square[n] = 1; /* others that do not count */
    for (int m = 0; m < found->n; m += 4) {
        v4 loads[1], stored[1], stiff[1], stiffness[1] = {{0}};
        const v4 area = load(found->area + m), r = v4_sqrt(load(found->square + m));
        contact_vertex(found->law, area, r, loads, stored, stiff);
        if (signs(-stiff[0])) contact_vertex_stiffness(found->law, area, r, stiffness);
        loads[0] /= r;
        for (int i = 0; i < 4 && m + i < found->n; i++) {
            const Point *point = found->point + m + i;
            const v4 along = loads[0][i] * point->away;
            pull(point->on_T, -point->on, along);
            add4(point->on_vertex, along);
            *point->energy += stored[0][i];
            if (!(stiffness[0][i] > 0)) continue; /* of points that count negatively it is negative */
            stiffen(point->on_T, point->on, stiffness[0][i]);
            point->on_vertex[3] += stiffness[0][i];
        }
    }
    found->n = 0;
}

/* What acts on n points beside the vertex at x, from where they are now. */
static void act_beside_vertex(const Triangle *T, const double *x, double *force, const v4 *on, long n, Points *found)
{
    v4 from[3];
    corners_from(T, x, from);
    if (found->law != T->law) act_on_points(found);
    found->law = T->law;
    for (long m = 0; m < n; m++) {
        if (found->n == MOST_PIECES) act_on_points(found);
        Point *point = found->point + found->n;
        point->on = on[m];
        point->away = mixed(from, on[m]);
        for (int k = 0; k < 3; k++) point->on_T[k] = T->force[k];
        point->on_vertex = force;
        point->energy = T->energy;
        found->area[found->n] = on[m][3];
        found->square[found->n++] = dot4(point->away, point->away);
    }
}

/* The least distance of points from the vertex. */
static double least_from_vertex(const Triangle *T, const double *x, const Pieces *found)
{
    v4 from[3];
    double least = INFINITY;
    corners_from(T, x, from);
    for (long m = 0; m < found->used; m++) {
        const v4 away = mixed(from, found->on[m]);
        least = d_minimum(least, dot4(away, away));
    }
    return sqrt(least);
}
