/* What is near triangles in space: how far it goes, when it may act, and its frames. */

static const double FASTER = 3; /* how much faster nodes may become until lists of what may act are made anew */

static inline const double *contact_place(const KernelData *s, long m) { return s->contact_x + D * m; }
static inline double *contact_load(const KernelData *s, long m) { return s->contact_force + (D + 1) * m; }

/* Nothing acts on the nodes. */
static void forget_loads(const KernelData *s)
{
    memset(s->contact_force, 0, sizeof(double) * (D + 1) * (size_t)s->n_contact_nodes);
}

/* What acts on nodes goes to their particles; the impulses of a time dt on a particle by the other cell, which gets the
 * opposite. */
static void give_loads(const KernelData *s, double *force, double dt)
{
    for (long m = 0; m < s->n_contact_nodes; m++)
        for (int c = 0; c < D; c++) {
            const double f = contact_load(s, m)[c];
            force[D * s->contact_node[m] + c] += f;
            s->contact_impulse[D * s->contact_slot[m] + c] += dt * f;
        }
}

/* Places of the nodes, and how far they go, beside their mean; whether any goes faster than lists allow. */
static int follow_nodes(const KernelData *s)
{
    const long n = s->n_contact_nodes;
    double mean[D] = {0};
    int faster = 0;
    kept.by = enough(kept.by, 0, 2 * n, kept.room + 3, sizeof(double));
    for (long m = 0; m < n; m++)
        for (int c = 0; c < D; c++) mean[c] += coordinate(s, s->contact_node[m], c) - s->contact_x[D * m + c];
    for (long m = 0; m < n; m++) {
        double square = 0;
        for (int c = 0; c < D; c++) {
            const double x = coordinate(s, s->contact_node[m], c);
            const double by = x - s->contact_x[D * m + c] - mean[c] / (double)n;
            s->contact_x[D * m + c] = x;
            square += by * by;
        }
        kept.by[2 * m] = sqrt(square);
        faster |= !(kept.by[2 * m] <= kept.by[2 * m + 1]); /* also if it is not a number */
        s->contact_gone[m] += kept.by[2 * m];
    }
    return faster;
}

/* What is near triangles, by kinds of meetings: where that of each begins, until when it rests, numbers of features and
 * how far these have gone. */
typedef struct { const long *first; double *rest; const int32_t *feature; double *gone; } Near;

/* That of a kind of meetings. */
static Near near_of(const KernelData *s, int kind)
{
    if (kind == OVER_FACE) return (Near){s->first_face, s->face_rest, s->near_face, s->face_gone};
    if (kind == BESIDE_EDGE) return (Near){s->first_side, s->side_rest, s->near_side, s->side_gone};
    return (Near){s->first_vertex, s->vertex_rest, s->near_vertex, s->vertex_gone};
}

/* Adds to how far something has gone with its own node and others, and to how far it may go in some calls. */
static inline void follow(const KernelData *s, double gone[2], int32_t own, const int32_t *node, long n, double calls)
{
    double by = s->contact_gone[own], most = kept.by[2 * own + 1];
    for (long i = 0; i < n; i++) {
        by = s->contact_gone[node[i]] <= by ? by : s->contact_gone[node[i]]; /* also if it is not a number */
        most = d_maximum(most, kept.by[2 * node[i] + 1]);
    }
    gone[0] += by;
    gone[1] = gone[0] + calls * most;
}

/* How far triangles and features have gone, and may go in some calls. */
static void follow_all(const KernelData *s, double calls)
{
    double mean = 0;
    for (long m = 0; m < s->n_contact_nodes; m++) mean += kept.by[2 * m] / (double)s->n_contact_nodes;
    for (long m = 0; m < s->n_contact_nodes; m++) kept.by[2 * m + 1] = FASTER * d_maximum(kept.by[2 * m], mean);
    for (long k = 0; k < s->n_contact_segments; k++) {
        const int32_t *node = s->contact_segment + 3 * k;
        follow(s, s->triangle_gone + 2 * k, node[0], node + 1, 2, calls);
    }
    for (long k = 0; k < s->n_contact_faces; k++) {
        const int32_t *node = s->contact_face + 3 * k;
        follow(s, s->face_gone + 2 * k, node[0], node + 1, 2, calls);
    }
    for (long k = 0; k < s->n_contact_edges; k++) {
        const int32_t *node = s->contact_side + 4 * k;
        follow(s, s->side_gone + 2 * k, node[0], node + 1, 3, calls);
    }
    for (long k = 0; k < s->n_contact_vertices; k++) {
        const long first = s->first_ring[k], n = s->first_ring[k + 1] - first;
        follow(s, s->vertex_gone + 2 * k, s->contact_vertex[k], s->contact_ring + first, n, calls);
    }
    memset(s->contact_gone, 0, sizeof(double) * (size_t)s->n_contact_nodes);
}

