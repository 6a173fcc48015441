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

/* A call of add_contact: its number, whether pieces serve, the step, and how far any triangle goes through a face. */
typedef struct { int32_t now; int serve; double dt, pierced; } Call;

/* Pieces that wait for what acts there. */
typedef struct { FacePieces faces; Lines lines; Points points; } Waiting;

/* Places of the nodes of a feature, and what acts on them; their number. */
static inline int nodes_of(const KernelData *s, int kind, long feature, const int32_t **node, const double *x[3],
                           double *force[3])
{
    const int n = kind == OVER_FACE ? 3 : kind == BESIDE_EDGE ? 2 : 1;
    *node = kind == OVER_FACE ? s->contact_face + 3 * feature : kind == BESIDE_EDGE ? s->contact_side + 4 * feature
        : s->contact_vertex + feature;
    for (int i = 0; i < n; i++) {
        x[i] = contact_place(s, (*node)[i]);
        force[i] = contact_load(s, (*node)[i]);
    }
    return n;
}

/* For how many steps the pieces that were found serve, at a least distance from a feature of a size with these planes:
 * what slips, and what turns at this distance with the feature and, if it is an edge, its faces. */
INLINED double steps_of_found(const KernelData *s, int kind, const Triangle *T, const Planes *planes,
                              const int32_t *corner, const int32_t *node, double least, double dt)
{
    const double *velocity = kept.velocity[0];
    v4 share[4] = {splat(1)};
    if (kind == BESIDE_VERTEX) return steps_of(s, slip_of(velocity, corner, node, 1, share, &kept.found), least, dt);
    const Four four = planes_on(T, planes);
    const v4 at[4] = {four.at, four.at + four.by[0], four.at + four.by[1], four.at};
    const int edge = kind == BESIDE_EDGE;
    transpose(at, share);
    if (edge) share[0] = share[3], share[1] = share[2]; /* what is left of the place along it, and that */
    const double way = d_minimum(least, SIZES * planes->size);
    const double turn = range_of(velocity, node, 3 + edge, node, 0) / planes->size;
    return steps_of(s, slip_of(velocity, corner, node, 3 - edge, share, &kept.found) + way * turn, way, dt);
}

/* Finds the pieces of a meeting that is listed, and for how many steps they serve, if these are fewer. */
INLINED void find(const KernelData *s, int kind, const Triangle *T, Listed *listed, Call *call, double *steps)
{
    const int32_t number = listed->number < 0 ? ~listed->number : listed->number;
    Meeting *m = kept.of[kind].meeting + number;
    const int32_t *node, *corner = s->contact_segment + 3 * m->triangle;
    const double *x[3];
    const Planes *planes = NULL;
    double *force[3], rest, least;
    nodes_of(s, kind, m->feature, &node, x, force);
    kept.found.used = 0;
    if (kind == OVER_FACE) {
        const Face *f = face_at(s, m->feature, call->now);
        rest = over_face(T, f, &kept.found, &call->pierced);
        least = kept.found.used && call->serve ? least_gap_over(T, f, &kept.found) : 0;
        planes = &f->planes;
    } else if (kind == BESIDE_EDGE) {
        const Edge3 *e = edge_at(s, m->feature, call->now);
        rest = beside_edge3(T, e, &kept.found);
        least = kept.found.used && call->serve ? least_from_edge(T, x, &kept.found) : 0;
        planes = &e->planes;
    } else {
        const Vertex *v = vertex_at(s, m->feature, call->now);
        const Ball ball = ball_around(T);
        rest = beside_vertex3(T, &ball, v, &kept.found);
        least = kept.found.used && call->serve ? least_from_vertex(T, x[0], &kept.found) : 0;
    }
    if (rest > 0) {
        const Near near = near_of(s, kind);
        near.rest[2 * m->near] = s->triangle_gone[2 * m->triangle] + rest;
        near.rest[2 * m->near + 1] = near.gone[2 * m->feature] + rest;
        listed->rests = call->now + calls_of(s, &near, m->triangle, m->feature, rest);
    }
    keep_found(kept.of + kind, m, &kept.found, kind == OVER_FACE ? sizeof(OverFace) : sizeof(Beside));
    m->due = 1;
    listed->number = m->n ? number : ~number;
    if (m->n && call->serve)
        *steps = d_minimum(*steps, steps_of_found(s, kind, T, planes, corner, node, least, call->dt));
}

