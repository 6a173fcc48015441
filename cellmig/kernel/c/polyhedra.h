/* Pieces of a triangle T of one surface over faces of another.  Points of T are shares of its corners, in the first
 * three places of a vector.  The same as geometry/polyhedra.py, where it is explained. */

enum { MOST_SPOKES = 24, MOST_CORNERS = MOST_SPOKES + 8, MOST_PIECES = TOGETHER };
static const double SKEW[3] = {0.9e-12, 1.3e-12, 1.7e-12}; /* [µm] moves features off triangles on their borders */
static const double SURE = 1e-9; /* [µm] far above what rounding changes */

static inline void less3(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = a[i] - b[i];
}

/* The first three places of two vectors. */
static inline double dot4(v4 a, v4 b) { const v4 c = a * b; return c[0] + c[1] + c[2]; }

static inline double most_of(v4 a) { return d_maximum(d_maximum(a[0], a[1]), d_maximum(a[2], a[3])); }

/* T: parameters of its law, distances beyond which there are no bonds and below which they have no scale, reference
 * area, corners, sides from the first to the others, what acts on the corners, and its energy.  What acts are forces,
 * and in the fourth place a bound of the sum of their row of the tangent. */
typedef struct {
    const double *law;
    double within, smooth, area;
    const double *x[3];
    double side[2][3], *force[3], *energy;
} Triangle;

/* Sets the sides of T. */
static inline void set_sides(Triangle *T)
{
    for (int k = 0; k < 2; k++) less3(T->x[k + 1], T->x[0], T->side[k]);
}

/* A ball around T. */
typedef struct { double middle[3], radius; } Ball;

/* The ball about the mean of the corners. */
static Ball ball_around(const Triangle *T)
{
    Ball ball = {.radius = 0};
    for (int i = 0; i < 3; i++) ball.middle[i] = (T->x[0][i] + T->x[1][i] + T->x[2][i]) / 3;
    for (int k = 0; k < 3; k++) {
        double from[3];
        less3(T->x[k], ball.middle, from);
        ball.radius = d_maximum(ball.radius, dot3(from, from));
    }
    ball.radius = sqrt(ball.radius);
    return ball;
}

/* Four linear functions of a place, all of which are positive where a feature acts: `at` the start, gradients `slope`,
 * 1 over the lengths of these as `width`; middle and least size of what they depend on. */
typedef struct { v4 at, slope[3], width; double start[3], middle[3], size; } Planes;

/* Four linear functions on T: values at its first corner, and their changes to the others. */
typedef struct { v4 at, by[2]; } Four;

/* Those with the values `at` at a place and gradients `slope`. */
static inline Four four_on(const Triangle *T, const double start[3], v4 at, const v4 slope[3])
{
    Four f = {at, {{0}}};
    for (int i = 0; i < 3; i++) {
        f.at = fma4(splat(T->x[0][i] - start[i]), slope[i], f.at);
        for (int k = 0; k < 2; k++) f.by[k] = fma4(splat(T->side[k][i]), slope[i], f.by[k]);
    }
    return f;
}

static inline Four planes_on(const Triangle *T, const Planes *l) { return four_on(T, l->start, l->at, l->slope); }

/* Their values at a point of T; the largest and the least ones on T. */
static inline v4 value_at(const Four *f, v4 on)
{
    return fma4(splat(on[2]), f->by[1], fma4(splat(on[1]), f->by[0], f->at));
}

static inline v4 most_on(const Four *f) { return f->at + larger((v4){0}, larger(f->by[0], f->by[1])); }
static inline v4 least_on(const Four *f) { return f->at + smaller((v4){0}, smaller(f->by[0], f->by[1])); }

/* How far all corners of T and of a feature may move until a length beside the feature, now `room`, may be zero.  As
 * they move by δ, it changes by 2 δ at either end, and with the distance as the feature turns, by 4 δ over its size.  A
 * fifth is left for what is of second order in a move that is small beside the size. */
static inline double rest_of(const Triangle *T, const Planes *l, double room)
{
    double square = 0;
    for (int k = 0; k < 3; k++) {
        double from[3];
        less3(T->x[k], l->middle, from);
        square = d_maximum(square, dot3(from, from));
    }
    const double length = d_minimum(room - SURE, 0.5 * l->size);
    return 0.2 * length * l->size / (l->size + sqrt(square) + length);
}

/* A convex polygon on T, in either of two places; the fourth place of a point is for what is linear on it. */
typedef struct { int n; v4 *on, place[2][MOST_CORNERS]; } Polygon;

/* All of T, with something linear. */
static inline void whole(Polygon *p, const double value[3])
{
    p->n = 3;
    p->on = p->place[0];
    for (int k = 0; k < 3; k++) p->on[k] = (v4){k == 0, k == 1, k == 2, value[k]};
}

