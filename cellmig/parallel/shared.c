/* Ghost rows, copied from other ranks of the same machine through shared memory. */

#include <sched.h>
#include <stdatomic.h>
#include <stdint.h>
#include <time.h>

typedef struct {
    double *rows;           /* rows of this rank: owned ones, then ghosts */
    double *window;         /* shared memory: for each rank a counter and two buffers, used alternately */
    long width, n_owned;    /* numbers per row; owned rows */
    long mine, half;        /* offset of the first buffer of this rank, and size of a buffer [doubles] */
    long n_sent;
    const int64_t *sent;    /* owned rows that are ghosts of other ranks */
    long n_copies;
    const int64_t *source;  /* offset in the window of each ghost, in the first buffer of its owner [doubles] */
    long n_peers;
    const int64_t *peer;    /* offsets of the counters of the ranks to exchange with [doubles] */
    int64_t counter;        /* offset of the counter of this rank [doubles] */
    int64_t turn;           /* number of exchanges so far */
    long patience;          /* polls of a counter before the processor is yielded */
} Copies;

#define COUNTER(c, at) ((_Atomic int64_t *)((c)->window + (at)))
#define EACH(width) for (long k = 0; k < (width); k++)

/* Copy the rows that other ranks need into a buffer. */
static inline void pack(const Copies *c, double *out, const long width)
{
    for (long i = 0; i < c->n_sent; i++) EACH(width) out[width * i + k] = c->rows[width * c->sent[i] + k];
}

/* Copy the ghosts from the buffers of their owners. */
static inline void unpack(const Copies *c, const double *in, const long width)
{
    double *out = c->rows + width * c->n_owned;
    for (long i = 0; i < c->n_copies; i++) EACH(width) out[width * i + k] = in[c->source[i] + k];
}

/* Begin an exchange: publish owned rows.  The buffer is free, as other ranks had read it before they filled theirs in
 * the previous turn, for which this rank has waited. */
int copies_begin(Copies *c, int mode, int direction)
{
    double *out = c->window + c->mine + (++c->turn & 1) * c->half;
    if (c->width == 4) pack(c, out, 4); else pack(c, out, c->width);
    atomic_store_explicit(COUNTER(c, c->counter), c->turn, memory_order_release);
    return 0;
}

/* CPU time of this process that went into waiting for other ranks [s]. */
double waited;

/* CPU time of this process [s]. */
static double cpu_time(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

/* End an exchange: wait for the other ranks' rows of this turn, and copy them.  Only who has to wait reads a clock. */
int copies_end(Copies *c, int mode, int direction)
{
    for (long i = 0; i < c->n_peers; i++) {
        const _Atomic int64_t *counter = COUNTER(c, c->peer[i]);
        if (atomic_load_explicit(counter, memory_order_acquire) >= c->turn) continue;
        const double begin = cpu_time();
        for (long looks = 0; atomic_load_explicit(counter, memory_order_acquire) < c->turn; looks++)
            if (looks >= c->patience) sched_yield();
        waited += cpu_time() - begin;
    }
    const double *in = c->window + (c->turn & 1) * c->half;
    if (c->width == 4) unpack(c, in, 4); else unpack(c, in, c->width);
    return 0;
}

int (*messages_end)(void *, int, int); /* VecGhostUpdateEnd of PETSc */

/* The same, timed; rows of other machines are on their way meanwhile. */
int timed_messages_end(void *vec, int mode, int direction)
{
    const double begin = cpu_time();
    const int failed = messages_end(vec, mode, direction);
    waited += cpu_time() - begin;
    return failed;
}
