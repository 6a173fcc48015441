/* F_cc of equation (2) in space: adhesion between cells, of each triangle to the outside of the other surfaces. */

enum { IN_FACE = sizeof(Face) / sizeof(double), IN_EDGE = sizeof(Edge3) / sizeof(double),
       IN_VERTEX = sizeof(Vertex) / sizeof(double) };

enum { LOOKAHEAD = 5 }; /* searches for which lists of what may act are made */

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

/* Lists for the coming searches what may act in some of them, if the last lists are not complete any more. */
static void list_what_may_act(const KernelData *s)
{
    double *gone = s->contact_gone;
    const double since = gone[0] - gone[4];
    if (!(gone[0] <= gone[1])) {
        const long n = s->n_contact_segments;
        gone[1] = gone[0] + LOOKAHEAD * d_minimum(since, gone[2]);
        list_kind(n, s->first_face, s->face_rest, gone[1], s->listed_face_from, s->listed_face);
        list_kind(n, s->first_side, s->side_rest, gone[1], s->listed_side_from, s->listed_side);
        list_kind(n, s->first_vertex, s->vertex_rest, gone[1], s->listed_vertex_from, s->listed_vertex);
    }
    gone[2] = since;
    gone[4] = gone[0];
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

/* Pieces of the three kinds, and the triangles, in a run of steps: they serve from the step in which they are found to
 * others of the same run, and no other run goes on meanwhile.  `one` : those of one feature that cannot serve. */
static struct { Triangle *triangle; long room; Pieces over_faces, beside_edges, beside_vertices, one; } found_last;

/* The triangles near other cells, where nodes are now. */
static const Triangle *triangles_now(const KernelData *s, int anew, double *energy)
{
    const long n = s->n_contact_segments;
    if (anew) found_last.triangle = enough(found_last.triangle, 0, n, &found_last.room, sizeof(Triangle));
    for (long k = 0; k < n; k++)
        if (anew) found_last.triangle[k] = triangle_at(s, k, energy);
        else set_sides(found_last.triangle + k);
    return found_last.triangle;
}

/* Finds pieces over the faces that may act, in call number `now`; how far any triangle goes through one. */
static double find_over_faces(const KernelData *s, const Triangle *T, int32_t now, Pieces *found)
{
    const double gone = s->contact_gone[0];
    double pierced = 0;
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long n = s->listed_face_from[k]; n < s->listed_face_from[k + 1]; n++) {
            const long m = s->listed_face[n], from = found->used;
            if (s->face_rest[m] > gone) continue;
            const Face *f = face_at(s, s->near_face[m], now);
            const double rest = over_face(T + k, f, found, &pierced);
            if (rest > 0) s->face_rest[m] = gone + rest;
            meet(found, k, s->near_face[m], from, f->planes.size > s->contact_serves[2]);
        }
    return pierced;
}

/* The same beside edges. */
static void find_beside_edges(const KernelData *s, const Triangle *T, int32_t now, Pieces *found)
{
    const double gone = s->contact_gone[0];
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long n = s->listed_side_from[k]; n < s->listed_side_from[k + 1]; n++) {
            const long m = s->listed_side[n], from = found->used;
            if (s->side_rest[m] > gone) continue;
            const Edge3 *e = edge_at(s, s->near_side[m], now);
            const double rest = beside_edge3(T + k, e, found);
            if (rest > 0) s->side_rest[m] = gone + rest;
            meet(found, k, s->near_side[m], from, e->planes.size > s->contact_serves[2]);
        }
}

/* The same beside vertices. */
static void find_beside_vertices(const KernelData *s, const Triangle *T, int32_t now, Pieces *found)
{
    const double gone = s->contact_gone[0];
    for (long k = 0; k < s->n_contact_segments; k++) {
        const long first = s->listed_vertex_from[k], end = s->listed_vertex_from[k + 1];
        if (first == end) continue;
        const Ball ball = ball_around(T + k);
        for (long n = first; n < end; n++) {
            const long m = s->listed_vertex[n], from = found->used;
            if (s->vertex_rest[m] > gone) continue;
            const double rest = beside_vertex3(T + k, &ball, vertex_at(s, s->near_vertex[m], now), found);
            if (rest > 0) s->vertex_rest[m] = gone + rest;
            meet(found, k, s->near_vertex[m], from, 1);
        }
    }
}

