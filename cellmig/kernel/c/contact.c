/* F_cc of equation (2): adhesion between cells, each surface to the polyline of the other. */

/* Closest point on another cell's surface: signed gap, normal, segment a-b, share t of the way from a to b. */
typedef struct { double gap, n[D], t; long a, b; } ClosestPoint;

static inline void position(const KernelData *s, long i, double x[D])
{
    for (int c = 0; c < D; c++) x[c] = coordinate(s, i, c);
}

/* Adds the outward normal of the segment i-j. */
static inline void add_normal(const KernelData *s, long i, long j, double n[D])
{
    double a[D], b[D];
    position(s, i, a);
    position(s, j, b);
    const double x = b[1] - a[1], y = a[0] - b[0], r = 1 / sqrt(x * x + y * y);
    n[0] += x * r;
    n[1] += y * r;
}

/* The closest point to node m among its candidates. */
static void find_closest_point(const KernelData *s, long m, ClosestPoint *closest)
{
    double x[D], away[D] = {0, 0}, least = INFINITY;
    long at = -1;
    position(s, s->contact_node[m], x);
    for (long k = s->first_candidate[m]; k < s->first_candidate[m + 1]; k++) {
        const int32_t *c = s->candidate + 4 * k; /* particles before, start, end, after */
        double start[D], end[D], t, d[D], square;
        position(s, c[1], start);
        position(s, c[2], end);
        contact_closest(s->contact, x, start, end, &t, d, &square);
        if (square < least) {
            least = square;
            at = k;
            closest->t = t;
            memcpy(away, d, sizeof away);
        }
    }
    closest->gap = INFINITY;
    if (at < 0) return;
    const int32_t *c = s->candidate + 4 * at;
    double n[D] = {0, 0};
    add_normal(s, c[1], c[2], n);
    if (closest->t == 0) add_normal(s, c[0], c[1], n);
    if (closest->t == 1) add_normal(s, c[2], c[3], n);
    closest->a = c[1];
    closest->b = c[2];
    /* Beyond the cutoff, of a thin body only the back may be listed: a point behind that is not inside. */
    const int inside = away[0] * n[0] + away[1] * n[1] < 0 && sqrt(least) < s->contact_cutoff;
    contact_gap(s->contact, inside ? -1 : 1, away, least, &closest->gap, closest->n);
    if (least == 0) memcpy(closest->n, n, sizeof n);
}

/* Forces; energies by the first ends of the segments, if asked for; the impulses of a time dt on a particle by the
 * other cell, which gets the opposite.  Half of the energy is that of either surface. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    ClosestPoint *closest = s->closest_point;
    for (long m = 0; m < s->n_contact_nodes; m++) {
        find_closest_point(s, m, closest + m);
        if (closest[m].gap < s->least_gap[1]) s->least_gap[1] = closest[m].gap;
        s->contact_pull[m] = 0;
    }
    for (long e = 0; e < s->n_contact_segments; e++) {
        const long i = s->contact_segment[2 * e], j = s->contact_segment[2 * e + 1];
        const double gap1 = closest[i].gap, gap2 = closest[j].gap;
        if (!(gap1 < s->contact_cutoff || gap2 < s->contact_cutoff) || isinf(gap1) || isinf(gap2)) continue;
        double pull[2], stored;
        contact_segment(s->contact, s->contact_length[e], gap1, gap2, pull, &stored);
        s->contact_pull[i] += pull[0];
        s->contact_pull[j] += pull[1];
        if (energy) energy[s->contact_node[i]] += stored;
    }
    for (long m = 0; m < s->n_contact_nodes; m++) {
        if (s->contact_pull[m] == 0) continue;
        const long node[3] = {s->contact_node[m], closest[m].a, closest[m].b};
        double f[3][D];
        contact_spread(s->contact, s->contact_pull[m], closest[m].n, closest[m].t, f);
        for (int c = 0; c < D; c++) {
            for (int k = 0; k < 3; k++) force[D * node[k] + c] += f[k][c];
            s->contact_impulse[D * s->contact_slot[m] + c] += dt * f[0][c];
        }
    }
}
