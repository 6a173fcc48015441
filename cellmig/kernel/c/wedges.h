/* The parts of a triangle T in the wedges over edges of another surface, and what bonds do there. */

/* The part of T beside an edge: sign, places along it, vectors from it, weights of both normals at the corners. */
typedef struct { double sign, along[3], away[3][3], first[MOST_CORNERS], last[MOST_CORNERS]; Polygon p; } Wedge;

/* The point of a side of a wedge's polygon in a direction, its derivative by that, and the vector from the edge. */
static inline void crossing(const Wedge *w, int side, double at, double on[3], double moved[3], double away[3])
{
    const int i = side ? side - 1 : w->p.n - 1;
    const double here = (1 - at) * w->last[i] - at * w->first[i], sum1 = w->first[i] + w->last[i];
    const double there = (1 - at) * w->last[side] - at * w->first[side], sum2 = w->first[side] + w->last[side];
    const double inverse = 1 / (here - there), rate = (there * sum1 - here * sum2) * inverse * inverse;
    mixed3(w->p.at[i], w->p.at[side], here * inverse, on);
    less3(w->p.at[side], w->p.at[i], moved);
    for (int k = 0; k < 3; k++) moved[k] *= rate;
    vector_at(w->away, on, away);
}

/* Whether distances change little between two directions. */
static int is_short(const Wedge *w, const int side[2], double start, double end, double smooth)
{
    for (int k = 0; k < 2; k++) {
        double on[3], moved[3], one[3], other[3];
        crossing(w, side[k], start, on, moved, one);
        crossing(w, side[k], end, on, moved, other);
        const double r1 = sqrt(dot3(one, one)), r2 = sqrt(dot3(other, other)), least = fmin(r1, r2);
        if (fabs(r2 - r1) > CHANGE * fmax(least, smooth) || dot3(one, other) < COS_TURN * r1 * r2) return 0;
    }
    return 1;
}

/* What acts on the line across a wedge in a direction, which stands for a range of them.  Energy. */
static double on_line(const Triangle *T, const Wedge *w, const int side[2], double at, double range,
                      double *const force[2])
{
    double on[2][3], moved[2][3], away[2][3], r[2], width[2], loads[2], stored[1];
    for (int k = 0; k < 2; k++) {
        crossing(w, side[k], at, on[k], moved[k], away[k]);
        r[k] = sqrt(dot3(away[k], away[k]));
    }
    if (r[0] >= T->within && r[1] >= T->within) return 0;
    double across[3];
    less3(on[1], on[0], across);
    for (int k = 0; k < 2; k++) width[k] = 2 * range * w->sign * T->area * fabs(crossed(moved[k], across));
    contact_edge(T->law, width[0], width[1], r[0], r[1], loads, stored);
    const double stiffness = w->sign > 0 ? 0.5 * contact_edge_stiffness(T->law, width[0], width[1], r[0], r[1]) : 0;
    const int far = r[1] > r[0];
    for (int i = 0; i < 3; i++) away[far][i] /= r[far];
    for (int k = 0; k < 2; k++) {
        const double t = dot3(on[k], w->along), below[2] = {1 - t, t};
        pull(T, on[k], force, below, 2, loads[k], away[far]);
        stiffen(T, on[k], force, below, 2, stiffness);
    }
    return stored[0];
}

/* An edge: its start, unit vector and length; the least of this and of the heights of its faces; its sign, 0 if it is
 * level; gradients of the weights of its normals. */
typedef struct { double start[3], along[3], length, size, sign, gradient[2][3]; } Edge3;