/* Looks at a meeting that had no pieces, if now is the time; whether it has some. */
INLINED int look(const KernelData *s, int kind, const Triangle *T, Listed *listed, Call *call)
{
    Meeting *m = kept.of[kind].meeting + ~listed->number;
    const int32_t *node, *corner = s->contact_segment + 3 * m->triangle;
    const double *x[3], gap = d_minimum(s->contact_serves[2], s->contact_apart[m->triangle]);
    double *force[3], steps;
    const int nodes = nodes_of(s, kind, m->feature, &node, x, force);
    const double range = range_of(kept.velocity[1], corner, 3, node, nodes);
    const int32_t every = looks_every(steps_of(s, range, gap, call->dt));
    const int32_t late = (int32_t)(kept.calls % every);
    listed->until = m->until = call->now + every - late;
    if (!late) find(s, kind, T, listed, call, &steps);
    return listed->number >= 0;
}

/* Looks at the meetings of triangle k that had no pieces; whether one has some. */
INLINED int look_at(const KernelData *s, int kind, const Triangle *T, long k, Call *call)
{
    const Pieces *p = kept.of + kind;
    int32_t *next = &kept.serves[k].look;
    int any = 0;
    for (long n = p->from[k]; n < p->from[k + 1]; n++) {
        Listed *listed = p->listed + n;
        if (listed->number >= 0) continue;
        if (listed->until <= call->now && listed->rests < call->now) any |= look(s, kind, T, listed, call);
        const int32_t then = listed->until > listed->rests ? listed->until : listed->rests + 1;
        *next = then < *next ? then : *next;
    }
    return any;
}

/* Finds the pieces of all meetings of triangle k; whether there are any. */
INLINED int find_all(const KernelData *s, int kind, const Triangle *T, long k, Call *call, double *steps)
{
    const Pieces *p = kept.of + kind;
    int any = 0;
    for (long n = p->from[k]; n < p->from[k + 1]; n++) {
        if (p->listed[n].rests >= call->now) continue;
        find(s, kind, T, p->listed + n, call, steps);
        any |= p->listed[n].number >= 0;
    }
    return any;
}

/* Has the pieces of a meeting wait for what acts there. */
INLINED void wait_for(const KernelData *s, int kind, const Triangle *T, const Meeting *m, int32_t now, Waiting *waiting)
{
    const int32_t *node;
    const double *x[3];
    double *force[3];
    const v4 *on = kept.of[kind].on + m->from;
    nodes_of(s, kind, m->feature, &node, x, force);
    if (kind == OVER_FACE) wait_over_face(T, face_at(s, m->feature, now), on, m->n, m->action, &waiting->faces);
    else if (kind == BESIDE_EDGE) wait_beside_edge(T, x, on, m->n, m->action, &waiting->lines);
    else wait_beside_vertex(T, x[0], on, m->n, m->action, &waiting->points);
}

/* Has what acts in the meetings of triangle k be computed where it does not serve. */
INLINED void renew(const KernelData *s, int kind, const Triangle *T, long k, int32_t now, Waiting *waiting)
{
    const Pieces *p = kept.of + kind;
    for (long n = p->from[k]; n < p->from[k + 1]; n++) {
        if (p->listed[n].number < 0) continue;
        Meeting *m = p->meeting + p->listed[n].number;
        if (m->due) wait_for(s, kind, T, m, now, waiting);
    }
}

/* Finds pieces of triangles where none serve, all of a triangle in one step, so that they are parts of it without gaps
 * and overlaps, and what acts there where that does not serve. */
static void meet(const KernelData *s, const Triangle *T, Call *call, Waiting *waiting)
{
    for (long k = 0; k < s->n_contact_segments; k++, T++) {
        Serves *serves = kept.serves + k;
        int due = serves->until <= call->now;
        if (!due && serves->look <= call->now) {
            serves->look = INT32_MAX;
            due |= look_at(s, OVER_FACE, T, k, call);
            due |= look_at(s, BESIDE_EDGE, T, k, call);
            due |= look_at(s, BESIDE_VERTEX, T, k, call);
        }
        if (due) {
            double steps = SERVE;
            int any = find_all(s, OVER_FACE, T, k, call, &steps);
            any |= find_all(s, BESIDE_EDGE, T, k, call, &steps);
            any |= find_all(s, BESIDE_VERTEX, T, k, call, &steps);
            serves->until = any ? call->now + (steps < FEW ? 1 : (int32_t)steps) : INT32_MAX;
            serves->look = call->now + 1;
        }
        if (!due && !serves->due) continue;
        Waiting *w = waiting + (call->serve && serves->until > call->now + 1);
        renew(s, OVER_FACE, T, k, call->now, w);
        renew(s, BESIDE_EDGE, T, k, call->now, w);
        renew(s, BESIDE_VERTEX, T, k, call->now, w);
        serves->due = 0;
    }
}

