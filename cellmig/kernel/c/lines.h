/* Lines of a triangle T across wedges over edges of another surface, and what bonds do there. */

static const double TOUCHING = 1e-12; /* [µm] a distance that has no direction */

/* A line across a wedge: its ends on T, vectors to them from the edge, places along this, and what it acts on. */
typedef struct { v4 on[2], away[2]; double along[2], *on_T[3], *on_edge[2], *energy; } Line;

/* Lines of one law that wait for what acts on them: widths and squares of the distances at their ends. */
typedef struct {
    const double *law;
    int n;
    double width[2][MOST_PIECES], square[2][MOST_PIECES];
    Line line[MOST_PIECES];
} Lines;

/* What acts on the lines that wait. */
static void act_on_lines(Lines *found)
{
    const int n = found->n;
    int order[MOST_PIECES];
    double kind[MOST_PIECES], distance[2][MOST_PIECES], acts[2][MOST_PIECES], energy[MOST_PIECES], stiff[MOST_PIECES];
    for (int m = n; m % 4; m++) found->square[0][m] = found->square[1][m] = 1; /* others that do not count */
    for (int m = 0; m < n; m += 4) {
        for (int k = 0; k < 2; k++) store(distance[k] + m, v4_sqrt(load(found->square[k] + m)));
        store(kind + m, contact_edge_kind(found->law, load(distance[0] + m), load(distance[1] + m)));
    }
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        v4 loads[2], stored[1], may[1], stiffness[1] = {{0}}, width[2], r[2];
        for (int k = 0; k < 2; k++) width[k] = pick(found->width[k], of), r[k] = pick(distance[k], of);
        contact_edge(found->law, width[0], width[1], r[0], r[1], loads, stored, may);
        if (signs(-may[0])) contact_edge_stiffness(found->law, width[0], width[1], r[0], r[1], stiffness);
        for (int k = 0; k < 2; k++) put(acts[k], of, loads[k] / larger(r[k], splat(TOUCHING)));
        put(energy, of, stored[0]);
        put(stiff, of, stiffness[0]);
    }
    for (int m = 0; m < n; m++) {
        const Line *line = found->line + m;
        const v4 first = acts[0][m] * line->away[0], last = acts[1][m] * line->away[1];
        for (int c = 0; c < 3; c++) add4(line->on_T[c], -(line->on[0][c] * first + line->on[1][c] * last));
        add4(line->on_edge[0], (1 - line->along[0]) * first + (1 - line->along[1]) * last);
        add4(line->on_edge[1], line->along[0] * first + line->along[1] * last);
        *line->energy += energy[m];
        if (!(stiff[m] > 0)) continue; /* of reflex edges it is negative */
        const double half = 0.5 * stiff[m], along = line->along[0] + line->along[1];
        stiffen(line->on_T, line->on[0] + line->on[1], half);
        line->on_edge[0][3] += (2 - along) * half;
        line->on_edge[1][3] += along * half;
    }
    found->n = 0;
}

/* The vector along an edge between two points. */
static inline v4 along_edge(const double *const x[2])
{
    return (v4){x[1][0] - x[0][0], x[1][1] - x[0][1], x[1][2] - x[0][2], 0};
}

/* What acts on n ends of lines beside an edge between two points, from where they are now. */
static void act_beside_edge(const Triangle *T, const double *const x[2], double *const force[2], const v4 *on, long n,
                            Lines *found)
{
    v4 from[3];
    const v4 edge = along_edge(x);
    const double square = dot4(edge, edge);
    corners_from(T, x[0], from);
    if (found->law != T->law) act_on_lines(found);
    found->law = T->law;
    for (long m = 0; m < n; m += 2) {
        if (found->n == MOST_PIECES) act_on_lines(found);
        Line *line = found->line + found->n;
        for (int k = 0; k < 2; k++) {
            line->on[k] = on[m + k];
            const v4 place = mixed(from, on[m + k]);
            line->along[k] = dot4(place, edge) / square;
            line->away[k] = place - line->along[k] * edge;
            found->square[k][found->n] = dot4(line->away[k], line->away[k]);
            found->width[k][found->n] = on[m + k][3];
            line->on_edge[k] = force[k];
        }
        line->energy = T->energy;
        memcpy(line->on_T, T->force, sizeof line->on_T);
        found->n++;
    }
}

/* The least distance of lines from the edge. */
static double least_from_edge(const Triangle *T, const double *const x[2], const Pieces *found)
{
    v4 from[3];
    const v4 edge = along_edge(x);
    double least = INFINITY;
    corners_from(T, x[0], from);
    for (long m = 0; m < found->used; m++) {
        const v4 place = mixed(from, found->on[m]), away = place - dot4(place, edge) / dot4(edge, edge) * edge;
        least = d_minimum(least, dot4(away, away));
    }
    return sqrt(least);
}
