/* For how many steps the pieces of a triangle and a feature of another surface serve: what slides meanwhile is little.
 * Their places on the triangle stay, and what they are from is where it is in each step, so that forces are right to
 * the first order of what slides: derivatives of the limits of pieces cancel. */

enum { SERVE = 16, FEW = 4 }; /* most steps; if fewer than a few would do, pieces serve in one alone */
static const double SIZES = 1; /* how many sizes of a feature count as much as its distance */

/* What is kept in a run of steps: no other run goes on meanwhile. */
static struct {
    Triangle *triangle;
    double *by; /* how far each node goes, and may go until lists are made anew */
    double *velocity[2]; /* of the nodes, and what they were when calls were last a multiple of SERVE */
    int32_t *until; /* the call in which what was found of each triangle serves no more */
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
    kept.until = enough(kept.until, 0, n, kept.room + 4, sizeof *kept.until);
    memset(kept.until, 0, (size_t)n * sizeof *kept.until);
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

/* For how many steps of dt a triangle and a feature, with the corners and nodes given, slip by a small share of a
 * distance: at most SERVE. */
static double steps_of_slip(const KernelData *s, const double *velocity, const int32_t *corner, const int32_t *node,
                            int nodes, double distance, double dt)
{
    double square = 0;
    for (int c = 0; c < D; c++) {
        double low = INFINITY, high = -INFINITY;
        for (int i = 0; i < 3 + nodes; i++) {
            const double v = velocity[D * (i < 3 ? corner[i] : node[i - 3]) + c];
            low = d_minimum(low, v);
            high = d_maximum(high, v);
        }
        square += (high - low) * (high - low);
    }
    return d_minimum(s->contact_serves[1] * distance / (dt * sqrt(square) + 1e-300), SERVE);
}

/* How often a pair without pieces is looked at that slips by little in some steps: in calls whose number is a multiple
 * of 1, 2, 4, 8 or 16, so that it does not matter from when on it may act, which depends on the rank. */
static inline int32_t looks_every(double steps)
{
    int32_t every = 1;
    while (2 * every <= steps) every *= 2;
    return every;
}
