/* Laws of bonds between lines of a triangle T across wedges and the edges of another surface. */

static const double TOUCHING = 1e-9; /* [µm] a distance that has no direction */

/* A line across a wedge: its ends on T, and what sums what acts there. */
typedef struct { v4 on[2]; int32_t action; } Line;

/* Lines of one law that wait for it, as pieces over faces do: widths and squares of the distances at their ends. */
typedef struct {
    const double *law;
    int n, change;
    Pieces *of;
    double width[2][MOST_PIECES], square[2][MOST_PIECES];
    Line line[MOST_PIECES];
} Lines;

/* Adds what acts on the lines that wait. */
static void add_beside_edges(Lines *found)
{
    const int n = found->n;
    int order[MOST_PIECES];
    double kind[MOST_PIECES], distance[2][MOST_PIECES], acts[2][MOST_PIECES], energy[MOST_PIECES], stiff[MOST_PIECES];
    double bend[3][MOST_PIECES];
    for (int m = n; m % 4; m++) found->square[0][m] = found->square[1][m] = 1; /* others that do not count */
    for (int m = 0; m < n; m += 4) {
        for (int k = 0; k < 2; k++) store(distance[k] + m, v4_sqrt(load(found->square[k] + m)));
        store(kind + m, contact_edge_kind(found->law, load(distance[0] + m), load(distance[1] + m)));
    }
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        v4 loads[2], stored[1], may[1], stiffness[1] = {{0}}, width[2], r[2], tangent[3] = {{0}};
        for (int k = 0; k < 2; k++) width[k] = pick(found->width[k], of), r[k] = pick(distance[k], of);
        contact_edge(found->law, width[0], width[1], r[0], r[1], loads, stored, may);
        if (signs(-may[0])) contact_edge_stiffness(found->law, width[0], width[1], r[0], r[1], stiffness);
        if (found->change) contact_edge_tangent(found->law, width[0], width[1], r[0], r[1], tangent);
        for (int k = 0; k < 2; k++) put(acts[k], of, loads[k] / r[k]);
        put(bend[0], of, 0.5 * (tangent[0] - loads[0] / r[0]) / (r[0] * r[0]));
        put(bend[1], of, 0.5 * tangent[1] / (r[0] * r[1]));
        put(bend[2], of, 0.5 * (tangent[2] - loads[1] / r[1]) / (r[1] * r[1]));
        put(energy, of, stored[0]);
        put(stiff, of, stiffness[0]);
    }
    for (int m = 0; m < n; m++) {
        const Line *line = found->line + m;
        Beside *r = beside_of(found->of, line->action);
        v4 of[2][2], to[2][2];
        for (int k = 0; k < 2; k++) {
            shared(line->on[k], of[k]);
            add_beside(r, line->on[k], of[k], acts[k][m], k ? 0 : energy[m], found->square[k][m], 0.5 * stiff[m]);
        }
        if (!found->change) continue;
        for (int k = 0; k < 2; k++)
            for (int h = 0; h < 2; h++) to[k][h] = bend[k][m] * of[0][h] + bend[k + 1][m] * of[1][h];
        for (int k = 0; k < 2; k++) bend_beside(r, of[k], to[k]);
    }
    found->n = 0;
}

/* Has n ends of lines beside an edge between two points wait for what acts there, from where they are now. */
static void wait_beside_edge(const Triangle *T, const double *const x[2], const v4 *on, long n, int32_t action,
                             Lines *found)
{
    v4 along, product[2], of[2];
    const Corners c = across_edge(T, x, &along);
    products(&c, product);
    begin_beside(beside_of(found->of, action), product);
    if (found->law != T->law) add_beside_edges(found);
    found->law = T->law;
    for (long m = 0; m < n; m += 2) {
        if (found->n == MOST_PIECES) add_beside_edges(found);
        Line *line = found->line + found->n;
        for (int k = 0; k < 2; k++) {
            shared(line->on[k] = on[m + k], of);
            found->square[k][found->n] = d_maximum(square_at(of, product), TOUCHING * TOUCHING);
            found->width[k][found->n] = on[m + k][3];
        }
        line->action = action;
        found->n++;
    }
}

/* The least distance of lines from the edge. */
static double least_from_edge(const Triangle *T, const double *const x[2], const Pieces *found)
{
    v4 along, product[2], of[2];
    const Corners c = across_edge(T, x, &along);
    double least = INFINITY;
    products(&c, product);
    for (long m = 0; m < found->used; m++) {
        shared(found->on[m], of);
        least = d_minimum(least, square_at(of, product));
    }
    return sqrt(d_maximum(least, 0));
}
