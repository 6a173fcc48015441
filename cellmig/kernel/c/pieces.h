/* Pieces of triangles of one surface that are kept: they serve for some steps, see contact_space.c. */

/* Triangles that meet features: numbers of both, where their pieces begin in `on` and end, as places on the triangle.
 * Over a face they are the corners of a polygon; beside an edge pairs of ends of lines, with a width in the fourth
 * place; beside a vertex points, with an area in the fourth place.  They begin at -1 where they cannot serve, as the
 * feature is small beside what slides meanwhile: then they are found in each step. */
typedef struct { long triangle, feature, from, end; } Meeting;
typedef struct { Meeting *meeting; v4 *on; long n, used, room[2]; } Pieces;

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

/* What was added since `from` is of a triangle and a feature; whether it can serve. */
static inline void meet(Pieces *p, long triangle, long feature, long from, int serves)
{
    if (p->used == from) return;
    p->meeting = enough(p->meeting, p->n, 1, p->room, sizeof *p->meeting);
    p->meeting[p->n++] = (Meeting){triangle, feature, serves ? from : -1, p->used};
    if (!serves) p->used = from;
}