/* The point between two of which something linear has the values a and b where it is zero. */
static inline v4 zero_between(v4 p, v4 q, double a, double b) { return fma4(splat(a / (a - b)), q - p, p); }

/* The part of a convex polygon where something linear is not negative: a place of `value` at its corners, of which
 * `out` has a bit where that is negative, but not of all.  Those that are left are in one run.  Number of corners. */
static inline int cut(const v4 *on, int n, const v4 *value, int place, uint32_t out, v4 *part)
{
    const double *at = (const double *)value + place;
    const uint32_t in = (((uint32_t)1 << n) - 1) & ~out;
    int k = __builtin_ctz(in & (out << 1 | out >> (n - 1))), last = k ? k - 1 : n - 1, m = 1;
    part[0] = zero_between(on[last], on[k], at[4 * last], at[4 * k]);
    for (; in >> k & 1; k = k + 1 < n ? k + 1 : 0) part[m++] = on[last = k];
    part[m] = zero_between(on[last], on[k], at[4 * last], at[4 * k]);
    return m + 1;
}

/* Cuts a polygon to where some of four functions are not negative, of which there is a bit each; their values at its
 * corners. */
static inline void cut_by(Polygon *p, const Four *f, int some, v4 value[MOST_CORNERS])
{
    for (;;) {
        int negative[MOST_CORNERS], any = 0, every = some;
        for (int k = 0; k < p->n; k++) {
            value[k] = value_at(f, p->on[k]);
            any |= negative[k] = signs(value[k]);
            every &= negative[k];
        }
        any &= some;
        if (every) p->n = 0;
        if (!any || every) return;
        const int place = __builtin_ctz((unsigned)any);
        uint32_t out = 0;
        for (int k = 0; k < p->n; k++) out |= (uint32_t)(negative[k] >> place & 1) << k;
        v4 *part = p->place[p->on == p->place[0]];
        p->n = cut(p->on, p->n, value, place, out, part);
        p->on = part;
        some &= ~(1 << place);
    }
}

/* Area between two vectors on T, over twice that of T. */
static inline double crossed(v4 a, v4 b) { return a[1] * b[2] - a[2] * b[1]; }

/* Share of T of the triangle k of the fan of a polygon. */
static inline double fan(const v4 *on, int k) { return fabs(crossed(on[k + 1] - on[0], on[k + 2] - on[0])); }

static const double NOTHING[3] = {0, 0, 0};

/* A face: the shares of its corners and the gap from it as planes, its unit normal. */
typedef struct { Planes planes; v4 normal; } Face;

/* Sets the face with these corners, in positive order as seen from outside. */
static void set_face(Face *f, const double *const x[3])
{
    double side1[3], side2[3], normal[3], second[3], third[3];
    less3(x[1], x[0], side1);
    less3(x[2], x[0], side2);
    cross3(side1, side2, normal);
    const double square = dot3(normal, normal), length = sqrt(square);
    cross3(side2, normal, second);
    cross3(normal, side1, third);
    double slope[3] = {0};
    for (int i = 0; i < 3; i++) {
        const double b = second[i] / square, c = third[i] / square, n = normal[i] / length;
        f->planes.start[i] = x[0][i] + SKEW[i];
        f->planes.middle[i] = (x[0][i] + x[1][i] + x[2][i]) / 3;
        f->planes.slope[i] = (v4){-(b + c), b, c, n};
        slope[0] += (b + c) * (b + c);
        slope[1] += b * b;
        slope[2] += c * c;
    }
    f->normal = (v4){normal[0] / length, normal[1] / length, normal[2] / length, 0};
    f->planes.at = (v4){1, 0, 0, 0};
    f->planes.width = 1 / v4_sqrt((v4){slope[0], slope[1], slope[2], 1});
    f->planes.size = d_minimum(f->planes.width[0], d_minimum(f->planes.width[1], f->planes.width[2]));
}

/* Finds the part of T over a face, on its outer side, and how far T goes through it.  How far corners may move until
 * there is any. */
static double over_face(const Triangle *T, const Face *f, Pieces *found, double *pierced)
{
    const Four four = planes_on(T, &f->planes);
    const v4 most = most_on(&four), least = least_on(&four);
    if (signs(most) || least[3] >= T->within)
        return rest_of(T, &f->planes, d_maximum(least[3] - T->within, most_of(-most * f->planes.width)));
    Polygon p;
    v4 below[MOST_CORNERS];
    whole(&p, NOTHING);
    cut_by(&p, &four, 7 & signs(least), below);
    if (p.n && least[3] < 0) {
        int behind = 0;
        double deepest = 0;
        for (int k = 0; k < p.n; k++) {
            behind |= signs(below[k]) & 8;
            deepest = d_maximum(deepest, -below[k][3]);
        }
        cut_by(&p, &four, behind, below);
        if (p.n) *pierced = d_maximum(*pierced, deepest);
    }
    keep(found, p.on, p.n);
    return 0;
}
