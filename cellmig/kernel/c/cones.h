/* The points of a triangle T in the cones over a vertex of another surface. */

enum { MOST_HALVINGS = 40, POINTS_OF_CONE = 7 };
static const double SIZE[2] = {0.8, 1.5}; /* the second where there is little of T */
static const double CONE_AT[2] = {0.10128650732345634, 0.47014206410511505}; /* Radon (1948) */
static const double CONE_WEIGHT[3] = {0.12593918054482717, 0.13239415278850616, 0.225};

/* A vertex: four planes around its cones, which lie within an angle from its mean normal: beyond, the spokes on the
 * side of a point are one arc, as those of a level vertex.  Spokes to its neighbours, four by four; `bent` is -1 where
 * all edges are convex, 1 where all are reflex: then all are on one side wherever the index is not zero; `turn`: see
 * `turning`. */
typedef struct { Planes planes; v4 spokes[MOST_SPOKES / 4][3]; int n, bent; double normal[3], turn; } Vertex;

/* Sets the planes around the cones: the tangent of their angle from the normal is `wide`, infinite without bound. */
static void set_cones(Vertex *v, double wide)
{
    const double *n = v->normal;
    const int i = fabs(n[0]) > fabs(n[1]) ? (fabs(n[1]) > fabs(n[2]) ? 2 : 1) : fabs(n[0]) > fabs(n[2]) ? 2 : 0;
    double one[3] = {i == 0, i == 1, i == 2}, across[3], other[3];
    cross3(n, one, across);
    const double length = sqrt(dot3(across, across));
    for (int k = 0; k < 3; k++) across[k] /= length;
    cross3(n, across, other);
    const int bounded = wide < INFINITY;
    v->planes.at = splat(!bounded);
    for (int k = 0; k < 3; k++) {
        const v4 beside = {across[k], -across[k], other[k], -other[k]};
        v->planes.slope[k] = bounded ? wide * n[k] + beside : 0 * beside;
    }
    v->planes.width = splat(1 / sqrt(1 + wide * wide));
}

/* The angle by which normal and bound turn at most as points move by a length, over that.  A spoke changes by twice
 * the length, and so does its inversion over the square of its own; of these the normal is made, which changes by twice
 * `turns`.  A spoke beside the normal changes by that and by its own part, where 1 over its length is at `most` that.
 * The tangent of the bound is the `steepest` spoke over the sine of half the `least` angle between two; its change
 * counts twice, as it is of first order. */
static double turning(double turns, double most, double steepest, double least)
{
    const double normal = 2 * turns, spoke = 2 * most + normal, square = 1 + steepest * steepest;
    return normal + 2 * spoke * (square + sqrt(square)) / least;
}

/* Sets the vertex with n neighbours, in positive order. */
static void set_vertex(Vertex *v, const double *x, const double *const ring[], int n)
{
    v->n = n;
    memset(v->normal, 0, sizeof v->normal);
    memset(v->spokes, 0, sizeof v->spokes);
    int convex = 0, reflex = 0;
    double spoke[MOST_SPOKES][3], square[MOST_SPOKES], over[MOST_SPOKES], flat[MOST_SPOKES][3], across[3];
    double steepest = 0, least = 1, most = 0, turns = 0;
    for (int i = 0; i < 3; i++) v->planes.start[i] = x[i] + SKEW[i];
    for (int j = 0; j < n; j++) {
        less3(ring[j], x, spoke[j]);
        square[j] = dot3(spoke[j], spoke[j]);
        over[j] = 1 / sqrt(square[j]);
        most = d_maximum(most, over[j]);
        for (int i = 0; i < 3; i++) ((double *)v->spokes[j / 4])[4 * i + j % 4] = spoke[j][i];
    }
    for (int j = 0; j < n; j++) { /* weights of Max (1999) */
        const int next = j + 1 < n ? j + 1 : 0;
        cross3(spoke[j], spoke[next], across);
        const double turn = dot3(across, spoke[next + 1 < n ? next + 1 : 0]);
        convex += turn <= 0;
        reflex += turn >= 0;
        turns += over[j] * over[next] * (over[j] + over[next]);
        for (int i = 0; i < 3; i++) v->normal[i] += across[i] / (square[j] * square[next]);
    }
    v->bent = (reflex == n) - (convex == n);
    const double length = sqrt(dot3(v->normal, v->normal));
    for (int i = 0; i < 3; i++) v->normal[i] /= length;
    for (int j = 0; j < n; j++) {
        const double rise = dot3(spoke[j], v->normal), run = sqrt(d_maximum(square[j] - rise * rise, 0));
        for (int i = 0; i < 3; i++) flat[j][i] = (spoke[j][i] - rise * v->normal[i]) / run;
        steepest = d_maximum(steepest, fabs(rise) / run);
    }
    for (int j = 0; j < n; j++) { /* sine and cosine of half the angle to the next */
        const int next = j + 1 < n ? j + 1 : 0;
        cross3(flat[j], flat[next], across);
        const double cosine = dot3(flat[j], flat[next]), ahead = dot3(across, v->normal) > 0;
        least = d_minimum(least, ahead ? sqrt(0.5 * d_minimum(1 - cosine, 1 + cosine)) : 0);
    }
    set_cones(v, least > 0 ? steepest / least : INFINITY);
    v->turn = turning(turns / length, most, steepest, least);
}

