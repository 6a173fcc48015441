/* Pieces of triangles of one surface that are kept, as they serve for some steps: see serving.h. */

/* A triangle that meets a feature: where its pieces begin in `on`, their number, room for them, and the call of
 * add_contact in which they serve no more.  Over a face pieces are the corners of a polygon; beside an edge pairs of
 * ends of lines, with a width in the fourth place; beside a vertex points, with an area in the fourth place. */
typedef struct { long from; int32_t n, room, until; } Meeting;
typedef struct { Meeting *meeting; v4 *on; long used, room[2]; } Pieces;

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
    p->on = enough(p->on, p->used, n, p->room + 1, sizeof *p->on);
    memcpy(p->on + p->used, on, (size_t)n * sizeof *on);
    p->used += n;
}

/* Forgets the pieces of n meetings. */
static void forget(Pieces *p, long n)
{
    p->meeting = enough(p->meeting, 0, n, p->room, sizeof *p->meeting);
    memset(p->meeting, 0, (size_t)n * sizeof *p->meeting);
    p->used = 0;
}

/* Keeps pieces of a meeting until a call. */
static inline void keep_until(Pieces *p, Meeting *m, const Pieces *found, int32_t until)
{
    m->n = (int32_t)found->used;
    m->until = until;
    if (m->n <= m->room) {
        if (m->n) memcpy(p->on + m->from, found->on, (size_t)m->n * sizeof *p->on);
        return;
    }
    m->from = p->used;
    m->room = m->n;
    keep(p, found->on, m->n);
}
