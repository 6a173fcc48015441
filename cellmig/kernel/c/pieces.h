/* Pieces of triangles of one surface at features of another, and what acts at them, that serve for some steps: see
 * serving.h. */

enum { OVER_FACE, BESIDE_EDGE, BESIDE_VERTEX, MEETINGS };

/* A triangle that meets a feature: where its pieces begin in `on`, numbers of the triangle, of the pair in lists and of
 * the feature, number of pieces, room for them, what acts at them, the call of add_contact in which it is looked at if
 * it has none, and whether what acts does not serve.  Over a face pieces are the corners of a polygon; beside an edge
 * pairs of ends of lines, with a width in the fourth place; beside a vertex points, with an area in that place. */
typedef struct { long from; int32_t triangle, near, feature, n, room, action, until, due; } Meeting;

/* A meeting that is listed: its number, or the complement of that where it has no pieces, when it is looked at if it
 * has none, and the call up to which it surely has none. */
typedef struct { int32_t number, until, rests; } Listed;

/* Meetings, their numbers by those of what is near triangles, -1 where there is none, those that are listed and where
 * those of each triangle begin; pieces and what acts at them. */
typedef struct {
    Meeting *meeting;
    int32_t *number;
    Listed *listed;
    long *from;
    v4 *on;
    void *action;
    long meetings, lists, used, actions, room[6];
} Pieces;

/* Memory for n more things of a size, of which some are used. */
static void *enough(void *of, long used, long n, long *room, size_t size)
{
    if (used + n <= *room) return of;
    *room = 2 * (used + n);
    void *more = aligned_alloc(sizeof(v4), (((size_t)*room * size - 1) / sizeof(v4) + 1) * sizeof(v4));
    if (!more) abort();
    if (used) memcpy(more, of, (size_t)used * size);
    free(of);
    return more;
}

/* Adds n places on T. */
static inline void keep(Pieces *p, const v4 *on, long n)
{
    if (!n) return; /* there may be no memory yet */
    p->on = enough(p->on, p->used, n, p->room + 1, sizeof *p->on);
    memcpy(p->on + p->used, on, (size_t)n * sizeof *on);
    p->used += n;
}

/* Forgets all meetings of n things that are near triangles. */
static void forget(Pieces *p, long n, long triangles)
{
    p->from = enough(p->from, 0, triangles + 1, p->room + 5, sizeof *p->from);
    p->number = enough(p->number, 0, n, p->room + 3, sizeof *p->number);
    p->listed = enough(p->listed, 0, n, p->room + 4, sizeof *p->listed);
    memset(p->number, -1, (size_t)n * sizeof *p->number);
    p->meetings = p->lists = p->used = p->actions = 0;
}

/* The number of the meeting of a triangle and what is `near` it, a feature; of a new one that serves in no call. */
static inline int32_t meeting_of(Pieces *p, long triangle, long near, long feature)
{
    if (p->number[near] >= 0) return p->number[near];
    p->meeting = enough(p->meeting, p->meetings, 1, p->room, sizeof *p->meeting);
    Meeting *m = p->meeting + p->meetings;
    *m = (Meeting){.triangle = (int32_t)triangle, .near = (int32_t)near, .feature = (int32_t)feature};
    return p->number[near] = (int32_t)p->meetings++;
}

/* Keeps pieces of a meeting, at which something of a size acts. */
static inline void keep_found(Pieces *p, Meeting *m, const Pieces *found, size_t size)
{
    m->n = (int32_t)found->used;
    if (!m->n) return;
    if (!m->room) {
        m->action = (int32_t)p->actions;
        p->action = enough(p->action, p->actions, 1, p->room + 2, size);
        p->actions++;
    }
    if (m->n <= m->room) {
        memcpy(p->on + m->from, found->on, (size_t)m->n * sizeof *p->on);
        return;
    }
    m->from = p->used;
    m->room = m->n;
    keep(p, found->on, m->n);
}
