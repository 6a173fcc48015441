/* F_cc of equation (2) in space: adhesion between cells, of each triangle to the outside of the other surfaces. */

enum { IN_FACE = sizeof(Face) / sizeof(double), IN_EDGE = sizeof(Edge3) / sizeof(double),
       IN_VERTEX = sizeof(Vertex) / sizeof(double) };

enum { LOOKAHEAD = 10 }; /* steps for which lists of what may act are made */

/* Sizes of the frames of faces, edges and vertices, in numbers. */
void contact_sizes(const KernelData *s, double out[3])
{
    out[0] = IN_FACE;
    out[1] = IN_EDGE;
    out[2] = IN_VERTEX;
}

static inline const double *contact_place(const KernelData *s, long m) { return s->contact_x + D * m; }
static inline double *contact_load(const KernelData *s, long m) { return s->contact_force + (D + 1) * m; }

/* The frames of the faces, edges and vertices that may act. */
static void set_frames(const KernelData *s)
{
    for (long k = 0; k < s->n_contact_faces; k++) {
        if (!s->face_used[k]) continue;
        const double *x[3];
        for (int i = 0; i < 3; i++) x[i] = contact_place(s, s->contact_face[3 * k + i]);
        set_face((Face *)s->face_frame + k, x);
    }
    for (long k = 0; k < s->n_contact_edges; k++) {
        if (!s->side_used[k]) continue;
        const double *x[4];
        for (int i = 0; i < 4; i++) x[i] = contact_place(s, s->contact_side[4 * k + i]);
        set_edge((Edge3 *)s->edge_frame + k, x);
    }
    for (long k = 0; k < s->n_contact_vertices; k++) {
        if (!s->vertex_used[k]) continue;
        const double *ring[MOST_SPOKES];
        const long first = s->first_ring[k], n = s->first_ring[k + 1] - first;
        for (long j = 0; j < n; j++) ring[j] = contact_place(s, s->contact_ring[first + j]);
        set_vertex((Vertex *)s->vertex_frame + k, contact_place(s, s->contact_vertex[k]), ring, (int)n);
    }
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

/* Lists those of the features near each triangle that may act before nodes have gone `until`, and marks them. */
static void list_kind(long triangles, const long *first, const int32_t *near, const double *rests, double until,
                      long *from, int32_t *listed, int32_t *used)
{
    long n = 0;
    for (long k = 0; k < triangles; k++) {
        from[k] = n;
        for (long m = first[k]; m < first[k + 1]; m++) {
            listed[n] = (int32_t)m;
            const int soon = !(rests[m] > until);
            used[near[m]] |= soon;
            n += soon;
        }
    }
    from[triangles] = n;
}

/* The same of all kinds. */
static void list_features(const KernelData *s, double until)
{
    const long n = s->n_contact_segments;
    memset(s->face_used, 0, sizeof(int32_t) * (size_t)s->n_contact_faces);
    memset(s->side_used, 0, sizeof(int32_t) * (size_t)s->n_contact_edges);
    memset(s->vertex_used, 0, sizeof(int32_t) * (size_t)s->n_contact_vertices);
    list_kind(n, s->first_face, s->near_face, s->face_rest, until, s->listed_face_from, s->listed_face, s->face_used);
    list_kind(n, s->first_side, s->near_side, s->side_rest, until, s->listed_side_from, s->listed_side, s->side_used);
    list_kind(n, s->first_vertex, s->near_vertex, s->vertex_rest, until, s->listed_vertex_from, s->listed_vertex,
              s->vertex_used);
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

/* What the faces do that may act when nodes have gone so far. */
static int add_faces(const KernelData *s, double gone, double *energy)
{
    FacePieces found;
    found.n = found.pierced = 0;
    found.law = 0;
    for (long k = 0; k < s->n_contact_segments; k++) {
        const long first = s->listed_face_from[k], end = s->listed_face_from[k + 1];
        if (first == end) continue;
        const Triangle T = triangle_at(s, k, energy);
        for (long n = first; n < end; n++) {
            const long m = s->listed_face[n];
            if (s->face_rest[m] > gone) continue;
            const int32_t *of = s->contact_face + 3L * s->near_face[m];
            double *force[3] = {contact_load(s, of[0]), contact_load(s, of[1]), contact_load(s, of[2])};
            const double rest = over_face(&T, (const Face *)s->face_frame + s->near_face[m], force, &found);
            if (rest > 0) s->face_rest[m] = gone + rest;
        }
    }
    act_on_faces(&found);
    return found.pierced;
}

/* The same of edges. */
static void add_edges(const KernelData *s, double gone, double *energy)
{
    Lines found;
    found.n = 0;
    found.law = 0;
    for (long k = 0; k < s->n_contact_segments; k++) {
        const long first = s->listed_side_from[k], end = s->listed_side_from[k + 1];
        if (first == end) continue;
        const Triangle T = triangle_at(s, k, energy);
        for (long n = first; n < end; n++) {
            const long m = s->listed_side[n];
            if (s->side_rest[m] > gone) continue;
            const int32_t *of = s->contact_side + 4L * s->near_side[m];
            double *force[2] = {contact_load(s, of[0]), contact_load(s, of[1])};
            const double rest = beside_edge3(&T, (const Edge3 *)s->edge_frame + s->near_side[m], force, &found);
            if (rest > 0) s->side_rest[m] = gone + rest;
        }
    }
    act_on_lines(&found);
}

/* The same of vertices. */
static void add_vertices(const KernelData *s, double gone, double *energy)
{
    Points found;
    found.n = 0;
    found.law = 0;
    for (long k = 0; k < s->n_contact_segments; k++) {
        const long first = s->listed_vertex_from[k], end = s->listed_vertex_from[k + 1];
        if (first == end) continue;
        const Triangle T = triangle_at(s, k, energy);
        const Ball ball = ball_around(&T);
        for (long n = first; n < end; n++) {
            const long m = s->listed_vertex[n];
            if (s->vertex_rest[m] > gone) continue;
            const Vertex *v = (const Vertex *)s->vertex_frame + s->near_vertex[m];
            double *force = contact_load(s, s->contact_vertex[s->near_vertex[m]]);
            const double rest = beside_vertex3(&T, &ball, v, force, &found);
            if (rest > 0) s->vertex_rest[m] = gone + rest;
        }
    }
    act_on_points(&found);
}

/* Forces; energies by the first corners of the triangles, if asked for; the impulses of a time dt on a particle by the
 * other cell, which gets the opposite.  A feature that cannot act on a triangle rests until nodes have gone far enough:
 * so it adds no bit. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    memset(s->contact_force, 0, sizeof(double) * (D + 1) * (size_t)s->n_contact_nodes);
    for (long m = 0; m < s->n_contact_nodes; m++) s->stiffness_of_contact[s->contact_node[m]] = 0;
    double *gone = s->contact_gone; /* and that up to which lists hold, and the last step */
    const double step = follow_nodes(s);
    gone[0] += step;
    if (!(gone[0] <= gone[1])) {
        gone[1] = gone[0] + LOOKAHEAD * d_minimum(step, gone[2]);
        list_features(s, gone[1]);
    }
    gone[2] = step;
    set_frames(s);
    if (add_faces(s, gone[0], energy)) *s->stiffest_contact = INFINITY;
    add_edges(s, gone[0], energy);
    add_vertices(s, gone[0], energy);
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
