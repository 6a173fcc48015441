/* Drag of the closed bonds between surfaces that slide along each other in space, over pieces of contact_space.c. */

/* Velocity of T along a face at their overlap, at which its closest point moves through the material of the face.
 * Bodies that move as one do not slide.  v : of the corners of T and of the face. */
static v4 velocity_along(const Face *f, const Overlap *o, const v4 v[6])
{
    v4 along = {0};
    double tilt[3] = {0};
    for (int k = 0; k < 3; k++) {
        const double out = dot4(f->normal, v[3 + k]);
        along += o->on[k] * v[k] - o->at[k] * v[3 + k];
        for (int i = 0; i < 3; i++) tilt[i] += o->at[3] * out * f->planes.slope[i][k];
    }
    return along - dot4(along, f->normal) * f->normal + (v4){tilt[0], tilt[1], tilt[2], 0};
}

/* Adds what acts where T slides over a face, by a law; the power that is lost [pN µm/µs]. */
static double slide(const double *law, const Triangle *T, const Face *f, const Overlap *o, double stored,
                    const v4 v[6], double *const force[3])
{
    const v4 w = velocity_along(f, o, v);
    double drag[3];
    sliding_drag(law, o->area, stored, (double[3]){w[0], w[1], w[2]}, drag);
    const v4 along = {drag[0], drag[1], drag[2], 0};
    drag_along(T, f, o, along, force);
    return -dot4(along, w);
}

/* Velocity of a node of contact. */
static inline v4 velocity_of(const KernelData *s, long node)
{
    const long i = s->contact_node[node];
    return (v4){velocity(s, i, 0), velocity(s, i, 1), velocity(s, i, 2), 0};
}

/* What acts in a meeting over a face, and the losses of a time dt. */
static void slide_in(const KernelData *s, const Meeting *m, double dt)
{
    const Triangle *T = kept.triangle + m->triangle;
    const Face *f = face_at(s, m->feature, *s->contact_call);
    const Overlap o = overlap_of(T, f, kept.of[OVER_FACE].on + m->from, m->n);
    if (!(o.area > 0)) return;
    const int32_t *node, *corner = s->contact_segment + 3 * m->triangle;
    const double *x[3], *law = s->sliding + SLIDING_STRIDE * s->contact_law[m->triangle] + 1;
    double *load[3];
    nodes_of(s, OVER_FACE, m->feature, &node, x, load);
    v4 v[6];
    for (int k = 0; k < 3; k++) {
        v[k] = velocity_of(s, corner[k]);
        v[3 + k] = velocity_of(s, node[k]);
    }
    const double stored = stored_over_face(over_face_of(kept.of + OVER_FACE, m->action), T, f);
    const double lost = slide(law, T, f, &o, stored, v, load);
    for (int k = 0; k < 3; k++) s->friction_loss[s->contact_node[corner[k]]] += dt * lost / 3;
}

/* Forces; impulses and losses of a time dt, see rubbing.c, unless `energy` says that forces alone are asked for. */
void add_sliding(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    if (energy) contact_now(s, 0, 0);
    forget_loads(s);
    for (long n = 0; n < kept.of[OVER_FACE].lists; n++) {
        const Meeting *m = met_over_face(n);
        if (m) slide_in(s, m, dt);
    }
    give_loads(s, force, dt);
    for (long m = 0; !energy && m < s->n_contact_nodes; m++) rub(s, s->contact_node[m], contact_load(s, m));
}