/* What acts in the meetings that are listed. */
INLINED void act(const KernelData *s, int kind, const Triangle *T, int32_t now)
{
    const Pieces *p = kept.of + kind;
    for (long n = 0; n < p->lists; n++) {
        if (p->listed[n].number < 0) continue;
        Meeting *m = p->meeting + p->listed[n].number;
        const Triangle *here = T + m->triangle;
        const int32_t *node;
        const double *x[3];
        double *force[3];
        nodes_of(s, kind, m->feature, &node, x, force);
        if (kind == OVER_FACE)
            m->due = act_over_face(over_face_of(p, m->action), here, face_at(s, m->feature, now), force);
        else if (kind == BESIDE_EDGE) m->due = act_beside_edge(beside_of(p, m->action), here, x, force);
        else m->due = act_beside_vertex(beside_of(p, m->action), here, x[0], force[0]);
        kept.serves[m->triangle].due |= m->due;
    }
}

/* Begins to wait for what acts; `change` : whether for its changes, too. */
static void begin_to_wait(Waiting *w, int change)
{
    w->faces.n = w->lines.n = w->points.n = 0;
    w->faces.law = w->lines.law = w->points.law = 0;
    w->faces.change = w->lines.change = w->points.change = change;
    w->faces.of = kept.of + OVER_FACE, w->lines.of = kept.of + BESIDE_EDGE, w->points.of = kept.of + BESIDE_VERTEX;
}

/* What acts between triangles and all features near them. */
static void act_on_all(const KernelData *s, const Triangle *T, Call *call)
{
    static Waiting waiting[2]; /* of what serves in this call alone, and in others */
    for (int w = 0; w < 2; w++) begin_to_wait(waiting + w, w);
    meet(s, T, call, waiting);
    for (int w = 0; w < 2; w++) {
        add_over_faces(&waiting[w].faces);
        add_beside_edges(&waiting[w].lines);
        add_beside_vertices(&waiting[w].points);
    }
    act(s, OVER_FACE, T, call->now);
    act(s, BESIDE_EDGE, T, call->now);
    act(s, BESIDE_VERTEX, T, call->now);
}

/* What acts on the nodes now, by meetings that are those of now; energies by the first corners of the triangles, if
 * asked for.  A feature that cannot act on a triangle rests until nodes have gone far enough: it would add no bit.  How
 * far any triangle goes through a face. */
static double contact_now(const KernelData *s, double *energy, double dt)
{
    Call call = {.now = ++*s->contact_call, .serve = pieces_serve(s), .dt = dt};
    forget_loads(s);
    if (call.serve) keep_velocities(s);
    if (follow_nodes(s) || kept.calls % SERVE == 0) list_what_may_act(s, call.serve ? SERVE : 0);
    act_on_all(s, triangles_now(s, energy), &call);
    return call.pierced;
}

/* Forces; energies, if asked for; the impulses of a time dt on a particle by the other cell, the opposite on that. */
void add_contact(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    const double pierced = contact_now(s, energy, dt);
    if (pierced > 0) *s->stiffest_contact = INFINITY;
    *s->deepest_contact = d_maximum(*s->deepest_contact, pierced);
    give_loads(s, force, dt);
    for (long m = 0; m < s->n_contact_nodes; m++) s->stiffness_of_contact[s->contact_node[m]] = 0;
    for (long m = 0; m < s->n_contact_nodes; m++) {
        const long i = s->contact_node[m];
        if (i >= s->n_owned) continue;
        const double k = s->stiffness_of_contact[i] += contact_load(s, m)[D] * s->inverse_mass[i];
        if (k > *s->stiffest_contact) *s->stiffest_contact = k;
    }
}

/* Number n of the meetings over faces that are listed, NULL if it has no pieces. */
static inline const Meeting *met_over_face(long n)
{
    const Pieces *p = kept.of + OVER_FACE;
    return p->listed[n].number < 0 ? NULL : p->meeting + p->listed[n].number;
}
