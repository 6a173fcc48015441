/* F_cc of equation (2): adhesion between cells, of each segment to the outside of the other outlines. */

/* The widest piece of a quadrature beside a vertex, over its distance: errors are 1e-9. */
static const double WIDEST = 0.35;

/* A segment S between two nodes of contact, of which a piece acts on an edge or a vertex of another outline. */
typedef struct { const double *law; double length, end[2][D]; } Source;

/* Whether a value that goes linearly from a to b is negative all the way. */
static inline int negative(double a, double b) { return a < 0 && b < 0; }

/* Adds a force on a node, and a stiffness to those of its neighbours in the tangent. */
static inline void act(const KernelData *s, long m, const double f[D], double stiffness)
{
    for (int c = 0; c < D; c++) s->contact_force[D * m + c] += f[c];
    s->contact_stiffness[m] += stiffness;
}

/* The piece of S beside the edge a-b, on its outer side; `share` and `gap` are those of the ends of S.  Energy. */
static double add_edge(const KernelData *s, const Source *S, const long node[2], long a, long b, const double share[2],
                       const double gap[2], double cutoff)
{
    double low = 0, high = 1, f[4][D], stored;
    contact_part(S->law, low, high, share[0], share[1], &low, &high);
    contact_part(S->law, low, high, 1 - share[0], 1 - share[1], &low, &high);
    if (!(low < high)) return 0;
    const double there[2] = {gap[0] + low * (gap[1] - gap[0]), gap[0] + high * (gap[1] - gap[0])};
    if (there[0] <= 0 && there[1] <= 0) return 0;
    if (there[0] < 0 || there[1] < 0) *s->stiffest_contact = INFINITY; /* S crosses the edge */
    contact_part(S->law, low, high, gap[0], gap[1], &low, &high);
    contact_part(S->law, low, high, cutoff - gap[0], cutoff - gap[1], &low, &high);
    if (!(low < high)) return 0;
    contact_edge(S->law, S->length, low, high, share[0], share[1], gap[0], gap[1], s->contact_x + D * a,
                 s->contact_x + D * b, f, &stored);
    const double k = contact_edge_stiffness(S->law, S->length, low, high, gap[0], gap[1]);
    const double middle = 0.5 * (low + high), t = share[0] + middle * (share[1] - share[0]);
    act(s, node[0], f[0], (1 - middle) * k);
    act(s, node[1], f[1], middle * k);
    act(s, a, f[2], (1 - t) * k);
    act(s, b, f[3], t * k);
    return stored;
}

/* The part of S from low to high beside the vertex b, in pieces that are short beside their distance.  Energy. */
static double add_vertex(const KernelData *s, const Source *S, const long node[2], long b, double sign, double low,
                         double high, double cutoff)
{
    const double *v = s->contact_x + D * b;
    const double x1[D] = {S->end[0][0] - v[0], S->end[0][1] - v[1]}, x2[D] = {S->end[1][0] - v[0], S->end[1][1] - v[1]};
    const double dx = x2[0] - x1[0], dy = x2[1] - x1[1];
    double foot, away;
    contact_foot(S->law, S->end[0], S->end[1], v, &foot, &away);
    const double reach = cutoff * cutoff / (dx * dx + dy * dy) - away * away;
    if (reach <= 0) return 0;
    low = d_maximum(low, foot - sqrt(reach));
    high = d_minimum(high, foot + sqrt(reach));
    double energy = 0;
    for (double from = low, to; from < high; from = to) {
        /* The next piece: its width goes with the distance, which is least at the closest point. */
        const double r = sqrt(away * away + (from - foot) * (from - foot));
        to = from + (from < foot ? WIDEST / (1 + WIDEST) : WIDEST) * r;
        if (from < foot && to > foot) to = foot + d_minimum(to - foot, 0.5 * WIDEST * away);
        if (!(to < high && to > from)) to = high;
        double f[3][D], stored;
        contact_vertex(S->law, sign * S->length, from, to, x1, x2, f, &stored);
        const double k = contact_vertex_stiffness(S->law, sign * S->length, from, to, x1, x2);
        const double middle = 0.5 * (from + to);
        act(s, node[0], f[0], (1 - middle) * k);
        act(s, node[1], f[1], middle * k);
        act(s, b, f[2], k);
        energy += stored;
    }
    return energy;
}

/* Forces; energies by the first ends of the segments, if asked for; the impulses of a time dt on a particle by the
 * other cell, which gets the opposite. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    double *x = s->contact_x;
    for (long m = 0; m < s->n_contact_nodes; m++) {
        const long i = s->contact_node[m];
        for (int c = 0; c < D; c++) x[D * m + c] = coordinate(s, i, c), s->contact_force[D * m + c] = 0;
        s->contact_stiffness[m] = 0;
    }
    for (long k = 0; k < s->n_contact_segments; k++) {
        const long node[2] = {s->contact_segment[2 * k], s->contact_segment[2 * k + 1]};
        Source S = {s->contact + CONTACT_STRIDE * s->contact_law[k] + 1, s->contact_length[k], {{0}}};
        const double cutoff = s->contact_cutoff[k];
        memcpy(S.end, (double[2][D]){{x[D * node[0]], x[D * node[0] + 1]}, {x[D * node[1]], x[D * node[1] + 1]}},
               sizeof S.end);
        double stored = 0;
        for (long n = s->first_edge[k]; n < s->first_edge[k + 1]; n++) {
            const int32_t *e = s->contact_edge + 3 * n; /* start and end of the edge, end of the next */
            double share[2], gap[2], next[2], ignored;
            for (int i = 0; i < 2; i++) contact_beside(S.law, S.end[i], x + D * e[0], x + D * e[1], &share[i], &gap[i]);
            if (!negative(share[0], share[1]) && !negative(1 - share[0], 1 - share[1])
                && !negative(cutoff - gap[0], cutoff - gap[1]))
                stored += add_edge(s, &S, node, e[0], e[1], share, gap, cutoff);
            const double *b = x + D * e[1], *c = x + D * e[2], sign = contact_sign(S.law, x + D * e[0], b, c);
            for (int i = 0; i < 2; i++) contact_beside(S.law, S.end[i], b, c, &next[i], &ignored);
            double low = 0, high = 1;
            contact_part(S.law, low, high, sign * (share[0] - 1), sign * (share[1] - 1), &low, &high);
            contact_part(S.law, low, high, -sign * next[0], -sign * next[1], &low, &high);
            if (low < high) stored += add_vertex(s, &S, node, e[1], sign, low, high, cutoff);
        }
        if (energy) energy[s->contact_node[node[0]]] += stored;
    }
    for (long m = 0; m < s->n_contact_nodes; m++) s->stiffness_of_contact[s->contact_node[m]] = 0;
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
