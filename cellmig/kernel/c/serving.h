/* For how many steps the pieces of a triangle and a feature of another surface serve: what slides meanwhile is little.
 * Their places on the triangle stay, and what they are from is where it is in each step, so that forces are right to
 * the first order of what slides: derivatives of the limits of pieces cancel. */

enum { SERVE = 16 }; /* most steps */
static const double SIZES = 1; /* how many sizes of a feature count as much as its distance */

/* What is kept in a run of steps: no other run goes on meanwhile.  `found` : pieces of the meeting at hand. */
static struct { Triangle *triangle; long room; Pieces faces, edges, vertices, found; } kept;

/* Whether pieces serve; begins a run of steps without any. */
static int pieces_serve(const KernelData *s)
{
    const long n = s->n_contact_segments;
    const int serve = s->contact_serves[1] > 0;
    if (serve && s->contact_serves[0] > 0) {
        forget(&kept.faces, s->first_face[n]);
        forget(&kept.edges, s->first_side[n]);
        forget(&kept.vertices, s->first_vertex[n]);
    }
    return serve;
}

/* Keeps what was found of triangle k and a feature of some nodes, for as many steps as they slip by a small share of
 * their distance, and of the size of the feature; nothing serves for none. */
static void keep_found(const KernelData *s, Pieces *p, long m, long k, const int32_t *of, int nodes, double distance,
                       double size, double dt)
{
    const int32_t *node = s->contact_segment + 3 * k;
    double square = 0;
    for (int c = 0; c < D && kept.found.used; c++) {
        double low = INFINITY, high = -INFINITY;
        for (int i = 0; i < 3 + nodes; i++) {
            const double v = velocity(s, s->contact_node[i < 3 ? node[i] : of[i - 3]], c);
            low = d_minimum(low, v);
            high = d_maximum(high, v);
        }
        square += (high - low) * (high - low);
    }
    const double way = s->contact_serves[1] * d_minimum(distance, SIZES * size);
    const double steps = d_minimum(way / (dt * sqrt(square) + 1e-300), SERVE);
    const int32_t now = (int32_t)s->contact_gone[3];
    keep_until(p, p->meeting + m, &kept.found, kept.found.used ? now + (int32_t)d_maximum(1, steps) : now);
}

/* The pieces of meeting m and their number, or those just found. */
typedef struct { const v4 *on; long n; } Served;

static inline Served served(const Pieces *p, long m)
{
    return (Served){p->on + p->meeting[m].from, p->meeting[m].n};
}
static inline Served just_found(void) { return (Served){kept.found.on, kept.found.used}; }

/* Whether pieces of meeting m serve in call number `now`; else begins to find them. */
static inline int still_serves(const Pieces *p, long m, int32_t now, int serve)
{
    if (serve && p->meeting[m].until > now) return 1;
    kept.found.used = 0;
    return 0;
}