/* Room for the pieces of a meeting that have to be found; NULL where they serve. */
static Pieces *nothing_yet(const Meeting *m)
{
    found_last.one.used = 0;
    return m->from < 0 ? &found_last.one : NULL;
}

/* The pieces of a meeting, and their number. */
static const v4 *pieces_of(const Pieces *p, const Meeting *m)
{
    return m->from < 0 ? found_last.one.on : p->on + m->from;
}
static long number_of(const Meeting *m) { return m->from < 0 ? found_last.one.used : m->end - m->from; }

/* What acts over faces. */
static void act_over_faces(const KernelData *s, const Triangle *T, int32_t now, const Pieces *pieces)
{
    FacePieces waiting;
    waiting.n = 0, waiting.law = 0;
    for (const Meeting *m = pieces->meeting; m < pieces->meeting + pieces->n; m++) {
        const int32_t *of = s->contact_face + 3 * m->feature;
        double *force[3] = {contact_load(s, of[0]), contact_load(s, of[1]), contact_load(s, of[2])}, pierced = 0;
        const Face *f = face_at(s, m->feature, now);
        Pieces *one = nothing_yet(m);
        if (one) over_face(T + m->triangle, f, one, &pierced);
        act_over_face(T + m->triangle, f, force, pieces_of(pieces, m), number_of(m), &waiting);
    }
    act_on_faces(&waiting);
}

/* What acts beside edges. */
static void act_beside_edges(const KernelData *s, const Triangle *T, int32_t now, const Pieces *pieces)
{
    Lines waiting;
    waiting.n = 0, waiting.law = 0;
    for (const Meeting *m = pieces->meeting; m < pieces->meeting + pieces->n; m++) {
        const int32_t *of = s->contact_side + 4 * m->feature;
        const double *x[2] = {contact_place(s, of[0]), contact_place(s, of[1])};
        double *force[2] = {contact_load(s, of[0]), contact_load(s, of[1])};
        Pieces *one = nothing_yet(m);
        if (one) beside_edge3(T + m->triangle, edge_at(s, m->feature, now), one);
        act_beside_edge(T + m->triangle, x, force, pieces_of(pieces, m), number_of(m), &waiting);
    }
    act_on_lines(&waiting);
}

/* What acts beside vertices. */
static void act_beside_vertices(const KernelData *s, const Triangle *T, const Pieces *pieces)
{
    Points waiting;
    waiting.n = 0, waiting.law = 0;
    for (const Meeting *m = pieces->meeting; m < pieces->meeting + pieces->n; m++) {
        const int32_t of = s->contact_vertex[m->feature];
        act_beside_vertex(T + m->triangle, contact_place(s, of), contact_load(s, of), pieces_of(pieces, m),
                          number_of(m), &waiting);
    }
    act_on_points(&waiting);
}

/* Forces; energies by the first corners of the triangles, if asked for; the impulses of a time dt on a particle by the
 * other cell, which gets the opposite.  A feature that cannot act on a triangle rests until nodes have gone far enough:
 * it would add no bit.  Pieces serve for `contact_serves` steps: their places on T stay, and what they are from is
 * where it is now, so that forces are right to the first order of what slides meanwhile: derivatives of the limits of
 * pieces cancel. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    memset(s->contact_force, 0, sizeof(double) * (D + 1) * (size_t)s->n_contact_nodes);
    for (long m = 0; m < s->n_contact_nodes; m++) s->stiffness_of_contact[s->contact_node[m]] = 0;
    double *gone = s->contact_gone;
    const double step = follow_nodes(s);
    const int32_t now = (int32_t)++gone[3];
    gone[0] += step;
    const int anew = s->contact_serves[0] <= 0;
    s->contact_serves[0] = (anew ? s->contact_serves[1] : s->contact_serves[0]) - 1;
    const Triangle *T = triangles_now(s, anew, energy);
    Pieces *faces = &found_last.over_faces, *edges = &found_last.beside_edges, *vertices = &found_last.beside_vertices;
    double pierced = 0;
    if (anew) {
        list_what_may_act(s);
        faces->n = faces->used = edges->n = edges->used = vertices->n = vertices->used = 0;
        pierced = find_over_faces(s, T, now, faces);
        find_beside_edges(s, T, now, edges);
        find_beside_vertices(s, T, now, vertices);
    }
    act_over_faces(s, T, now, faces);
    act_beside_edges(s, T, now, edges);
    act_beside_vertices(s, T, vertices);
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
