/* For how many steps the pieces of a triangle and a feature of another surface serve: what slides meanwhile is little.
 * Their places on the triangle stay, and what they are from is where it is in each step, so that forces are right to
 * the first order of what slides: derivatives of the limits of pieces cancel. */

enum { SERVE = 16, FEW = 4 }; /* most steps; if fewer than a few would do, pieces serve in one alone */
static const double SIZES = 1; /* how many sizes of a feature count as much as its distance */

/* Of a triangle: the call in which what was found serves no more, that in which a pair without pieces is looked at
 * next, and whether what acts in a pair does not serve. */
typedef struct { int32_t until, look, due; } Serves;

/* What is kept in a run of steps: no other run goes on meanwhile. */
static struct {
    Triangle *triangle;
    double *by; /* how far each node goes, and may go until lists are made anew */
    double *velocity[2]; /* of the nodes, and what they were when calls were last a multiple of SERVE */
    Serves *serves; /* of each triangle */
    long calls, room[5]; /* since the run began */
    Pieces of[MEETINGS], found; /* by kinds of meetings; of the meeting at hand */
} kept;

/* Whether pieces serve; begins a run of steps without any, for which what may act is to be listed. */
static int pieces_serve(const KernelData *s)
{
    const long n = s->n_contact_segments, near[MEETINGS] = {s->first_face[n], s->first_side[n], s->first_vertex[n]};
    const int serve = s->contact_serves[1] > 0;
    kept.calls++;
    if (serve && !(s->contact_serves[0] > 0)) return 1;
    kept.calls = 0;
    for (int kind = 0; kind < MEETINGS; kind++) forget(kept.of + kind, near[kind], n);
    kept.serves = enough(kept.serves, 0, n, kept.room + 4, sizeof *kept.serves);
    memset(kept.serves, 0, (size_t)n * sizeof *kept.serves);
    s->contact_serves[0] = 0;
    return serve;
}

/* Keeps the velocities of the nodes. */
static void keep_velocities(const KernelData *s)
{
    const long n = D * s->n_contact_nodes;
    for (int k = 0; k < 2; k++) kept.velocity[k] = enough(kept.velocity[k], 0, n, kept.room + 1 + k, sizeof(double));
    for (long m = 0; m < n; m++) kept.velocity[0][m] = velocity(s, s->contact_node[m / D], m % D);
    if (kept.calls % SERVE == 0) memcpy(kept.velocity[1], kept.velocity[0], (size_t)n * sizeof(double));
}

/* By how much the velocities of nodes differ. */
static double range_of(const double *velocity, const int32_t *one, int n, const int32_t *other, int more)
{
    double square = 0;
    for (int c = 0; c < D; c++) {
        double low = INFINITY, high = -INFINITY;
        for (int i = 0; i < n + more; i++) {
            const double v = velocity[D * (i < n ? one[i] : other[i - n]) + c];
            low = d_minimum(low, v);
            high = d_maximum(high, v);
        }
        square += (high - low) * (high - low);
    }
    return sqrt(square);
}

/* For how many steps of dt what goes at a speed goes by a small share of a distance: at most SERVE. */
static inline double steps_of(const KernelData *s, double speed, double distance, double dt)
{
    return d_minimum(s->contact_serves[1] * distance / (dt * speed + 1e-300), SERVE);
}

/* How fast pieces slip: places on a triangle beside those of a feature, in it and carried on, of whose nodes they have
 * `shares`, at the corners of the triangle. */
static double slip_of(const double *velocity, const int32_t *corner, const int32_t *node, int nodes,
                      const v4 share[], const Pieces *found)
{
    Corners slip;
    double most = 0;
    for (int c = 0; c < D; c++) {
        slip.x[c] = (v4){velocity[D * corner[0] + c], velocity[D * corner[1] + c], velocity[D * corner[2] + c], 0};
        for (int i = 0; i < nodes; i++) slip.x[c] -= velocity[D * node[i] + c] * share[i];
    }
    for (long m = 0; m < found->used; m++) {
        double square = 0;
        for (int c = 0; c < D; c++) {
            const double v = dot4(slip.x[c], found->on[m]);
            square += v * v;
        }
        most = d_maximum(most, square);
    }
    return sqrt(most);
}

/* How often a pair without pieces is looked at that slips by little in some steps: in calls whose number is a multiple
 * of 1, 2, 4, 8 or 16, so that it does not matter from when on it may act, which depends on the rank. */
static inline int32_t looks_every(double steps)
{
    int32_t every = 1;
    while (2 * every <= steps) every *= 2;
    return every;
}
