/* Pieces of a triangle T of one surface over faces of another, and what bonds do there.  Points of T are
 * shares of its corners.  The same as geometry/polyhedra.py, where it is explained. */

enum { MOST_SPOKES = 24, MOST_CORNERS = MOST_SPOKES + 4, MOST_WAITING = 64,
      HALVINGS = 10, POINTS_OF_LINE = 3, POINTS_OF_CONE = 7 };
static const double CHANGE = 0.4, COS_TURN = 0.921060994002885, SIZE = 0.8, LEVEL = 1e-9, THIN = 1e-12;
static const double LINE_AT[POINTS_OF_LINE] = {0.11270166537925831, 0.5, 0.8872983346207417};
static const double LINE_WEIGHT[POINTS_OF_LINE] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
static const double SKEW[3] = {0.9e-12, 1.3e-12, 1.7e-12}; /* [µm] moves features off triangles on their borders */
static const double CONE_AT[2] = {0.10128650732345634, 0.47014206410511505}; /* Radon (1948) */
static const double CONE_WEIGHT[3] = {0.12593918054482717, 0.13239415278850616, 0.225};

/* T: parameters of its law, distances beyond which there are no bonds and below which they have no scale, reference
 * area, corners and what acts on them: here and below forces, and in the fourth place a bound of the sum of their row
 * of the tangent. */
typedef struct { const double *law; double within, smooth, area; const double *x[3]; double *force[3]; } Triangle;

/* A convex polygon on T. */
typedef struct { int n; double at[MOST_CORNERS][3]; } Polygon;

static inline double dot3(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline void cross3(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

static inline void less3(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = a[i] - b[i];
}

static inline void mixed3(const double a[3], const double b[3], double share, double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = a[i] + share * (b[i] - a[i]);
}

/* A vector at a point of T from those at its corners. */
static inline void vector_at(const double corner[3][3], const double on[3], double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = on[0] * corner[0][i] + on[1] * corner[1][i] + on[2] * corner[2][i];
}

/* All of T. */
static inline void whole(Polygon *p)
{
    static const double corners[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    p->n = 3;
    memcpy(p->at, corners, sizeof corners);
}

/* Cuts a polygon to where `sign` times something linear is positive, with values at the corners of T. */
static void clip(Polygon *p, const double value[3], double sign)
{
    double at[MOST_CORNERS], least = INFINITY;
    for (int k = 0; k < p->n; k++) {
        at[k] = sign * dot3(p->at[k], value);
        if (at[k] < least) least = at[k];
    }
    if (least >= 0) return;
    Polygon part;
    part.n = 0;
    for (int k = 0, last = p->n - 1; k < p->n; last = k++) {
        if ((at[last] < 0) != (at[k] < 0))
            mixed3(p->at[last], p->at[k], at[last] / (at[last] - at[k]), part.at[part.n++]);
        if (at[k] >= 0) memcpy(part.at[part.n++], p->at[k], sizeof part.at[0]);
    }
    p->n = part.n;
    memcpy(p->at, part.at, sizeof part.at[0] * (size_t)part.n);
}

/* Area between two vectors on T, over twice that of T. */
static inline double crossed(const double a[3], const double b[3]) { return a[1] * b[2] - a[2] * b[1]; }

/* Share of T of the triangle k of the fan of a polygon. */
static inline double fan(const Polygon *p, int k)
{
    double a[3], b[3];
    less3(p->at[k + 1], p->at[0], a);
    less3(p->at[k + 2], p->at[0], b);
    return fabs(crossed(a, b));
}

/* A load at a point of T along the direction from the feature, to the corners of both by their shares. */
static inline void pull(const Triangle *T, const double on[3], double *const force[], const double *below, int n,
                        double load, const double away[3])
{
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) T->force[k][i] -= on[k] * load * away[i];
        for (int k = 0; k < n; k++) force[k][i] += below[k] * load * away[i];
    }
}

/* Adds the stiffness of what acts at a point of T to the corners of both by their shares. */
static inline void stiffen(const Triangle *T, const double on[3], double *const force[], const double *below, int n,
                           double stiffness)
{
    for (int k = 0; k < 3; k++) T->force[k][3] += on[k] * stiffness;
    for (int k = 0; k < n; k++) force[k][3] += below[k] * stiffness;
}

/* A face: its first corner, unit normal, and the gradients of the shares of its second and third corners. */
typedef struct { double start[3], normal[3], gradient[2][3]; } Face;

/* The face with these corners, in positive order as seen from outside. */
static Face face_of(const double *const x[3])
{
    Face f;
    double side1[3], side2[3];
    less3(x[1], x[0], side1);
    less3(x[2], x[0], side2);
    cross3(side1, side2, f.normal);
    const double square = dot3(f.normal, f.normal), length = sqrt(square);
    cross3(side2, f.normal, f.gradient[0]);
    cross3(f.normal, side1, f.gradient[1]);
    for (int i = 0; i < 3; i++) {
        f.start[i] = x[0][i] + SKEW[i];
        f.normal[i] /= length;
        f.gradient[0][i] /= square;
        f.gradient[1][i] /= square;
    }
    return f;
}

/* The part of T over a face, on its outer side.  Energy; *pierced is set where T goes through the face. */
static double over_face(const Triangle *T, const Face *f, double *const force[3], int *pierced)
{
    double from[3], gap[3], on[3][3], energy = 0;
    int out = 0, behind = 0, before[3] = {0};
    for (int k = 0; k < 3; k++) {
        less3(T->x[k], f->start, from);
        gap[k] = dot3(from, f->normal);
        on[1][k] = dot3(from, f->gradient[0]);
        on[2][k] = dot3(from, f->gradient[1]);
        on[0][k] = 1 - on[1][k] - on[2][k];
        out += gap[k] >= T->within;
        behind += gap[k] <= 0;
        for (int c = 0; c < 3; c++) before[c] += on[c][k] <= 0;
    }
    if (out == 3 || behind == 3 || before[0] == 3 || before[1] == 3 || before[2] == 3) return 0;
    Polygon p;
    whole(&p);
    for (int k = 0; k < 3 && p.n > 2; k++) clip(&p, on[k], 1);
    if (p.n < 3) return 0;
    for (int k = 0; behind && k < p.n; k++)
        if (dot3(p.at[k], gap) < 0) behind = -1;
    if (behind < 0) {
        clip(&p, gap, 1);
        *pierced |= p.n > 2;
    }
    for (int k = 0; k + 2 < p.n; k++) {
        const double *corner[3] = {p.at[0], p.at[k + 1], p.at[k + 2]};
        const double g[3] = {dot3(corner[0], gap), dot3(corner[1], gap), dot3(corner[2], gap)};
        double loads[3], stored[1];
        contact_face(T->law, T->area * fan(&p, k), g[0], g[1], g[2], loads, stored);
        const double stiffness = contact_face_stiffness(T->law, T->area * fan(&p, k), g[0], g[1], g[2]) / 3;
        for (int c = 0; c < 3; c++) {
            const double below[3] = {dot3(corner[c], on[0]), dot3(corner[c], on[1]), dot3(corner[c], on[2])};
            pull(T, corner[c], force, below, 3, loads[c], f->normal);
            stiffen(T, corner[c], force, below, 3, stiffness);
        }
        energy += stored[0];
    }
    return energy;
}
