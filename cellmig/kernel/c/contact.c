/* F_cc of equation (2): adhesion between cells, of each segment to the outside of the other outlines. */

/* A segment S near another cell: parameters of its law, cutoff, reference length, nodes of contact at its ends. */
typedef struct { const double *law; double cutoff, length; long node[2]; const double *end[2]; } Source;

/* An edge of another outline between nodes of contact; of both ends of S the places along and across it. */
typedef struct { long start, end; double along[2], across[2], square; } Edge;

/* The edge between two nodes of contact, and S along and across it. */
static inline Edge beside_edge(const KernelData *s, const Source *S, long start, long end)
{
    const double *a = s->contact_x + D * start, *b = s->contact_x + D * end;
    Edge e = {start, end, {0}, {0}, (b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1])};
    for (int i = 0; i < 2; i++) contact_beside(S->law, S->end[i], a, b, &e.along[i], &e.across[i]);
    return e;
}

/* Cuts a range of ξ to where a value is positive that goes linearly from a to b; whether there is anything left. */
static inline int positive(const Source *S, double a, double b, double range[2])
{
    if (a < 0 && b < 0) return 0;
    if (a < 0 || b < 0) contact_part(S->law, range[0], range[1], a, b, &range[0], &range[1]);
    return range[0] < range[1];
}

/* Adds a force on a node, and to the sum of its row of the tangent. */
static inline void act(const KernelData *s, long m, const double f[D], double stiffness)
{
    for (int c = 0; c < D; c++) s->contact_force[D * m + c] += f[c];
    s->contact_stiffness[m] += stiffness;
}

/* The piece of S beside an edge, on its outer side.  Energy. */
static double add_edge(const KernelData *s, const Source *S, const Edge *e)
{
    double range[2] = {0, 1};
    const double *g = e->across, far = S->cutoff * S->cutoff * e->square;
    if ((g[0] <= 0 && g[1] <= 0) || (g[0] > 0 && g[1] > 0 && g[0] * g[0] > far && g[1] * g[1] > far)) return 0;
    const double before[2] = {e->square - e->along[0], e->square - e->along[1]};
    if (!(before[0] > 0 || before[1] > 0)) return 0; /* the border with the next edge belongs to that */
    if (!positive(S, e->along[0], e->along[1], range) || !positive(S, before[0], before[1], range)) return 0;
    const double gap[2] = {g[0] + range[0] * (g[1] - g[0]), g[0] + range[1] * (g[1] - g[0])};
    if (gap[0] <= 0 && gap[1] <= 0) return 0;
    if (gap[0] < 0 || gap[1] < 0) *s->stiffest_contact = INFINITY; /* S crosses the edge */
    if (!positive(S, g[0], g[1], range)) return 0;
    if (g[0] * g[0] > far || g[1] * g[1] > far)
        if (!positive(S, sqrt(far) - g[0], sqrt(far) - g[1], range)) return 0;
    const double *a = s->contact_x + D * e->start, *b = s->contact_x + D * e->end;
    double f[4][D], stored;
    contact_edge(S->law, S->length, range[0], range[1], e->along, g, a, b, f, &stored);
    const double k = contact_edge_stiffness(S->law, S->length, range[0], range[1], g, a, b);
    const double xi = 0.5 * (range[0] + range[1]), t = (e->along[0] + xi * (e->along[1] - e->along[0])) / e->square;
    act(s, S->node[0], f[0], (1 - xi) * k);
    act(s, S->node[1], f[1], xi * k);
    act(s, e->start, f[2], (1 - t) * k);
    act(s, e->end, f[3], t * k);
    return stored;
}

static inline double sum4(v4 x) { return (x[0] + x[1]) + (x[2] + x[3]); }

/* A short piece of S beside a vertex, by four Gauss points.  Energy. */
static double add_vertex_piece(const KernelData *s, const Source *S, long vertex, double length, double low,
                               double high, const double end[2][D])
{
    static const v4 at = {0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263};
    static const v4 weight = {0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693};
    const v4 end1[D] = {splat(end[0][0]), splat(end[0][1])}, end2[D] = {splat(end[1][0]), splat(end[1][1])};
    v4 f[4], stored;
    contact_vertex_point(S->law, splat(length * (high - low)) * weight, splat(low) + splat(high - low) * at, end1, end2,
                         &f[0], &f[1], &f[2], &f[3], &stored);
    const double f1[D] = {sum4(f[0]), sum4(f[1])}, f2[D] = {sum4(f[2]), sum4(f[3])};
    const double fv[D] = {-f1[0] - f2[0], -f1[1] - f2[1]};
    const double k = length > 0 ? contact_vertex_stiffness(S->law, length, low, high, end[0], end[1]) : 0;
    const double xi = 0.5 * (low + high);
    act(s, S->node[0], f1, (1 - xi) * k);
    act(s, S->node[1], f2, xi * k);
    act(s, vertex, fv, k);
    return sum4(stored);
}

