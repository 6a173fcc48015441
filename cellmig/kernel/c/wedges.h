/* The part of a triangle T in the wedge over an edge of another surface, as lines. */

enum { HALVINGS = 16, LINES = 4, MOST_LIMITS = 11 };
static const double CHANGE[2] = {1.2, 3.0}, LITTLE = 3e-3, COS_TURN = 0.9004471023526769, LEVEL = 1e-9, THIN = 1e-12;
static const double EVEN = 0.27; /* most that widths of four lines bend, beside their sum */
static const v4 LINE_AT = {0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263};
static const v4 LINE_WEIGHT = {0.17392742256872692, 0.3260725774312731, 0.3260725774312731, 0.17392742256872692};

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
        e->planes.middle[i] = 0.5 * (x[0][i] + x[1][i]);
        e->planes.slope[i] = (v4){-e->sign * first[i], -e->sign * last[i], along[i] / length, -along[i] / length};
        e->middle[i] = (n1[i] + n2[i]) / middle;
        e->along[i] = along[i];
    }
    e->planes.at = (v4){e->sign == 0 ? -1 : 0, 0, 0, 1};
    e->planes.width = (v4){1, 1, length, length};
    e->planes.size = d_minimum(length, d_minimum(length1, length2));
    e->along[3] = e->middle[3] = 0;
}

/* T beside an edge; at the corners of T the weight of the second normal and the sum of both, places
 * along the edge, and vectors from it. */
typedef struct {
    const Triangle *T;
    const Edge3 *e;
    double last[3], sum[3], along[3];
    v4 away[3];
} Wedge;

/* Lines in four directions from the edge, between two sides of T from one corner to the next ones: shares of these at
 * both ends, vectors from the edge and their lengths, widths as shares of T; `length` is negative where none is. */
typedef struct { int next[2]; v4 share[2][2], away[2][3], r[2], width[2], length; } Across;

/* Limits the part of a line to where something linear is not negative: a at its start, b at its end, `zero` between. */
static inline void limit(v4 a, v4 b, v4 zero, v4 *start, v4 *end)
{
    *start = larger(*start, v4_where(a < 0, zero, splat(0)));
    *end = smaller(*end, v4_where(b < 0, v4_where(a < 0, splat(-1), zero), splat(1)));
}

/* The lines between the sides of T that meet at corner i, with what is beyond their directions on their left. */
static void cross_at(const Wedge *w, int i, int left, v4 at, Across *c)
{
    const int next[2] = {(i + 1 + left) % 3, (i + 2 - left) % 3};
    const v4 here = w->last[i] - at * w->sum[i];
    v4 there[2], share[2], rate[2], along[2], sum[2], part[2] = {splat(0), splat(1)};
    for (int k = 0; k < 2; k++) {
        c->next[k] = next[k];
        there[k] = w->last[next[k]] - at * w->sum[next[k]];
    }
    const v4 inverses = 1 / ((here - there[0]) * (here - there[1]));
    for (int k = 0; k < 2; k++) {
        const int j = next[k];
        const v4 inverse = inverses * (here - there[1 - k]);
        share[k] = here * inverse;
        rate[k] = (w->sum[i] * there[k] - w->sum[j] * here) * inverse * inverse;
        along[k] = fma4(share[k], splat(w->along[j] - w->along[i]), splat(w->along[i]));
        sum[k] = fma4(share[k], splat(w->sum[j] - w->sum[i]), splat(w->sum[i]));
    }
    const v4 over = 1 / (along[0] - along[1]);
    limit(along[0], along[1], along[0] * over, part, part + 1);
    limit(1 - along[0], 1 - along[1], (along[0] - 1) * over, part, part + 1);
    if (signs(smaller(sum[0], sum[1]))) limit(sum[0], sum[1], sum[0] / (sum[0] - sum[1]), part, part + 1);
    c->length = part[1] - part[0];
    const v4 swept = rate[0] * share[1], change = rate[1] * share[0] - swept;
    for (int k = 0; k < 2; k++) {
        const v4 width = c->length * fma4(part[k], change, swept);
        c->width[k] = larger(width, -width);
        c->share[k][0] = (1 - part[k]) * share[0];
        c->share[k][1] = part[k] * share[1];
        v4 square = {0};
        for (int x = 0; x < 3; x++) {
            const double start = w->away[i][x], by[2] = {w->away[next[0]][x] - start, w->away[next[1]][x] - start};
            c->away[k][x] = fma4(c->share[k][1], splat(by[1]), fma4(c->share[k][0], splat(by[0]), splat(start)));
            square = fma4(c->away[k][x], c->away[k][x], square);
        }
        c->r[k] = v4_sqrt(square);
    }
}

/* The lines of a strip: corners of T at which their sides meet, -1 where there is no line, lines by corner. */
typedef struct { int corner[LINES]; Across c[3]; } Strip;

/* Finds the lines of a strip; whether there are any. */
static int set_strip(const Wedge *w, v4 at, Strip *strip)
{
    static const int single[8] = {-1, 0, 1, 2, 2, 1, 0, -1}; /* the corner on a side of its own */
    int beyond[LINES] = {0}, any = 0, done = 0;
    for (int k = 0; k < 3; k++) {
        const int before = signs(w->last[k] - at * w->sum[k]);
        for (int j = 0; j < LINES; j++) beyond[j] |= (before >> j & 1) << k;
    }
    for (int j = 0; j < LINES; j++) {
        const int i = strip->corner[j] = single[beyond[j]];
        if (i < 0) continue;
        if (!(done >> i & 1)) cross_at(w, i, beyond[j] == 1 << i, at, strip->c + i);
        done |= 1 << i;
        if (strip->c[i].length[j] > 0) any = 1; else strip->corner[j] = -1;
    }
    return any;
}

