/* Lines of a triangle T in the wedges over edges of another surface, and what bonds do there. */

enum { HALVINGS = 10, POINTS_OF_LINE = 3 };
static const double CHANGE = 0.3, COS_TURN = 0.955336489125606, LEVEL = 1e-9, THIN = 1e-12;
static const v4 LINE_AT = {0.11270166537925831, 0.5, 0.8872983346207417, 0.5};
static const v4 LINE_WEIGHT = {5.0 / 18, 8.0 / 18, 5.0 / 18, 0};

/* An edge: as planes the weights of the normals of its faces, the place along it and what is left of that; its unit
 * vector, that of the mean of the normals, its sign, 0 if it is level, and whether its faces turn little. */
typedef struct { Planes planes; v4 along, middle; double sign, narrow; } Edge3;

/* Sets the edge between two points, with the third corners of its faces on the left and on the right. */
static void set_edge(Edge3 *e, const double *const x[4])
{
    double along[3], one[3], other[3], n1[3], n2[3], turn[3], first[3], last[3];
    less3(x[1], x[0], along);
    const double length = sqrt(dot3(along, along));
    less3(x[2], x[0], one);
    less3(x[3], x[0], other);
    for (int i = 0; i < 3; i++) along[i] /= length;
    cross3(along, one, n1);
    cross3(other, along, n2);
    const double length1 = sqrt(dot3(n1, n1)), length2 = sqrt(dot3(n2, n2));
    for (int i = 0; i < 3; i++) {
        n1[i] /= length1;
        n2[i] /= length2;
    }
    cross3(n1, n2, turn);
    const double sine = dot3(turn, along), middle = sqrt(2 + 2 * dot3(n1, n2));
    e->sign = fabs(sine) < LEVEL ? 0 : sine > 0 ? 1 : -1;
    e->narrow = dot3(n1, n2) > COS_TURN;
    cross3(along, n2, first);
    cross3(n1, along, last);
    for (int i = 0; i < 3; i++) {
        e->planes.start[i] = x[0][i] + SKEW[i];
        e->planes.slope[i] = (v4){-e->sign * first[i], -e->sign * last[i], along[i] / length, -along[i] / length};
        e->middle[i] = (n1[i] + n2[i]) / middle;
        e->along[i] = along[i];
    }
    e->planes.at = (v4){e->sign == 0 ? -1 : 0, 0, 0, 1};
    e->planes.width = (v4){1, 1, length, length};
    e->planes.size = d_minimum(length, d_minimum(length1, length2));
    e->along[3] = e->middle[3] = 0;
}

/* The part of T beside an edge: its polygon, with the places along the edge in the fourth place of its shares, vectors
 * from the edge and weights of both normals at its corners, what acts on the edge. */
typedef struct {
    const Triangle *T;
    const Edge3 *e;
    double *const *force;
    Polygon p;
    v4 weight[MOST_CORNERS], away[MOST_CORNERS];
} Wedge;

/* A line across a wedge: its ends on T, the direction from the edge, and what it acts on. */
typedef struct { v4 on[2], away; double *on_T[3], *on_edge[2], *energy; } Line;

/* Lines of one law that wait for what acts on them. */
typedef struct {
    const double *law;
    int n;
    double width[2][MOST_PIECES], distance[2][MOST_PIECES];
    Line line[MOST_PIECES];
} Lines;

