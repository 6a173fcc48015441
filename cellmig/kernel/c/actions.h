/* What acts between a triangle T and a feature of another surface through pieces that stay where they are on T, to
 * first order in what it depends on: so laws are evaluated anew only where distances have changed. */

static const double NEARLY = 0.01; /* up to which share of the least distance */

/* Over a face: loads on the corners of T along its normal for their gaps and the change of the loads with these, bounds
 * of stiffness; the energy and the most that a gap may change stand in the fourth places of loads and gaps. */
typedef struct { v4 gap, load, tangent[3], stiff; } OverFace;

/* Beside an edge or a vertex: for the products of the vectors from there to the corners of T, 00, 11, 22 and twice 12,
 * 20, 01, the loads on these corners by the same vectors, and their changes; the change of the square of the least
 * distance over the most that it may be.  The energy and that square stand in fourth places. */
typedef struct { v4 product[2], load[2], stiff; float tangent[6][8], nearest[8]; } Beside;

static inline OverFace *over_face_of(const Pieces *p, int32_t action) { return (OverFace *)p->action + action; }
static inline Beside *beside_of(const Pieces *p, int32_t action) { return (Beside *)p->action + action; }

static inline void add4(double *sum, v4 a) { store(sum, load(sum) + a); }

/* Begins a sum of what acts over a face, where T is now. */
static inline void begin_over_face(OverFace *r, const Four *four)
{
    memset(r, 0, sizeof *r);
    r->gap = (v4){four->at[3], four->at[3] + four->by[0][3], four->at[3] + four->by[1][3], INFINITY};
}

/* Begins a sum of what acts beside an edge or a vertex. */
static inline void begin_beside(Beside *r, const v4 product[2])
{
    memset(r, 0, sizeof *r);
    r->product[0] = product[0], r->product[1] = product[1];
    r->product[0][3] = INFINITY;
}

/* The elements of three, each at the place of the one before, or of the one behind. */
static inline v4 next3(v4 a) { return SHUFFLE(a, a, 1, 2, 0, 3); }
static inline v4 last3(v4 a) { return SHUFFLE(a, a, 2, 0, 1, 3); }

/* Products of the shares of a place: its vector has the square of their sum times those of the vectors. */
static inline void shared(v4 on, v4 product[2])
{
    on[3] = 0;
    product[0] = on * on;
    product[1] = next3(on) * last3(on);
}

/* The square of the distance of a place by its products. */
static inline double square_at(const v4 shared[2], const v4 product[2])
{
    return dot4(shared[0], product[0]) + dot4(shared[1], product[1]);
}

/* Adds the load per vector at a place, with the energy, and a stiffness if it is positive. */
static inline void add_beside(Beside *r, v4 on, const v4 shared[2], double load, double energy, double square,
                              double stiff)
{
    on[3] = 0;
    r->load[0] += load * shared[0];
    r->load[1] += load * shared[1];
    r->load[0][3] += energy;
    if (stiff > 0) r->stiff += stiff * on; /* of reflex edges and of points that count negatively it is negative */
    if (square >= r->product[0][3]) return;
    r->product[0][3] = square;
    for (int h = 0; h < 2; h++) store_single(r->nearest + 4 * h, shared[h] / (2 * NEARLY * square));
}

/* Adds a change of loads per vector: of `to` with the products at `with`. */
static inline void bend_beside(Beside *r, const v4 with[2], const v4 to[2])
{
    for (int b = 0; b < 6; b++)
        for (int h = 0; h < 2; h++) {
            float *at = r->tangent[b] + 4 * h;
            store_single(at, fma4(splat(with[b / 3][b % 3]), to[h], load_single(at)));
        }
}

/* Three vectors to the corners of T by directions, along which they stand. */
typedef struct { v4 x[3]; } Corners;

/* The vectors to the corners of T from x. */
static inline Corners corners_beside(const Triangle *T, const double *x)
{
    Corners c;
    for (int i = 0; i < 3; i++) c.x[i] = (v4){T->x[0][i], T->x[1][i], T->x[2][i], 0} - (x[i] + SKEW[i]);
    return c;
}

/* The same across an edge between two points, and how far along it they stand. */
static inline Corners across_edge(const Triangle *T, const double *const x[2], v4 *along)
{
    double edge[3];
    less3(x[1], x[0], edge);
    Corners c = corners_beside(T, x[0]);
    *along = (edge[0] * c.x[0] + edge[1] * c.x[1] + edge[2] * c.x[2]) / dot3(edge, edge);
    for (int i = 0; i < 3; i++) c.x[i] -= *along * edge[i];
    return c;
}