/* The share of T in a strip over a range of directions. */
static inline double share_in(const Strip *strip, double range)
{
    double width = 0;
    for (int j = 0; j < LINES; j++) {
        const int i = strip->corner[j];
        if (i >= 0) width += LINE_WEIGHT[j] * (strip->c[i].width[0][j] + strip->c[i].width[1][j]);
    }
    return range * width;
}

/* Whether widths of the lines of a strip are nearly linear: else most of it may be between the last line and the end,
 * as of a triangle with one side along a sharp edge. */
static inline int is_even(const Strip *strip)
{
    double width[LINES] = {0};
    for (int j = 0; j < LINES; j++) {
        const int i = strip->corner[j];
        if (i >= 0) width[j] = strip->c[i].width[0][j] + strip->c[i].width[1][j];
    }
    const double outer = width[0] + width[3], inner = width[1] + width[2];
    return fabs(outer - inner) <= EVEN * (outer + inner);
}

/* Whether distances and directions change little from the first line of a strip to the last; where there is little of T
 * in it, they may change more. */
static inline int is_short(const Wedge *w, const Strip *strip, double range)
{
    if (!is_even(strip)) return 0;
    const Across *a = strip->c + strip->corner[0], *b = strip->c + strip->corner[3];
    const double most = CHANGE[share_in(strip, range) < LITTLE];
    for (int k = 0; k < 2 && strip->corner[0] >= 0 && strip->corner[3] >= 0; k++) {
        const double r1 = a->r[k][0], r2 = b->r[k][3];
        if (fabs(r2 - r1) > most * d_maximum(d_minimum(r1, r2), w->T->smooth)) return 0;
        if (w->e->narrow) continue;
        double cosine = 0;
        for (int x = 0; x < 3; x++) cosine += a->away[k][x][0] * b->away[k][x][3];
        if (cosine < COS_TURN * r1 * r2) return 0;
    }
    return 1;
}

/* Adds the lines of a strip. */
static void add_lines(const Wedge *w, const Strip *strip, double range, Pieces *found)
{
    for (int j = 0; j < LINES; j++) {
        const int i = strip->corner[j];
        const Across *c = strip->c + (i < 0 ? 0 : i);
        if (i < 0 || (c->r[0][j] >= w->T->within && c->r[1][j] >= w->T->within)) continue;
        v4 on[2];
        for (int k = 0; k < 2; k++) {
            const double one = c->share[k][0][j], other = c->share[k][1][j];
            on[k][i] = 1 - one - other;
            on[k][c->next[0]] = one;
            on[k][c->next[1]] = other;
            on[k][3] = 2 * range * LINE_WEIGHT[j] * w->e->sign * w->T->area * c->width[k][j];
        }
        keep(found, on, 2);
    }
}

/* Finds the lines between two directions, in strips that are short: halves of halves of all. */
static void find_strips(const Wedge *w, double low, double high, Pieces *found)
{
    const long all = 1L << HALVINGS;
    const double part = (high - low) / (double)all;
    Strip strip;
    for (long at = 0, size; at < all; at += size) {
        for (size = at ? at & -at : all;; size /= 2) {
            if (!set_strip(w, low + part * ((double)at + (double)size * LINE_AT), &strip) && size == all) return;
            if (size == 1 || is_short(w, &strip, part * (double)size)) break;
        }
        add_lines(w, &strip, part * (double)size, found);
    }
}

/* Sorts directions between 0 and 1 into limits, of which there are n: those where both weights are positive. */
static inline int sort_in(double *limits, int n, v4 first, v4 last, int which)
{
    const v4 at = last / (first + last);
    for (which &= ~signs(smaller(first, last)) & 7; which; which &= which - 1) {
        const double value = at[__builtin_ctz((unsigned)which)];
        int m = n++;
        for (; m > 0 && limits[m - 1] > value; m--) limits[m] = limits[m - 1];
        limits[m] = value;
    }
    return n;
}

/* Directions where lines of a wedge end at another side of T, or at another end of the edge: of corners of T, and of
 * points of its sides beside the ends.  Their number. */
static int find_limits(const Four *four, double limits[MOST_LIMITS])
{
    const v4 corner[4] = {four->at, four->at + four->by[0], four->at + four->by[1], four->at};
    v4 value[4], next[4]; /* by functions */
    transpose(corner, value);
    for (int k = 0; k < 4; k++) next[k] = SHUFFLE(value[k], value[k], 1, 2, 0, 3);
    int n = 2;
    limits[0] = 0;
    limits[1] = 1;
    n = sort_in(limits, n, value[0], value[1], ~signs(smaller(value[2], value[3])));
    for (int k = 2; k < 4; k++) {
        const v4 share = value[k] / (value[k] - next[k]);
        const v4 first = fma4(share, next[0] - value[0], value[0]), last = fma4(share, next[1] - value[1], value[1]);
        n = sort_in(limits, n, first, last, signs(value[k]) ^ signs(next[k]));
    }
    return n;
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
static double beside_edge3(const Triangle *T, const Edge3 *e, Pieces *found)
{
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
    Wedge w;
    w.T = T, w.e = e;
    for (int k = 0; k < 3; k++) {
        const v4 value = four.at + (k ? four.by[k - 1] : (v4){0});
        w.last[k] = value[1];
        w.sum[k] = value[0] + value[1];
        w.along[k] = value[2];
        w.away[k] = away[k];
    }
    double limits[MOST_LIMITS];
    const int n = find_limits(&four, limits);
    for (int m = 0; m + 1 < n; m++)
        if (limits[m + 1] - limits[m] >= THIN) find_strips(&w, limits[m], limits[m + 1], found);
    return 0;
}
