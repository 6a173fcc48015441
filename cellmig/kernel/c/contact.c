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

static inline const double *contact_load(const KernelData *s, long m) { return s->contact_force + D * m; }

/* Adds a force on a node, and to the sum of its row of the tangent. */
static inline void act(const KernelData *s, long m, const double f[D], double stiffness)
{
    for (int c = 0; c < D; c++) s->contact_force[D * m + c] += f[c];
    s->contact_stiffness[m] += stiffness;
}

/* Whether what is between two gaps is behind an edge; on all of it, at no gap, it is not yet. */
static inline int behind(const double gap[2]) { return gap[0] <= 0 && gap[1] <= 0 && gap[0] + gap[1] < 0; }

/* Sets the range of the piece of S beside an edge, on its outer side; whether there is one. */
static inline int piece_beside(const KernelData *s, const Source *S, const Edge *e, double range[2])
{
    const double *g = e->across, far = S->cutoff * S->cutoff * e->square;
    if (behind(g) || (g[0] > 0 && g[1] > 0 && g[0] * g[0] > far && g[1] * g[1] > far)) return 0;
    const double before[2] = {e->square - e->along[0], e->square - e->along[1]};
    if (!(before[0] > 0 || before[1] > 0)) return 0; /* the border with the next edge belongs to that */
    if (!positive(S, e->along[0], e->along[1], range) || !positive(S, before[0], before[1], range)) return 0;
    const double gap[2] = {g[0] + range[0] * (g[1] - g[0]), g[0] + range[1] * (g[1] - g[0])};
    if (behind(gap)) return 0;
    if (gap[0] < 0 || gap[1] < 0) { /* S crosses the edge */
        *s->stiffest_contact = INFINITY;
        *s->deepest_contact = d_maximum(*s->deepest_contact, -d_minimum(gap[0], gap[1]) / sqrt(e->square));
    }
    if (!positive(S, g[0], g[1], range)) return 0;
    if (g[0] * g[0] > far || g[1] * g[1] > far) return positive(S, sqrt(far) - g[0], sqrt(far) - g[1], range);
    return 1;
}

/* The piece of S beside an edge.  Energy. */
static double add_edge(const KernelData *s, const Source *S, const Edge *e)
{
    double range[2] = {0, 1};
    if (!piece_beside(s, S, e, range)) return 0;
    const double *g = e->across, *a = s->contact_x + D * e->start, *b = s->contact_x + D * e->end;
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

/* A short piece of S beside a vertex, by four Gauss points.  Energy, if asked for. */
static double add_vertex_piece(const KernelData *s, const Source *S, long vertex, double length, double low,
                               double high, const double end[2][D], int with_energy)
{
    static const v4 at = {0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263};
    static const v4 weight = {0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693};
    const v4 end1[D] = {splat(end[0][0]), splat(end[0][1])}, end2[D] = {splat(end[1][0]), splat(end[1][1])};
    const v4 size = splat(length * (high - low)) * weight, share = splat(low) + splat(high - low) * at;
    v4 f[4];
    contact_vertex_force(S->law, size, share, end1, end2, &f[0], &f[1], &f[2], &f[3]);
    const double f1[D] = {sum4(f[0]), sum4(f[1])}, f2[D] = {sum4(f[2]), sum4(f[3])};
    const double fv[D] = {-f1[0] - f2[0], -f1[1] - f2[1]};
    const double k = length > 0 ? contact_vertex_stiffness(S->law, length, low, high, end[0], end[1]) : 0;
    const double xi = 0.5 * (low + high);
    act(s, S->node[0], f1, (1 - xi) * k);
    act(s, S->node[1], f2, xi * k);
    act(s, vertex, fv, k);
    return with_energy ? sum4(contact_vertex_energy(S->law, size, share, end1, end2)) : 0;
}

/* The part of S beside the vertex between two edges, in pieces short beside their distance.  Energy, if asked for. */
static double add_vertex(const KernelData *s, const Source *S, const Edge *e, const Edge *next, int with_energy)
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
        energy += add_vertex_piece(s, S, e->end, sign * S->length, from, to, end, with_energy);
    }
    return energy;
}

/* Segment k of those near another cell. */
static inline Source source_at(const KernelData *s, long k)
{
    const int32_t *node = s->contact_segment + 2 * k;
    return (Source){s->contact + CONTACT_STRIDE * s->contact_law[k] + 1, s->contact_cutoff[k], s->contact_length[k],
                    {node[0], node[1]}, {s->contact_x + D * node[0], s->contact_x + D * node[1]}};
}

/* Pairs that may act: the edge, or the vertex at its end, or both. */
enum { EDGE = 1, VERTEX = 2 };