/* What acts on the lines that wait. */
static void act_on_lines(Lines *found)
{
    for (int n = found->n; n % 4; n++) /* with others that do not count */
        for (int k = 0; k < 2; k++) found->width[k][n] = 0, found->distance[k][n] = 1;
    for (int m = 0; m < found->n; m += 4) {
        v4 loads[2], stored[1], holds[1], stiff[1], stiffness[1] = {{0}}, width[2], r[2];
        for (int k = 0; k < 2; k++) width[k] = load(found->width[k] + m), r[k] = load(found->distance[k] + m);
        contact_edge_apart(found->law, width[0], width[1], r[0], r[1], loads, stored, holds, stiff);
        if (signs(-stiff[0])) contact_edge_stiffness(found->law, width[0], width[1], r[0], r[1], stiffness);
        for (int i = 0; i < 4 && m + i < found->n; i++) {
            const Line *line = found->line + m + i;
            double load[2] = {loads[0][i], loads[1][i]}, energy[1] = {stored[0][i]};
            if (holds[0][i] == 0)
                contact_edge(found->law, width[0][i], width[1][i], r[0][i], r[1][i], load, energy);
            const v4 on = load[0] * line->on[0] + load[1] * line->on[1];
            pull(line->on_T, -on, line->away);
            add4(line->on_edge[0], (load[0] + load[1] - on[3]) * line->away);
            add4(line->on_edge[1], on[3] * line->away);
            *line->energy += energy[0];
            if (!(stiffness[0][i] > 0)) continue; /* of reflex edges it is negative */
            const v4 both = line->on[0] + line->on[1];
            stiffen(line->on_T, both, 0.5 * stiffness[0][i]);
            line->on_edge[0][3] += (2 - both[3]) * 0.5 * stiffness[0][i];
            line->on_edge[1][3] += both[3] * 0.5 * stiffness[0][i];
        }
    }
    found->n = 0;
}

/* Of four directions from the edge: shares of the way along a side of the polygon where they go, derivatives of these,
 * vectors from the edge and their lengths. */
typedef struct { v4 share, rate, away[3], r; } Crossing;

/* Those of the side of the polygon that ends at corner k. */
static inline void cross_side(const Wedge *w, int k, v4 at, Crossing *c)
{
    const int i = k ? k - 1 : w->p.n - 1;
    const v4 one = w->weight[i], other = w->weight[k];
    const double sum1 = one[0] + one[1], sum2 = other[0] + other[1];
    const v4 here = one[1] - at * sum1, there = other[1] - at * sum2, inverse = 1 / (here - there);
    c->share = here * inverse;
    c->rate = (there * sum1 - here * sum2) * inverse * inverse;
    v4 square = {0};
    for (int x = 0; x < 3; x++) {
        const double start = ((const double *)(w->away + i))[x], end = ((const double *)(w->away + k))[x];
        c->away[x] = fma4(c->share, splat(end - start), splat(start));
        square = fma4(c->away[x], c->away[x], square);
    }
    c->r = v4_sqrt(square);
}

/* Whether distances and directions change little from the first line of a strip to the last. */
static inline int is_short(const Wedge *w, const Crossing c[2])
{
    for (int k = 0; k < 2; k++) {
        const double r1 = c[k].r[0], r2 = c[k].r[2];
        if (fabs(r2 - r1) > CHANGE * d_maximum(d_minimum(r1, r2), w->T->smooth)) return 0;
        if (w->e->narrow) continue;
        double cosine = 0;
        for (int x = 0; x < 3; x++) cosine += c[k].away[x][0] * c[k].away[x][2];
        if (cosine < COS_TURN * r1 * r2) return 0;
    }
    return 1;
}

/* The lines of a strip, between two sides of the polygon. */
static void add_lines(const Wedge *w, const int side[2], const Crossing c[2], double range, Lines *found)
{
    const Triangle *T = w->T;
    const Polygon *p = &w->p;
    v4 start[2], way[2], on[2][2], width[2];
    for (int k = 0; k < 2; k++) {
        const int i = side[k] ? side[k] - 1 : p->n - 1;
        start[k] = p->on[i];
        way[k] = p->on[side[k]] - p->on[i];
        for (int x = 0; x < 2; x++) on[k][x] = fma4(c[k].share, splat(way[k][x + 1]), splat(start[k][x + 1]));
    }
    const v4 across[2] = {on[1][0] - on[0][0], on[1][1] - on[0][1]};
    for (int k = 0; k < 2; k++) {
        const v4 area = c[k].rate * (way[k][1] * across[1] - way[k][2] * across[0]);
        width[k] = 2 * range * T->area * LINE_WEIGHT * larger(area, -area);
        width[k] = w->e->sign * width[k];
    }
    if (found->law != T->law || found->n + POINTS_OF_LINE > MOST_PIECES) act_on_lines(found);
    found->law = T->law;
    for (int j = 0; j < POINTS_OF_LINE; j++) {
        if (c[0].r[j] >= T->within && c[1].r[j] >= T->within) continue;
        Line *line = found->line + found->n;
        for (int k = 0; k < 2; k++) {
            line->on[k] = fma4(splat(c[k].share[j]), way[k], start[k]);
            found->width[k][found->n] = width[k][j];
            found->distance[k][found->n] = c[k].r[j];
            line->on_edge[k] = w->force[k];
        }
        const Crossing *far = c + (c[1].r[j] > c[0].r[j]);
        line->away = (v4){far->away[0][j], far->away[1][j], far->away[2][j], 0} / far->r[j];
        for (int k = 0; k < 3; k++) line->on_T[k] = T->force[k];
        line->energy = T->energy;
        found->n++;
    }
}