/* A vertex and T; vectors from the vertex to the corners, and their products with its spokes. */
typedef struct {
    const Triangle *T;
    const Vertex *v;
    Pieces *found;
    v4 away[3];
    Four spoke[MOST_SPOKES / 4];
} Cone;

/* Adds the seven points of a triangle, by shares of T and vectors from the vertex at its corners. */
static void add_points(const Cone *cone, const v4 corner[3], const v4 place[3], double area)
{
    const v4 all = corner[0] + corner[1] + corner[2], sum = place[0] + place[1] + place[2];
    for (int q = 0; q < POINTS_OF_CONE; q++) {
        const double at = q == 6 ? 1.0 / 3 : CONE_AT[q / 3], rest = 1 - 3 * at;
        const v4 away = at * sum + rest * place[q % 3];
        if (dot4(away, away) >= cone->T->within * cone->T->within) continue;
        v4 on = at * all + rest * corner[q % 3];
        on[3] = area * CONE_WEIGHT[q / 3];
        keep(cone->found, &on, 1);
    }
}

/* Finds the points of those parts of a triangle that are short beside their distance from the vertex. */
static void in_triangle(const Cone *cone, const v4 corner[3], const v4 place[3], double area, int halvings)
{
    double side[3], nearest = INFINITY;
    for (int k = 0; k < 3; k++) {
        const v4 across = place[(k + 1) % 3] - place[(k + 2) % 3];
        nearest = d_minimum(nearest, dot4(place[k], place[k]));
        side[k] = dot4(across, across);
    }
    const int k = side[0] >= side[1] ? (side[0] >= side[2] ? 0 : 2) : side[1] >= side[2] ? 1 : 2;
    const double longest = sqrt(side[k]);
    nearest = sqrt(nearest);
    const double most = SIZE[fabs(area) < LITTLE * cone->T->area] * d_maximum(nearest, cone->T->smooth);
    if (longest <= most || halvings == MOST_HALVINGS) {
        add_points(cone, corner, place, area);
    } else if (nearest - longest < cone->T->within) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        const v4 middle = 0.5 * (corner[a] + corner[b]), there = 0.5 * (place[a] + place[b]);
        for (int part = 0; part < 2; part++) {
            v4 of_corner[3] = {corner[0], corner[1], corner[2]}, of_place[3] = {place[0], place[1], place[2]};
            of_corner[part ? a : b] = middle;
            of_place[part ? a : b] = there;
            in_triangle(cone, of_corner, of_place, 0.5 * area, halvings + 1);
        }
    }
}

/* Bits of n spokes, each at the place of the next one, or of the one before. */
static inline uint32_t of_before(uint32_t spokes, int n) { return (spokes << 1 | spokes >> (n - 1)) & ((1u << n) - 1); }
static inline uint32_t of_next(uint32_t spokes, int n) { return spokes >> 1 | (spokes & 1) << (n - 1); }

/* The index where some of n spokes are on the side of a point: 1 less the number of their arcs. */
static inline int index_of(uint32_t towards, int n) { return 1 - __builtin_popcount(towards & ~of_next(towards, n)); }

/* Finds the points of a polygon on T where the index is not zero; `towards` has a bit of each spoke on its side. */
static void in_cell(const Cone *cone, const v4 *on, int n, uint32_t towards)
{
    const Vertex *v = cone->v;
    const int index = index_of(towards, v->n);
    if (!index) return;
    v4 away[MOST_CORNERS];
    double side = 0, nearest = INFINITY;
    int first = 0;
    for (int k = 0; k < n; k++) {
        away[k] = fma4(splat(on[k][2]), cone->away[2], fma4(splat(on[k][1]), cone->away[1], on[k][0] * cone->away[0]));
        side += dot3((const double *)(away + k), v->normal);
        const double square = dot4(away[k], away[k]);
        if (square >= nearest) continue;
        nearest = square;
        first = k;
    }
    if (side <= 0) return;
    for (int k = 1; k + 1 < n; k++) {
        const int i = (first + k) % n, j = (first + k + 1) % n;
        const v4 corner[3] = {on[first], on[i], on[j]}, place[3] = {away[first], away[i], away[j]};
        const double share = fabs(crossed(on[i] - on[first], on[j] - on[first]));
        in_triangle(cone, corner, place, index * share * cone->T->area, 0);
    }
}