/* The edge between two points, with the third corners of its faces on the left and on the right. */
static Edge3 edge_of(const double *const x[4])
{
    Edge3 e;
    double one[3], other[3], n1[3], n2[3], turn[3];
    less3(x[1], x[0], e.along);
    e.length = sqrt(dot3(e.along, e.along));
    less3(x[2], x[0], one);
    less3(x[3], x[0], other);
    for (int i = 0; i < 3; i++) {
        e.start[i] = x[0][i] + SKEW[i];
        e.along[i] /= e.length;
    }
    cross3(e.along, one, n1);
    cross3(other, e.along, n2);
    const double length1 = sqrt(dot3(n1, n1)), length2 = sqrt(dot3(n2, n2));
    e.size = fmin(e.length, fmin(length1, length2));
    cross3(n1, n2, turn);
    const double sine = dot3(turn, e.along) / (length1 * length2);
    e.sign = fabs(sine) < LEVEL ? 0 : sine > 0 ? 1 : -1;
    cross3(e.along, n2, e.gradient[0]);
    cross3(n1, e.along, e.gradient[1]);
    for (int i = 0; i < 3; i++) {
        e.gradient[0][i] *= -e.sign / length2;
        e.gradient[1][i] *= -e.sign / length1;
    }
    return e;
}

/* The part of T in the wedge over an edge, if there is any. */
static int find_wedge(const Triangle *T, const Edge3 *e, Wedge *w)
{
    double from[3], first[3], last[3], rest[3];
    int out[4] = {0};
    if (e->sign == 0) return 0;
    for (int k = 0; k < 3; k++) {
        less3(T->x[k], e->start, from);
        const double t = dot3(from, e->along);
        first[k] = dot3(from, e->gradient[0]);
        last[k] = dot3(from, e->gradient[1]);
        w->along[k] = t / e->length;
        rest[k] = 1 - w->along[k];
        for (int i = 0; i < 3; i++) w->away[k][i] = from[i] - t * e->along[i];
        out[0] += first[k] <= 0;
        out[1] += last[k] <= 0;
        out[2] += t <= 0;
        out[3] += rest[k] <= 0;
    }
    if (out[0] == 3 || out[1] == 3 || out[2] == 3 || out[3] == 3) return 0;
    const double *values[4] = {first, last, w->along, rest};
    w->sign = e->sign;
    whole(&w->p);
    for (int k = 0; k < 4 && w->p.n > 2; k++) clip(&w->p, values[k], 1);
    for (int k = 0; k < w->p.n; k++) {
        w->first[k] = dot3(w->p.at[k], first);
        w->last[k] = dot3(w->p.at[k], last);
    }
    return w->p.n > 2;
}

/* What acts on the part of T in the wedge over an edge.  Energy. */
static double beside_edge3(const Triangle *T, const Edge3 *e, double *const force[2])
{
    Wedge w;
    if (!find_wedge(T, e, &w)) return 0;
    double at[MOST_CORNERS], limit[MOST_CORNERS], energy = 0;
    for (int k = 0; k < w.p.n; k++) {
        const double a = fmax(w.first[k], 0), b = fmax(w.last[k], 0);
        at[k] = b / (a + b + 1e-300);
        int m = k;
        for (; m > 0 && limit[m - 1] > at[k]; m--) limit[m] = limit[m - 1];
        limit[m] = at[k];
    }
    for (int m = 0; m + 1 < w.p.n; m++) {
        if (limit[m + 1] - limit[m] < THIN) continue;
        const double middle = 0.5 * (limit[m] + limit[m + 1]);
        int side[MOST_CORNERS], n = 0;
        for (int k = 0; k < w.p.n; k++) side[n] = k, n += (at[k ? k - 1 : w.p.n - 1] < middle) != (at[k] < middle);
        if (n != 2) continue;
        const double least = ldexp(limit[m + 1] - limit[m], -HALVINGS);
        for (double start = limit[m], end; start < limit[m + 1]; start = end) {
            end = limit[m + 1];
            while (end - start > least && !is_short(&w, side, start, end, T->smooth)) end = 0.5 * (start + end);
            const double range = end - start;
            for (int k = 0; k < POINTS_OF_LINE; k++)
                energy += on_line(T, &w, side, start + LINE_AT[k] * range, LINE_WEIGHT[k] * range, force);
        }
    }
    return energy;
}