/* Finds the lines between two directions, in strips that are short. */
static void find_strips(const Wedge *w, const int side[2], double low, double high, Lines *found)
{
    const double least = ldexp(high - low, -HALVINGS);
    for (double start = low, end; start < high; start = end) {
        Crossing c[2];
        for (end = high;; end = 0.5 * (start + end)) {
            for (int k = 0; k < 2; k++) cross_side(w, side[k], start + (end - start) * LINE_AT, c + k);
            if (!(end - start > least) || is_short(w, c)) break;
        }
        add_lines(w, side, c, end - start, found);
    }
}

/* How far corners may move until T may be in the wedge over the edge, or if that turns over in the opposite one, and
 * within reach. */
static double rest_beside(const Triangle *T, const Edge3 *e, v4 least, v4 most, double nearest)
{
    const double outside = e->sign == 0 ? 0 : d_minimum(d_maximum(-most[0], -most[1]), d_maximum(least[0], least[1]));
    const double beyond = d_maximum(-most[2], -most[3]) * e->planes.width[2];
    return rest_of(T, &e->planes, d_maximum(nearest - T->within, d_maximum(outside, beyond)));
}

/* Finds the part of T in the wedge over an edge.  How far corners may move until there is any. */
static double beside_edge3(const Triangle *T, const Edge3 *e, double *const force[2], Lines *found)
{
    Wedge w;
    w.T = T, w.e = e, w.force = force;
    v4 away[3];
    double nearest = INFINITY;
    const Four four = planes_on(T, &e->planes);
    const v4 most = most_on(&four), least = least_on(&four);
    for (int k = 0; k < 3; k++) {
        const double *x = T->x[k], *start = e->planes.start;
        const v4 from = {x[0] - start[0], x[1] - start[1], x[2] - start[2], 0};
        away[k] = from - dot4(from, e->along) * e->along;
        nearest = d_minimum(nearest, dot4(from, e->middle));
    }
    if (signs(most) || nearest >= T->within) return rest_beside(T, e, least, most, nearest);
    whole(&w.p, (double[3]){four.at[2], four.at[2] + four.by[0][2], four.at[2] + four.by[1][2]});
    cut_by(&w.p, &four, signs(least), w.weight);
    if (!w.p.n) return 0;
    double at[MOST_CORNERS], limit[MOST_CORNERS];
    nearest = INFINITY;
    for (int k = 0; k < w.p.n; k++) {
        const double a = d_maximum(w.weight[k][0], 0), b = d_maximum(w.weight[k][1], 0);
        const v4 on = w.p.on[k];
        w.away[k] = fma4(splat(on[2]), away[2], fma4(splat(on[1]), away[1], on[0] * away[0]));
        nearest = d_minimum(nearest, dot4(w.away[k], e->middle));
        at[k] = b / (a + b + 1e-300);
        int m = k;
        for (; m > 0 && limit[m - 1] > at[k]; m--) limit[m] = limit[m - 1];
        limit[m] = at[k];
    }
    for (int m = 0; m + 1 < w.p.n && nearest < T->within; m++) {
        if (limit[m + 1] - limit[m] < THIN) continue;
        const double middle = 0.5 * (limit[m] + limit[m + 1]);
        int side[MOST_CORNERS], n = 0;
        for (int k = 0; k < w.p.n; k++) side[n] = k, n += (at[k ? k - 1 : w.p.n - 1] < middle) != (at[k] < middle);
        if (n == 2) find_strips(&w, side, limit[m], limit[m + 1], found);
    }
    return 0;
}
