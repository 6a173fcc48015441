/* The points of a triangle T in the cones over a vertex of another surface, and what bonds do there. */

/* A vertex: place, spokes to its neighbours, mean normal, and the tangent of the angle from it within which its cones
 * lie: beyond, the spokes on the side of a point are one arc, as those of a level vertex.  `bent` is -1 where all edges
 * are convex, 1 where all are reflex: then all spokes are on one side wherever the index is not zero. */
typedef struct { int n, bent; double at[3], spoke[MOST_SPOKES][3], normal[3], wide; } Vertex;

/* Of T, vectors from a vertex to the corners, their products with its spokes and with its mean normal. */
typedef struct { int n; double away[3][3], value[MOST_SPOKES][3], outward[3]; } Cone;

/* The vertex with n neighbours, in positive order. */
static Vertex vertex_of(const double *x, const double *const ring[], int n)
{
    Vertex v = {.n = n, .normal = {0}};
    int convex = 0, reflex = 0;
    double square[MOST_SPOKES], flat[MOST_SPOKES][3], steepest = 0, least = 1, across[3];
    for (int i = 0; i < 3; i++) v.at[i] = x[i] + SKEW[i];
    for (int j = 0; j < n; j++) {
        less3(ring[j], x, v.spoke[j]);
        square[j] = dot3(v.spoke[j], v.spoke[j]);
    }
    for (int j = 0; j < n; j++) { /* weights of Max (1999) */
        const int next = j + 1 < n ? j + 1 : 0;
        cross3(v.spoke[j], v.spoke[next], across);
        const double turn = dot3(across, v.spoke[next + 1 < n ? next + 1 : 0]);
        convex += turn <= 0;
        reflex += turn >= 0;
        for (int i = 0; i < 3; i++) v.normal[i] += across[i] / (square[j] * square[next]);
    }
    v.bent = (reflex == n) - (convex == n);
    const double length = sqrt(dot3(v.normal, v.normal));
    for (int i = 0; i < 3; i++) v.normal[i] /= length;
    for (int j = 0; j < n; j++) {
        const double rise = dot3(v.spoke[j], v.normal), run = sqrt(fmax(square[j] - rise * rise, 0));
        for (int i = 0; i < 3; i++) flat[j][i] = (v.spoke[j][i] - rise * v.normal[i]) / run;
        steepest = fmax(steepest, fabs(rise) / run);
    }
    for (int j = 0; j < n; j++) { /* sine and cosine of half the angle to the next */
        const int next = j + 1 < n ? j + 1 : 0;
        cross3(flat[j], flat[next], across);
        const double cosine = dot3(flat[j], flat[next]), ahead = dot3(across, v.normal) > 0;
        least = fmin(least, ahead ? sqrt(0.5 * fmin(1 - cosine, 1 + cosine)) : 0);
    }
    v.wide = least > 0 ? steepest / least : INFINITY;
    return v;
}

/* Vectors and products; whether T may be within reach, and near the cones. */
static int find_cone(const Triangle *T, const Vertex *v, Cone *cone)
{
    double middle[3], across[3], nearest = INFINITY, radius = 0;
    for (int i = 0; i < 3; i++) middle[i] = (T->x[0][i] + T->x[1][i] + T->x[2][i]) / 3 - v->at[i];
    for (int k = 0; k < 3; k++) {
        less3(T->x[k], v->at, cone->away[k]);
        less3(cone->away[k], middle, across);
        radius = fmax(radius, dot3(across, across));
    }
    radius = sqrt(radius);
    nearest = sqrt(dot3(middle, middle)) - radius;
    const double up = dot3(middle, v->normal), beside = sqrt(fmax(dot3(middle, middle) - up * up, 0));
    if (nearest > T->within || up < -radius) return 0;
    if (v->wide < INFINITY && beside - radius > v->wide * (up + radius)) return 0;
    cone->n = v->n;
    for (int k = 0; k < 3; k++) {
        cone->outward[k] = dot3(cone->away[k], v->normal);
        for (int j = 0; j < v->n; j++) cone->value[j][k] = dot3(cone->away[k], v->spoke[j]);
    }
    return 1;
}

