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

/* The frames of all faces, edges and vertices near another cell. */
static void set_frames(const KernelData *s)
{
    for (long k = 0; k < s->n_contact_faces; k++) {
        const double *x[3];
        for (int i = 0; i < 3; i++) x[i] = contact_place(s, s->contact_face[3 * k + i]);
        *((Face *)s->face_frame + k) = face_of(x);
    }
    for (long k = 0; k < s->n_contact_edges; k++) {
        const double *x[4];
        for (int i = 0; i < 4; i++) x[i] = contact_place(s, s->contact_side[4 * k + i]);
        *((Edge3 *)s->edge_frame + k) = edge_of(x);
    }
    for (long k = 0; k < s->n_contact_vertices; k++) {
        const double *ring[MOST_SPOKES];
        const long first = s->first_ring[k], n = s->first_ring[k + 1] - first;
        for (long j = 0; j < n; j++) ring[j] = contact_place(s, s->contact_ring[first + j]);
        *((Vertex *)s->vertex_frame + k) = vertex_of(contact_place(s, s->contact_vertex[k]), ring, (int)n);
    }
}

/* What the features near triangle k of those near another cell do.  Energy. */
static double add_triangle(const KernelData *s, long k)
{
    const int32_t *node = s->contact_segment + 3 * k;
    Triangle T = {s->contact + CONTACT_STRIDE * s->contact_law[k] + 1, s->contact_cutoff[k], s->contact_smooth[k],
                  s->contact_length[k], {0}, {0}};
    for (int i = 0; i < 3; i++) {
        T.x[i] = contact_place(s, node[i]);
        T.force[i] = contact_load(s, node[i]);
    }
    double energy = 0;
    int pierced = 0;
    for (long n = s->first_face[k]; n < s->first_face[k + 1]; n++) {
        const int32_t *of = s->contact_face + 3L * s->near_face[n];
        double *force[3] = {contact_load(s, of[0]), contact_load(s, of[1]), contact_load(s, of[2])};
        energy += over_face(&T, (const Face *)s->face_frame + s->near_face[n], force, &pierced);
    }
    for (long n = s->first_side[k]; n < s->first_side[k + 1]; n++) {
        const int32_t *of = s->contact_side + 4L * s->near_side[n];
        double *force[2] = {contact_load(s, of[0]), contact_load(s, of[1])};
        energy += beside_edge3(&T, (const Edge3 *)s->edge_frame + s->near_side[n], force);
    }
    for (long n = s->first_vertex[k]; n < s->first_vertex[k + 1]; n++) {
        double *force[1] = {contact_load(s, s->contact_vertex[s->near_vertex[n]])};
        energy += beside_vertex3(&T, (const Vertex *)s->vertex_frame + s->near_vertex[n], force);
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
    set_frames(s);
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