/* Their products. */
static inline void products(const Corners *c, v4 product[2])
{
    product[0] = product[1] = (v4){0};
    for (int i = 0; i < 3; i++) {
        product[0] = fma4(c->x[i], c->x[i], product[0]);
        product[1] = fma4(next3(c->x[i]), last3(c->x[i]), product[1]);
    }
    product[0][3] = product[1][3] = 0;
    product[1] += product[1];
}

/* What acts over a face, on the corners of T and of the face; whether a gap has changed too much for the next time. */
static inline int act_over_face(const OverFace *r, const Triangle *T, const Face *f, double *const force[3])
{
    const Four four = planes_on(T, &f->planes);
    const v4 at[3] = {four.at, four.at + four.by[0], four.at + four.by[1]};
    v4 loads = r->load, below = {0}, stiff = {0};
    double most = 0;
    for (int k = 0; k < 3; k++) {
        const double by = at[k][3] - r->gap[k];
        most = d_maximum(most, fabs(by));
        loads = fma4(splat(by), r->tangent[k], loads);
    }
    for (int k = 0; k < 3; k++) {
        add4(T->force[k], (v4){0, 0, 0, r->stiff[k]} - loads[k] * f->normal);
        below = fma4(splat(loads[k]), at[k], below);
        stiff = fma4(splat(r->stiff[k]), at[k], stiff);
    }
    for (int k = 0; k < 3; k++) add4(force[k], (v4){0, 0, 0, stiff[k]} + below[k] * f->normal);
    *T->energy += r->load[3];
    return most > r->gap[3];
}

/* The energy over a face, to second order. */
static inline double stored_over_face(const OverFace *r, const Triangle *T, const Face *f)
{
    const Four four = planes_on(T, &f->planes);
    const v4 at[3] = {four.at, four.at + four.by[0], four.at + four.by[1]};
    v4 loads = r->load + r->load, by = {0};
    for (int k = 0; k < 3; k++) {
        by[k] = at[k][3] - r->gap[k];
        loads = fma4(splat(by[k]), r->tangent[k], loads);
    }
    return r->load[3] + 0.5 * dot4(by, loads);
}

/* What acts on the corners of T by vectors to them from an edge or a vertex, with what is opposite to it there. */
static inline int act_by_vectors(const Beside *r, const Triangle *T, const Corners *c, v4 opposite[4])
{
    v4 change[2], loads[2], acts[4];
    products(c, change);
    double far = 0;
    for (int h = 0; h < 2; h++) {
        change[h] -= r->product[h];
        loads[h] = r->load[h];
        far += dot4(load_single(r->nearest + 4 * h), change[h]);
    }
    for (int b = 0; b < 6; b++)
        for (int h = 0; h < 2; h++)
            loads[h] = fma4(splat(change[b / 3][b % 3]), load_single(r->tangent[b] + 4 * h), loads[h]);
    const v4 with_next = last3(loads[1]), with_last = next3(loads[1]);
    for (int i = 0; i < 3; i++) {
        const v4 x = c->x[i];
        acts[i] = fma4(loads[0], x, fma4(with_next, next3(x), with_last * last3(x)));
    }
    acts[3] = r->stiff;
    transpose(acts, opposite);
    for (int k = 0; k < 3; k++) add4(T->force[k], opposite[k] * (v4){-1, -1, -1, 1});
    *T->energy += r->load[0][3];
    return fabs(far) > 1;
}

/* What acts beside an edge between two points, on the corners of T and on the points; whether the least distance has
 * changed too much for the next time. */
static inline int act_beside_edge(const Beside *r, const Triangle *T, const double *const x[2], double *const force[2])
{
    v4 along, acts[4];
    const Corners c = across_edge(T, x, &along);
    const int far = act_by_vectors(r, T, &c, acts);
    const v4 all = acts[0] + acts[1] + acts[2];
    const v4 last = fma4(splat(along[2]), acts[2], fma4(splat(along[1]), acts[1], along[0] * acts[0]));
    add4(force[0], all - last);
    add4(force[1], last);
    return far;
}

/* The same of a vertex. */
static inline int act_beside_vertex(const Beside *r, const Triangle *T, const double *x, double *force)
{
    v4 acts[4];
    const Corners c = corners_beside(T, x);
    const int far = act_by_vectors(r, T, &c, acts);
    add4(force, acts[0] + acts[1] + acts[2]);
    return far;
}