/* Seven points of each of the parts of a triangle that are short beside their distance from the vertex.  Energy. */
static double on_cone(const Triangle *T, const Cone *cone, const double corner[3][3], double part,
                      double *const force[1])
{
    struct { double at[3][3], part; } waiting[MOST_WAITING], now;
    double energy = 0;
    int n = 1;
    memcpy(waiting[0].at, corner, sizeof waiting[0].at);
    waiting[0].part = part;
    while (n) {
        double place[3][3], side[3], nearest = INFINITY, across[3];
        now = waiting[--n];
        for (int k = 0; k < 3; k++) {
            vector_at(cone->away, now.at[k], place[k]);
            nearest = fmin(nearest, dot3(place[k], place[k]));
        }
        for (int k = 0; k < 3; k++) {
            less3(place[(k + 1) % 3], place[(k + 2) % 3], across);
            side[k] = sqrt(dot3(across, across));
        }
        nearest = sqrt(nearest);
        const int k = side[0] >= side[1] ? (side[0] >= side[2] ? 0 : 2) : side[1] >= side[2] ? 1 : 2;
        if (side[k] <= SIZE * fmax(nearest, T->smooth) || n + 2 > MOST_WAITING) {
            for (int q = 0; q < POINTS_OF_CONE; q++) {
                double on[3], away[3], load[1], stored[1];
                const double at = q == 6 ? 1.0 / 3 : CONE_AT[q / 3];
                for (int i = 0; i < 3; i++)
                    on[i] = at * (now.at[0][i] + now.at[1][i] + now.at[2][i]) + (1 - 3 * at) * now.at[q % 3][i];
                vector_at(cone->away, on, away);
                const double r = sqrt(dot3(away, away)), one = 1;
                const double area = now.part * CONE_WEIGHT[q / 3];
                contact_vertex(T->law, area, r, load, stored);
                pull(T, on, force, &one, 1, load[0] / r, away);
                if (area > 0) stiffen(T, on, force, &one, 1, contact_vertex_stiffness(T->law, area, r));
                energy += stored[0];
            }
        } else if (nearest - side[k] < T->within) {
            const int a = (k + 1) % 3, b = (k + 2) % 3;
            now.part *= 0.5;
            waiting[n] = waiting[n + 1] = now;
            mixed3(now.at[a], now.at[b], 0.5, waiting[n].at[b]);
            memcpy(waiting[n + 1].at[a], waiting[n].at[b], sizeof now.at[a]);
            n += 2;
        }
    }
    return energy;
}

/* What acts where the index is not zero in a part of T, cut by spokes from number j on; `towards` has a bit of each
 * spoke on the side of x.  Energy. */
static double in_part(const Triangle *T, const Cone *cone, const Polygon *p, int j, uint32_t towards,
                      double *const force[1])
{
    for (; j < cone->n; j++) {
        int above = 0, below = 0;
        for (int k = 0; k < p->n; k++) {
            const double value = dot3(p->at[k], cone->value[j]);
            above |= value > 0;
            below |= value < 0;
        }
        if (above && below) {
            Polygon one, other;
            one.n = other.n = p->n;
            memcpy(one.at, p->at, sizeof p->at[0] * (size_t)p->n);
            memcpy(other.at, p->at, sizeof p->at[0] * (size_t)p->n);
            clip(&one, cone->value[j], 1);
            clip(&other, cone->value[j], -1);
            return (one.n > 2 ? in_part(T, cone, &one, j + 1, towards | (uint32_t)1 << j, force) : 0)
                + (other.n > 2 ? in_part(T, cone, &other, j + 1, towards, force) : 0);
        }
        towards |= (uint32_t)above << j;
    }
    int index = 1;
    for (int k = 0; k < cone->n; k++) index -= (towards >> k & 1) && !(towards >> (k + 1 < cone->n ? k + 1 : 0) & 1);
    if (!index) return 0;
    double side = 0, energy = 0;
    for (int k = 0; k < p->n; k++) side += dot3(p->at[k], cone->outward);
    if (side <= 0) return 0;
    for (int k = 0; k + 2 < p->n; k++) {
        double corner[3][3];
        memcpy(corner[0], p->at[0], sizeof corner[0]);
        memcpy(corner[1], p->at[k + 1], 2 * sizeof corner[0]);
        energy += on_cone(T, cone, corner, index * fan(p, k) * T->area, force);
    }
    return energy;
}

/* What acts on the points of T in the cones over a vertex.  Energy. */
static double beside_vertex3(const Triangle *T, const Vertex *v, double *const force[1])
{
    Cone cone;
    if (!find_cone(T, v, &cone)) return 0;
    Polygon p;
    whole(&p);
    if (!v->bent) return in_part(T, &cone, &p, 0, 0, force);
    for (int j = 0; j < v->n && p.n > 2; j++) clip(&p, cone.value[j], v->bent);
    return p.n > 2 ? in_part(T, &cone, &p, v->n, v->bent > 0 ? ~(uint32_t)0 : 0, force) : 0;
}
