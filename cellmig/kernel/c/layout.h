/* Rows of particles in blocks of four lanes, and where each particle is.
 *
 * A block has up to four particles of one cell and one material.  Its neighbours are padded to one length and ascend by
 * global id, which fixes the order of every sum on any number of ranks.  Blocks with identical stencils, as those of
 * copies of a cell have, share coefficients and are computed together.
 */

enum { TANGENT, NORMAL = D - 1 }; /* axes: along the substrate, as the push, and away from it */

enum { AHEAD = 48 }; /* coefficients stream from memory: they are prefetched this many groups of neighbours ahead */

/* Rows row … row + lanes - 1; the local numbers of their neighbours are those of the stencil plus `shift`; whether
 * other forces than those of stresses act on them. */
typedef struct { int32_t row, lanes, stencil, shift, material, loaded; } Block;

/* Coordinate of particle i along an axis, now. */
static inline double coordinate(const KernelData *s, long i, int axis)
{
    return s->X[D * i + axis] + s->state[2 * D * i + axis];
}

/* Velocity of particle i along an axis. */
static inline double velocity(const KernelData *s, long i, int axis) { return s->state[2 * D * i + D + axis]; }

/* The vector from particle i to particle j. */
static inline void edge_between(const KernelData *s, long i, long j, double edge[D])
{
    for (int c = 0; c < D; c++)
        edge[c] = s->X[D * j + c] + s->state[2 * D * j + c] - s->X[D * i + c] - s->state[2 * D * i + c];
}

static inline const Block *block_at(const KernelData *s, long b) { return (const Block *)s->block + b; }

/* Number of blocks from b on, before `end`, that are computed together: they have one stencil. */
static inline int together(const KernelData *s, long b, long end)
{
    int n = 1;
    while (n < MOST && b + n < end && block_at(s, b + n)->stencil == block_at(s, b)->stencil) n++;
    return n;
}

/* DO(n) for all blocks from `from` to `end`, n of one stencil at a time, b being the first of them. */
#define EACH_BLOCK(from, end, DO)                                                                                     \
    for (long b = (from), end_ = (end), n_; b < end_; b += n_) {                                                      \
        n_ = together(s, b, end_);                                                                                    \
        if (n_ == MOST) DO(MOST);                                                                                     \
        else if (n_ == 2) DO(2);                                                                                      \
        else DO(1);                                                                                                   \
    }

/* Places of four neighbours in fields of 2 D numbers: `column` holds 2 D times their local numbers. */
static inline void neighbours(const uint32_t *column, size_t c[4])
{
    uint64_t pair[2];
    memcpy(pair, column, sizeof pair);
    c[0] = (uint32_t)pair[0];
    c[1] = pair[0] >> 32;
    c[2] = (uint32_t)pair[1];
    c[3] = pair[1] >> 32;
}

/* The end of a step of dt on a clock (time, origin, steps since then): the same time however steps are grouped. */
static inline void tick(double *clock, double dt) { clock[0] = clock[1] + (clock[2] += 1) * dt; }