/* The same in the parts into which spokes cut a polygon on T, of those that are `open`: not known to have it on one
 * side.  One between two known ones on different sides changes no index: where that is zero it cuts nothing. */
static void in_part(const Cone *cone, const v4 *on, int n, uint32_t open, uint32_t towards)
{
    const int m = cone->v->n;
    v4 value[MOST_SPOKES / 4][MOST_CORNERS], part[MOST_CORNERS];
    uint32_t above = 0, below = 0;
    for (int g = 0; 4 * g < m; g++)
        for (int k = 0; k < n && open >> 4 * g & 15; k++) {
            value[g][k] = value_at(cone->spoke + g, on[k]);
            above |= (uint32_t)signs(-value[g][k]) << 4 * g;
            below |= (uint32_t)signs(value[g][k]) << 4 * g;
        }
    towards |= above & ~below & open;
    open &= above & below;
    const uint32_t before = of_before(open, m), next = of_next(open, m);
    const uint32_t counts = open & (before | next | ~(of_before(towards, m) ^ of_next(towards, m)));
    if (!open || (!counts && !index_of(towards, m))) {
        in_cell(cone, on, n, towards);
        return;
    }
    const uint32_t alone = counts & before & next; /* first, so that those beside it may change nothing */
    const int j = __builtin_ctz(alone ? alone : counts ? counts : open);
    uint32_t out[2] = {0, 0};
    for (int k = 0; k < n; k++) {
        const double at = ((const double *)(value[j / 4] + k))[j % 4];
        out[0] |= (uint32_t)(at < 0) << k;
        out[1] |= (uint32_t)(at >= 0) << k;
    }
    for (int other = 0; other < 2; other++) {
        const int corners = cut(on, n, value[j / 4], j % 4, out[other], part);
        in_part(cone, part, corners, open & ~(1u << j), other ? towards : towards | 1u << j);
    }
}

/* How far corners may move until T, all within `reach` of a vertex, may be in the cones, now `room` away.  A fifth is
 * left for what is of second order in a turn that is small. */
static inline double rest_beyond(const Vertex *v, double room, double reach)
{
    const double turn = v->turn;
    return d_minimum(0.4 / turn, 0.8 * (room - SURE) / (2 + (reach + room) * turn));
}

/* Finds the points of T in the cones over a vertex.  How far corners may move until T may be within reach. */
static double beside_vertex3(const Triangle *T, const Ball *ball, const Vertex *v, Pieces *found)
{
    double from[3];
    less3(ball->middle, v->planes.start, from);
    const double square = dot3(from, from), reach = ball->radius + T->within;
    if (square > reach * reach) return 0.25 * (sqrt(square) - reach - SURE);
    const Four four = planes_on(T, &v->planes);
    const v4 most = most_on(&four);
    if (signs(most)) return rest_beyond(v, most_of(-most * v->planes.width), sqrt(square) + ball->radius);
    Cone cone;
    cone.T = T, cone.v = v, cone.found = found;
    double nearest = INFINITY;
    for (int k = 0; k < 3; k++) {
        const double *x = T->x[k], *start = v->planes.start;
        cone.away[k] = (v4){x[0] - start[0], x[1] - start[1], x[2] - start[2], 0};
        nearest = d_minimum(nearest, dot3((const double *)(cone.away + k), v->normal));
    }
    if (nearest >= T->within) return 0;
    Polygon p;
    whole(&p, NOTHING);
    v4 value[MOST_CORNERS];
    cut_by(&p, &four, signs(least_on(&four)), value);
    if (!p.n) return 0;
    for (int g = 0; 4 * g < v->n; g++) {
        Four *four = cone.spoke + g;
        *four = four_on(T, v->planes.start, (v4){0}, v->spokes[g]);
        if (!v->bent) continue;
        const v4 sign = splat(v->bent);
        const Four inside = {sign * four->at, {sign * four->by[0], sign * four->by[1]}};
        cut_by(&p, &inside, signs(least_on(&inside)), value);
    }
    if (p.n && v->bent) in_cell(&cone, p.on, p.n, v->bent > 0 ? ((uint32_t)1 << v->n) - 1 : 0);
    else if (p.n) in_part(&cone, p.on, p.n, ((uint32_t)1 << v->n) - 1, 0);
    return 0;
}