/* The part of S beside the vertex between two edges, in pieces that are short beside their distance.  Energy. */
static double add_vertex(const KernelData *s, const Source *S, const Edge *e, const Edge *next)
{
    const double *a = s->contact_x + D * e->start, *v = s->contact_x + D * e->end, *c = s->contact_x + D * next->end;
    const double sign = (v[0] - a[0]) * (c[1] - v[1]) - (v[1] - a[1]) * (c[0] - v[0]) < 0 ? -1 : 1;
    double range[2] = {0, 1}, foot, away, energy = 0;
    const double after[2] = {sign * (e->along[0] - e->square), sign * (e->along[1] - e->square)};
    const double before[2] = {-sign * next->along[0], -sign * next->along[1]}, *open = sign > 0 ? before : after;
    if (!(open[0] > 0 || open[1] > 0)) return 0; /* as above */
    if (!positive(S, after[0], after[1], range) || !positive(S, before[0], before[1], range)) return 0;
    contact_foot(S->law, S->end[0], S->end[1], v, &foot, &away);
    const double end[2][D] = {{S->end[0][0] - v[0], S->end[0][1] - v[1]}, {S->end[1][0] - v[0], S->end[1][1] - v[1]}};
    const double dx = end[1][0] - end[0][0], dy = end[1][1] - end[0][1];
    const double reach = S->cutoff * S->cutoff / (dx * dx + dy * dy) - away * away;
    if (reach <= 0) return 0;
    const double low = d_maximum(range[0], foot - sqrt(reach)), high = d_minimum(range[1], foot + sqrt(reach));
    for (double from = low, to; from < high; from = to) {
        to = contact_short(S->law, from, foot, away);
        if (!(to < high && to > from)) to = high;
        energy += add_vertex_piece(s, S, e->end, sign * S->length, from, to, end);
    }
    return energy;
}

/* Forces; energies by the first ends of the segments, if asked for; the impulses of a time dt on a particle by the
 * other cell, which gets the opposite. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long m = 0; m < s->n_contact_nodes; m++) {
        const long i = s->contact_node[m];
        for (int c = 0; c < D; c++) {
            s->contact_x[D * m + c] = coordinate(s, i, c);
            s->contact_force[D * m + c] = 0;
        }
        s->contact_stiffness[m] = s->stiffness_of_contact[i] = 0;
    }
    for (long k = 0; k < s->n_contact_segments; k++) {
        const int32_t *node = s->contact_segment + 2 * k;
        const Source S = {s->contact + CONTACT_STRIDE * s->contact_law[k] + 1, s->contact_cutoff[k],
                          s->contact_length[k], {node[0], node[1]},
                          {s->contact_x + D * node[0], s->contact_x + D * node[1]}};
        double stored = 0;
        Edge e, next = {-1, -1, {0}, {0}, 0};
        for (long n = s->first_edge[k]; n < s->first_edge[k + 1]; n++) {
            const int32_t *of = s->contact_edge + 3 * n; /* start and end of the edge, end of the next */
            e = next.start == of[0] && next.end == of[1] ? next : beside_edge(s, &S, of[0], of[1]);
            next = beside_edge(s, &S, of[1], of[2]);
            stored += add_edge(s, &S, &e) + add_vertex(s, &S, &e, &next);
        }
        if (energy) energy[s->contact_node[node[0]]] += stored;
    }
    for (long m = 0; m < s->n_contact_nodes; m++) {
        const long i = s->contact_node[m];
        const double *f = s->contact_force + D * m;
        for (int c = 0; c < D; c++) {
            force[D * i + c] += f[c];
            s->contact_impulse[D * s->contact_slot[m] + c] += dt * f[c];
        }
        if (i >= s->n_owned) continue;
        const double k = s->stiffness_of_contact[i] += s->contact_stiffness[m] * s->inverse_mass[i];
        if (k > *s->stiffest_contact) *s->stiffest_contact = k;
    }
}
