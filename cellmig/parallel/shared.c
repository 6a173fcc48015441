/* Copies of rows that other ranks of this machine own, through memory that all of them have. */

#include <sched.h>
#include <stdatomic.h>
#include <stdint.h>

typedef struct {
    double *rows;         /* of this rank: its own, then copies */
    double *window;       /* of all ranks, each with a counter and two buffers, which take turns */
    long width, n_owned;  /* numbers a row; own rows */
    long mine, half;      /* where this rank's buffers begin, and the size of one [doubles] */
    long n_sent;          /* own rows that others have copies of */
    const int64_t *sent;
    long n_copies;        /* where in the first buffers they come from [doubles] */
    const int64_t *source;
    long n_peers;         /* where their counters are [doubles] */
    const int64_t *peer;
    int64_t counter;      /* where this rank's is [doubles] */
    int64_t turn;
    long patience;        /* looks at a counter before the processor is left to others */
} Copies;

#define COUNTER(c, at) ((_Atomic int64_t *)((c)->window + (at)))
#define EACH(width) for (long k = 0; k < (width); k++)

static inline void pack(const Copies *c, double *out, const long width)
{
    for (long i = 0; i < c->n_sent; i++) EACH(width) out[width * i + k] = c->rows[width * c->sent[i] + k];
}

static inline void unpack(const Copies *c, const double *in, const long width)
{
    double *out = c->rows + width * c->n_owned;
    for (long i = 0; i < c->n_copies; i++) EACH(width) out[width * i + k] = in[c->source[i] + k];
}

/* Own rows are there for others to copy.  Others have read the buffer: they were done with it before they filled theirs
 * for the last turn, which this rank has waited for. */
int copies_begin(Copies *c, int mode, int direction)
{
    (void)mode, (void)direction;
    double *out = c->window + c->mine + (++c->turn & 1) * c->half;
    if (c->width == 4) pack(c, out, 4); else pack(c, out, c->width);
    atomic_store_explicit(COUNTER(c, c->counter), c->turn, memory_order_release);
    return 0;
}

/* Copies are those of the rows that others had ready in this turn. */
int copies_end(Copies *c, int mode, int direction)
{
    (void)mode, (void)direction;
    for (long i = 0; i < c->n_peers; i++)
        for (long looks = 0; atomic_load_explicit(COUNTER(c, c->peer[i]), memory_order_acquire) < c->turn; looks++)
            if (looks >= c->patience) sched_yield();
    const double *in = c->window + (c->turn & 1) * c->half;
    if (c->width == 4) unpack(c, in, 4); else unpack(c, in, c->width);
    return 0;
}
