/* F_cc of equation (2) in space: adhesion between cells, of each triangle to the outside of the other surfaces. */

enum { IN_FACE = sizeof(Face) / sizeof(double), IN_EDGE = sizeof(Edge3) / sizeof(double),
       IN_VERTEX = sizeof(Vertex) / sizeof(double) };

enum { LOOKAHEAD = 5 }; /* steps for which lists of what may act are made */

/* Sizes of the frames of faces, edges and vertices, in numbers. */
void contact_sizes(const KernelData *s, double out[3])
{
    out[0] = IN_FACE;
    out[1] = IN_EDGE;
    out[2] = IN_VERTEX;
}

static inline const double *contact_place(const KernelData *s, long m) { return s->contact_x + D * m; }
static inline double *contact_load(const KernelData *s, long m) { return s->contact_force + (D + 1) * m; }

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

/* Lists those of the features near each triangle that may act before nodes have gone `until`. */
static void list_kind(long triangles, const long *first, const double *rests, double until, long *from, int32_t *listed)
{
    long n = 0;
    for (long k = 0; k < triangles; k++) {
        from[k] = n;
        for (long m = first[k]; m < first[k + 1]; m++) {
            listed[n] = (int32_t)m;
            n += !(rests[m] > until);
        }
    }
    from[triangles] = n;
}

/* Lists for the coming steps what may act in some of them, after a `step` [µm], if the last lists are not complete. */
static void list_what_may_act(const KernelData *s, double step)
{
    double *gone = s->contact_gone;
    if (!(gone[0] <= gone[1])) {
        const long n = s->n_contact_segments;
        gone[1] = gone[0] + LOOKAHEAD * d_minimum(step, gone[2]);
        list_kind(n, s->first_face, s->face_rest, gone[1], s->listed_face_from, s->listed_face);
        list_kind(n, s->first_side, s->side_rest, gone[1], s->listed_side_from, s->listed_side);
        list_kind(n, s->first_vertex, s->vertex_rest, gone[1], s->listed_vertex_from, s->listed_vertex);
    }
    gone[2] = step;
}

/* Places of the nodes; how far any of them has gone since these lists began, beside their mean. */
static double follow_nodes(const KernelData *s)
{
    const long n = s->n_contact_nodes;
    double mean[D] = {0}, most = 0;
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
        most = square <= most ? most : square; /* also if it is not a number */
    }
    return sqrt(most);
}

/* The triangles near other cells, where nodes are now. */
static const Triangle *triangles_now(const KernelData *s, double *energy)
{
    const long n = s->n_contact_segments;
    kept.triangle = enough(kept.triangle, 0, n, &kept.room, sizeof(Triangle));
    for (long k = 0; k < n; k++) kept.triangle[k] = triangle_at(s, k, energy);
    return kept.triangle;
}

/* What the faces do that may act, in call number `now`; how far any triangle goes through one. */
static double add_faces(const KernelData *s, const Triangle *T, int32_t now, int serve, double dt)
{
    FacePieces waiting;
    waiting.n = 0, waiting.law = 0;
    const double gone = s->contact_gone[0];
    double pierced = 0;
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long n = s->listed_face_from[k]; n < s->listed_face_from[k + 1]; n++) {
            const long m = s->listed_face[n];
            if (s->face_rest[m] > gone) continue;
            const int32_t *of = s->contact_face + 3L * s->near_face[m];
            const Face *f = face_at(s, s->near_face[m], now);
            const int old = still_serves(&kept.faces, m, now, serve);
            if (!old) {
                const double rest = over_face(T + k, f, &kept.found, &pierced);
                if (rest > 0) s->face_rest[m] = gone + rest;
                const double least = serve ? least_gap_over(T + k, f, &kept.found) : 0;
                if (serve) keep_found(s, &kept.faces, m, k, of, 3, least, f->planes.size, dt);
            }
            const Served pieces = old ? served(&kept.faces, m) : just_found();
            double *force[3] = {contact_load(s, of[0]), contact_load(s, of[1]), contact_load(s, of[2])};
            if (pieces.n) act_over_face(T + k, f, force, pieces.on, pieces.n, &waiting);
        }
    act_on_faces(&waiting);
    return pierced;
}