/* What may act of a pair until a node has moved by half of the margin, by bounds of all changes. */
static int may_act(const KernelData *s, const Source *S, const Edge *e, const Edge *next)
{
    const double margin = s->contact_margin, length = sqrt(e->square), next_length = sqrt(next->square);
    int before = 1, beyond = 1, inside = 1, far = 1, misses_before = 1, misses_behind = 1;
    for (int i = 0; i < 2; i++) {
        const double *x = S->end[i], *a = s->contact_x + D * e->start, *b = s->contact_x + D * e->end;
        const double change = margin * (length + margin + hypot(x[0] - a[0], x[1] - a[1]));
        const double next_change = margin * (next_length + margin + hypot(x[0] - b[0], x[1] - b[1]));
        const double past = e->along[i] - e->square, turned = margin * (2 * length + margin);
        before &= e->along[i] < -change;
        beyond &= past > change + turned;
        inside &= e->across[i] < -change;
        far &= e->across[i] - change > S->cutoff * (length + margin);
        misses_before &= past < -change - turned && next->along[i] < -next_change;
        misses_behind &= past > change + turned && next->along[i] > next_change;
    }
    if (far) return 0;
    return EDGE * !(before || beyond || inside) + VERTEX * !(misses_before || misses_behind);
}

/* Lists the pairs that may act, if a node has moved far since the last list. */
static void list_pairs(const KernelData *s)
{
    double moved = 0;
    for (long k = 0; k < D * s->n_contact_nodes; k += D) {
        const double x = s->contact_x[k] - s->listed_x[k], y = s->contact_x[k + 1] - s->listed_x[k + 1];
        moved = x * x + y * y <= moved ? moved : x * x + y * y; /* also if it is not a number */
    }
    if (moved < 0.25 * s->contact_margin * s->contact_margin) return;
    memcpy(s->listed_x, s->contact_x, sizeof(double) * D * (size_t)s->n_contact_nodes);
    long n = 0;
    for (long k = 0; k < s->n_contact_segments; k++) {
        const Source S = source_at(s, k);
        s->first_listed[k] = n;
        for (long m = s->first_edge[k]; m < s->first_edge[k + 1]; m++) {
            const int32_t *of = s->contact_edge + 3 * m; /* start and end of the edge, end of the next */
            const Edge e = beside_edge(s, &S, of[0], of[1]), next = beside_edge(s, &S, of[1], of[2]);
            s->listed[2 * n] = (int32_t)m;
            s->listed[2 * n + 1] = may_act(s, &S, &e, &next);
            n += s->listed[2 * n + 1] != 0;
        }
    }
    s->first_listed[s->n_contact_segments] = n;
}

/* Nodes are where their particles are, without forces; lists follow. */
static void place_nodes(const KernelData *s)
{
    for (long m = 0; m < s->n_contact_nodes; m++)
        for (int c = 0; c < D; c++) {
            s->contact_x[D * m + c] = coordinate(s, s->contact_node[m], c);
            s->contact_force[D * m + c] = 0;
        }
    list_pairs(s);
}

/* Forces on nodes go to their particles; the impulses of a time dt on a particle by the other cell, which gets the
 * opposite. */
static void give_forces(const KernelData *s, double *force, double dt)
{
    for (long m = 0; m < s->n_contact_nodes; m++)
        for (int c = 0; c < D; c++) {
            const double f = s->contact_force[D * m + c];
            force[D * s->contact_node[m] + c] += f;
            s->contact_impulse[D * s->contact_slot[m] + c] += dt * f;
        }
}

/* Forces; energies by the first ends of the segments, if asked for; impulses of a time dt. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    place_nodes(s);
    for (long m = 0; m < s->n_contact_nodes; m++)
        s->contact_stiffness[m] = s->stiffness_of_contact[s->contact_node[m]] = 0;
    for (long k = 0; k < s->n_contact_segments; k++) {
        const Source S = source_at(s, k);
        double stored = 0;
        for (long n = s->first_listed[k]; n < s->first_listed[k + 1]; n++) {
            const int32_t *of = s->contact_edge + 3 * s->listed[2 * n];
            const Edge e = beside_edge(s, &S, of[0], of[1]);
            if (s->listed[2 * n + 1] & EDGE) stored += add_edge(s, &S, &e);
            if (!(s->listed[2 * n + 1] & VERTEX)) continue;
            const Edge next = beside_edge(s, &S, of[1], of[2]);
            stored += add_vertex(s, &S, &e, &next, energy != 0);
        }
        if (energy) energy[s->contact_node[S.node[0]]] += stored;
    }
    give_forces(s, force, dt);
    for (long m = 0; m < s->n_contact_nodes; m++) {
        const long i = s->contact_node[m];
        if (i >= s->n_owned) continue;
        const double k = s->stiffness_of_contact[i] += s->contact_stiffness[m] * s->inverse_mass[i];
        if (k > *s->stiffest_contact) *s->stiffest_contact = k;
    }
}
