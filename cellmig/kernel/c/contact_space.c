/* F_cc of equation (2) in space: adhesion between cells, of each triangle to the outside of the other surfaces. */

enum { IN_FACE = sizeof(Face) / sizeof(double), IN_EDGE = sizeof(Edge3) / sizeof(double),
       IN_VERTEX = sizeof(Vertex) / sizeof(double) };

/* Sizes of the frames of faces, edges and vertices, in numbers. */
void contact_sizes(const KernelData *s, double out[3])
{
    out[0] = IN_FACE;
    out[1] = IN_EDGE;
    out[2] = IN_VERTEX;
}

static inline const double *contact_place(const KernelData *s, long m) { return s->contact_x + D * m; }
static inline double *contact_load(const KernelData *s, long m) { return s->contact_force + (D + 1) * m; }

/* The frames of faces, edges and vertices near another cell: of all, or of those in use. */
static void set_frames(const KernelData *s, int all)
{
    for (long k = 0; k < s->n_contact_faces; k++) {
        if (!all && !s->face_used[k]) continue;
        const double *x[3];
        for (int i = 0; i < 3; i++) x[i] = contact_place(s, s->contact_face[3 * k + i]);
        *((Face *)s->face_frame + k) = face_of(x);
    }
    for (long k = 0; k < s->n_contact_edges; k++) {
        if (!all && !s->side_used[k]) continue;
        const double *x[4];
        for (int i = 0; i < 4; i++) x[i] = contact_place(s, s->contact_side[4 * k + i]);
        *((Edge3 *)s->edge_frame + k) = edge_of(x);
    }
    for (long k = 0; k < s->n_contact_vertices; k++) {
        if (!all && !s->vertex_used[k]) continue;
        const double *ring[MOST_SPOKES];
        const long first = s->first_ring[k], n = s->first_ring[k + 1] - first;
        for (long j = 0; j < n; j++) ring[j] = contact_place(s, s->contact_ring[first + j]);
        *((Vertex *)s->vertex_frame + k) = vertex_of(contact_place(s, s->contact_vertex[k]), ring, (int)n);
    }
}

/* Triangle k of those near another cell. */
static Triangle triangle_at(const KernelData *s, long k)
{
    const int32_t *node = s->contact_segment + 3 * k;
    Triangle T = {s->contact + CONTACT_STRIDE * s->contact_law[k] + 1, s->contact_cutoff[k], s->contact_smooth[k],
                  s->contact_length[k], {0}, {0}};
    for (int i = 0; i < 3; i++) {
        T.x[i] = contact_place(s, node[i]);
        T.force[i] = contact_load(s, node[i]);
    }
    return T;
}

/* Whether a node has moved far since the last list. */
static int moved_far(const KernelData *s)
{
    double moved = 0;
    for (long m = 0; m < s->n_contact_nodes; m++) {
        double from[3];
        less3(contact_place(s, m), s->listed_x + D * m, from);
        const double square = dot3(from, from);
        moved = square <= moved ? moved : square; /* also if it is not a number */
    }
    return !(moved < 0.25 * s->contact_margin * s->contact_margin);
}

/* Lists the features that may act, of which all frames are set. */
static void list_features(const KernelData *s)
{
    memset(s->face_used, 0, sizeof(int32_t) * (size_t)s->n_contact_faces);
    memset(s->side_used, 0, sizeof(int32_t) * (size_t)s->n_contact_edges);
    memset(s->vertex_used, 0, sizeof(int32_t) * (size_t)s->n_contact_vertices);
    memcpy(s->listed_x, s->contact_x, sizeof(double) * D * (size_t)s->n_contact_nodes);
    long n[3] = {0};
    for (long k = 0; k < s->n_contact_segments; k++) {
        const Triangle T = triangle_at(s, k);
        const Ball ball = ball_around(&T);
        s->listed_face_from[k] = n[0];
        for (long m = s->first_face[k]; m < s->first_face[k + 1]; m++)
            if (face_may_act(&T, (const Face *)s->face_frame + s->near_face[m], s->contact_margin))
                s->face_used[s->listed_face[n[0]++] = s->near_face[m]] = 1;
        s->listed_side_from[k] = n[1];
        for (long m = s->first_side[k]; m < s->first_side[k + 1]; m++)
            if (edge_may_act(&T, &ball, (const Edge3 *)s->edge_frame + s->near_side[m], s->contact_margin))
                s->side_used[s->listed_side[n[1]++] = s->near_side[m]] = 1;
        s->listed_vertex_from[k] = n[2];
        for (long m = s->first_vertex[k]; m < s->first_vertex[k + 1]; m++)
            if (vertex_may_act(&T, &ball, (const Vertex *)s->vertex_frame + s->near_vertex[m], s->contact_margin))
                s->vertex_used[s->listed_vertex[n[2]++] = s->near_vertex[m]] = 1;
    }
    s->listed_face_from[s->n_contact_segments] = n[0];
    s->listed_side_from[s->n_contact_segments] = n[1];
    s->listed_vertex_from[s->n_contact_segments] = n[2];
}

/* What the features near triangle k of those near another cell do.  Energy. */
static double add_triangle(const KernelData *s, long k)
{
    const Triangle T = triangle_at(s, k);
    double energy = 0;
    int pierced = 0;
    for (long n = s->listed_face_from[k]; n < s->listed_face_from[k + 1]; n++) {
        const int32_t *of = s->contact_face + 3L * s->listed_face[n];
        double *force[3] = {contact_load(s, of[0]), contact_load(s, of[1]), contact_load(s, of[2])};
        energy += over_face(&T, (const Face *)s->face_frame + s->listed_face[n], force, &pierced);
    }
    for (long n = s->listed_side_from[k]; n < s->listed_side_from[k + 1]; n++) {
        const int32_t *of = s->contact_side + 4L * s->listed_side[n];
        double *force[2] = {contact_load(s, of[0]), contact_load(s, of[1])};
        energy += beside_edge3(&T, (const Edge3 *)s->edge_frame + s->listed_side[n], force);
    }
    for (long n = s->listed_vertex_from[k]; n < s->listed_vertex_from[k + 1]; n++) {
        double *force[1] = {contact_load(s, s->contact_vertex[s->listed_vertex[n]])};
        energy += beside_vertex3(&T, (const Vertex *)s->vertex_frame + s->listed_vertex[n], force);
    }
    if (pierced) *s->stiffest_contact = INFINITY;
    return energy;
}

/* Forces; energies by the first corners of the triangles, if asked for; the impulses of a time dt on a particle by the
 * other cell, which gets the opposite. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    memset(s->contact_force, 0, sizeof(double) * (D + 1) * (size_t)s->n_contact_nodes);
    for (long m = 0; m < s->n_contact_nodes; m++) {
        for (int c = 0; c < D; c++) s->contact_x[D * m + c] = coordinate(s, s->contact_node[m], c);
        s->stiffness_of_contact[s->contact_node[m]] = 0;
    }
    const int anew = moved_far(s);
    set_frames(s, anew);
    if (anew) list_features(s);
    for (long k = 0; k < s->n_contact_segments; k++) {
        const double stored = add_triangle(s, k);
        if (energy) energy[s->contact_node[s->contact_segment[3 * k]]] += stored;
    }
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