/* The same of edges. */
static void add_edges(const KernelData *s, const Triangle *T, int32_t now, int serve, double dt)
{
    Lines waiting;
    waiting.n = 0, waiting.law = 0;
    const double gone = s->contact_gone[0];
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long n = s->listed_side_from[k]; n < s->listed_side_from[k + 1]; n++) {
            const long m = s->listed_side[n];
            if (s->side_rest[m] > gone) continue;
            const int32_t *of = s->contact_side + 4L * s->near_side[m];
            const double *x[2] = {contact_place(s, of[0]), contact_place(s, of[1])};
            const int old = still_serves(&kept.edges, m, now, serve);
            if (!old) {
                const Edge3 *e = edge_at(s, s->near_side[m], now);
                const double rest = beside_edge3(T + k, e, &kept.found);
                if (rest > 0) s->side_rest[m] = gone + rest;
                const double least = serve ? least_from_edge(T + k, x, &kept.found) : 0;
                if (serve) keep_found(s, &kept.edges, m, k, of, 4, least, e->planes.size, dt);
            }
            const Served pieces = old ? served(&kept.edges, m) : just_found();
            double *force[2] = {contact_load(s, of[0]), contact_load(s, of[1])};
            if (pieces.n) act_beside_edge(T + k, x, force, pieces.on, pieces.n, &waiting);
        }
    act_on_lines(&waiting);
}

/* The same of vertices. */
static void add_vertices(const KernelData *s, const Triangle *T, int32_t now, int serve, double dt)
{
    Points waiting;
    waiting.n = 0, waiting.law = 0;
    const double gone = s->contact_gone[0];
    for (long k = 0; k < s->n_contact_segments; k++) {
        const long first = s->listed_vertex_from[k], end = s->listed_vertex_from[k + 1];
        if (first == end) continue;
        const Ball ball = ball_around(T + k);
        for (long n = first; n < end; n++) {
            const long m = s->listed_vertex[n];
            if (s->vertex_rest[m] > gone) continue;
            const int32_t *of = s->contact_vertex + s->near_vertex[m];
            const double *x = contact_place(s, *of);
            const int old = still_serves(&kept.vertices, m, now, serve);
            if (!old) {
                const double rest = beside_vertex3(T + k, &ball, vertex_at(s, s->near_vertex[m], now), &kept.found);
                if (rest > 0) s->vertex_rest[m] = gone + rest;
                const double least = serve ? least_from_vertex(T + k, x, &kept.found) : 0;
                if (serve) keep_found(s, &kept.vertices, m, k, of, 1, least, INFINITY, dt);
            }
            const Served pieces = old ? served(&kept.vertices, m) : just_found();
            if (pieces.n) act_beside_vertex(T + k, x, contact_load(s, *of), pieces.on, pieces.n, &waiting);
        }
    }
    act_on_points(&waiting);
}

/* Forces; energies by the first corners of the triangles, if asked for; the impulses of a time dt on a particle by the
 * other cell, which gets the opposite.  A feature that cannot act on a triangle rests until nodes have gone far enough:
 * it would add no bit. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    memset(s->contact_force, 0, sizeof(double) * (D + 1) * (size_t)s->n_contact_nodes);
    for (long m = 0; m < s->n_contact_nodes; m++) s->stiffness_of_contact[s->contact_node[m]] = 0;
    double *gone = s->contact_gone;
    const double step = follow_nodes(s);
    const int32_t now = (int32_t)++gone[3];
    gone[0] += step;
    list_what_may_act(s, step);
    const int serve = pieces_serve(s);
    s->contact_serves[0] = 0;
    const Triangle *T = triangles_now(s, energy);
    const double pierced = add_faces(s, T, now, serve, dt);
    add_edges(s, T, now, serve, dt);
    add_vertices(s, T, now, serve, dt);
    if (pierced > 0) *s->stiffest_contact = INFINITY;
    *s->deepest_contact = d_maximum(*s->deepest_contact, pierced);
    for (long m = 0; m < s->n_contact_nodes; m++) {
        const long i = s->contact_node[m];
        const double *f = contact_load(s, m);
        for (int c = 0; c < D; c++) {
            force[D * i + c] += f[c];
            s->contact_impulse[D * s->contact_slot[m] + c] += dt * f[c];
        }
        if (i >= s->n_owned) continue;
        const double k = s->stiffness_of_contact[i] += f[D] * s->inverse_mass[i];
        if (k > *s->stiffest_contact) *s->stiffest_contact = k;
    }
}