/* In how many calls, until lists are made anew, triangle k and a feature surely go no farther than they may. */
static inline int32_t calls_of(const KernelData *s, const Near *near, long k, long feature, double rest)
{
    const double *of = s->triangle_gone + 2 * k, *other = near->gone + 2 * feature;
    return (int32_t)d_minimum(SERVE * rest / (d_maximum(of[1] - of[0], other[1] - other[0]) + 1e-300), SERVE);
}

/* Lists what may act in the coming calls, while no node goes much faster. */
static void list_what_may_act(const KernelData *s, double calls)
{
    follow_all(s, calls);
    for (long k = 0; k < s->n_contact_segments; k++) kept.serves[k].look = 0;
    for (int kind = 0; kind < MEETINGS; kind++) {
        const Near near = near_of(s, kind);
        Pieces *p = kept.of + kind;
        p->lists = 0;
        for (long k = 0; k < s->n_contact_segments; k++) {
            p->from[k] = p->lists;
            for (long m = near.first[k]; m < near.first[k + 1]; m++) {
                const double *rest = near.rest + 2 * m;
                if (s->triangle_gone[2 * k + 1] <= rest[0] && near.gone[2 * near.feature[m] + 1] <= rest[1]) continue;
                const int32_t number = meeting_of(p, k, m, near.feature[m]);
                const Meeting *of = p->meeting + number;
                p->listed[p->lists++] = (Listed){of->n ? number : ~number, of->until, 0};
            }
        }
        p->from[s->n_contact_segments] = p->lists;
    }
}

/* Whether a feature that is near triangle k may act, number m in lists. */
static inline int may_act(const KernelData *s, const Near *near, long k, long m)
{
    return !(s->triangle_gone[2 * k] <= near->rest[2 * m] && near->gone[2 * near->feature[m]] <= near->rest[2 * m + 1]);
}

/* The frame of face k near another cell, set once in call number `now`. */
static const Face *face_at(const KernelData *s, long k, int32_t now)
{
    Face *f = (Face *)s->face_frame + k;
    if (s->face_set[k] == now) return f;
    const double *x[3];
    for (int i = 0; i < 3; i++) x[i] = contact_place(s, s->contact_face[3 * k + i]);
    set_face(f, x);
    s->face_set[k] = now;
    return f;
}

/* The same of an edge. */
static const Edge3 *edge_at(const KernelData *s, long k, int32_t now)
{
    Edge3 *e = (Edge3 *)s->edge_frame + k;
    if (s->side_set[k] == now) return e;
    const double *x[4];
    for (int i = 0; i < 4; i++) x[i] = contact_place(s, s->contact_side[4 * k + i]);
    set_edge(e, x);
    s->side_set[k] = now;
    return e;
}

/* The same of a vertex. */
static const Vertex *vertex_at(const KernelData *s, long k, int32_t now)
{
    Vertex *v = (Vertex *)s->vertex_frame + k;
    if (s->vertex_set[k] == now) return v;
    const double *ring[MOST_SPOKES];
    const long first = s->first_ring[k], n = s->first_ring[k + 1] - first;
    for (long j = 0; j < n; j++) ring[j] = contact_place(s, s->contact_ring[first + j]);
    set_vertex(v, contact_place(s, s->contact_vertex[k]), ring, (int)n);
    s->vertex_set[k] = now;
    return v;
}

/* Triangle k of those near another cell; energies are by the first corners. */
static Triangle triangle_at(const KernelData *s, long k, double *energy)
{
    const int32_t *node = s->contact_segment + 3 * k;
    static double unasked;
    Triangle T = {.law = s->contact + CONTACT_STRIDE * s->contact_law[k] + 1, .within = s->contact_cutoff[k],
                  .smooth = s->contact_smooth[k], .area = s->contact_length[k],
                  .energy = energy ? energy + s->contact_node[node[0]] : &unasked};
    for (int i = 0; i < 3; i++) {
        T.x[i] = contact_place(s, node[i]);
        T.force[i] = contact_load(s, node[i]);
    }
    set_sides(&T);
    return T;
}

/* The triangles near other cells, where nodes are now. */
static const Triangle *triangles_now(const KernelData *s, double *energy)
{
    const long n = s->n_contact_segments;
    kept.triangle = enough(kept.triangle, 0, n, kept.room, sizeof(Triangle));
    for (long k = 0; k < n; k++) kept.triangle[k] = triangle_at(s, k, energy);
    return kept.triangle;
}
