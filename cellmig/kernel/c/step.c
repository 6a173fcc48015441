/* The step of cellmig: internal force, surface forces, update, in total Lagrangian form.
 *
 * Particles are worked on in blocks of up to four lanes, of one cell and one material; the neighbours of a block are
 * padded to one length and ascend by global id, which fixes the order of every sum on any number of ranks.  Blocks whose
 * neighbours lie alike, as those of copies of a cell do, share a stencil, where their coefficients are, and are worked on
 * two at a time.  Both passes gather.  Laws, types of the scene and their dispatch are generated in front of this file
 * (see compile.py); a term that the scene lacks is not there.
 */

/* Rows row … row + lanes - 1; the local numbers of their neighbours are those of the stencil plus `shift`; whether anything
 * acts on them but stresses. */
typedef struct { int32_t row, lanes, stencil, shift, material, loaded; } Block;

#ifdef STABILISED
enum { GRADIENT_WIDTH = 12 }; /* four gradients and four entries of S a group */
#else
enum { GRADIENT_WIDTH = 8 };
#endif

/* What a block keeps: forces and stresses that resisted in the last kick, which accounts alone ask for in a second step,
 * in single precision where no force is made of them; losses, and work of activity, that its particles have yet to get. */
typedef struct {
    double stabilising[8], viscous_loss[4], artificial_dissipation[4];
    float viscous[16], bulk[4];
#ifdef STIFFENED
    double elastic[8];
#endif
#ifdef ACTIVE
    double external_work[4];
    float active[16];
#endif
} StepMemory;

long step_memory_size(void) { return sizeof(StepMemory); }

/* ---------------------------------------------------------------- internal force, pass 1: F, stress, stabilisation */

/* Places of four neighbours in fields of four numbers: `column` holds four times their local numbers. */
static inline void neighbours(const uint32_t *column, size_t c[4])
{
    uint64_t pair[2];
    memcpy(pair, column, sizeof pair);
    c[0] = (uint32_t)pair[0];
    c[1] = pair[0] >> 32;
    c[2] = (uint32_t)pair[1];
    c[3] = pair[1] >> 32;
}

#ifdef __AVX512VL__
enum { MOST = 3 }; /* their sums fill the registers */
#else
enum { MOST = 2 };
#endif

/* Number of blocks from b on, before `end`, that are worked on together: they have one stencil. */
static inline int together(const Block *block, long b, long end)
{
    int n = 1;
    while (n < MOST && b + n < end && block[b + n].stencil == block[b].stencil) n++;
    return n;
}

/* DO(n) for all blocks from `from` to `end`, n of one stencil at a time, b being the first of them. */
#define EACH_BLOCK(from, end, DO)                                                                                     \
    for (long b = (from), last_ = (end), n_; b < last_; b += n_) {                                                    \
        n_ = together(block, b, last_);                                                                               \
        if (n_ == MOST) DO(MOST);                                                                                     \
        else if (n_ == 2) DO(2);                                                                                      \
        else DO(1);                                                                                                   \
    }

/* Coefficients are asked for this many neighbours before they are needed: what streams from memory takes long to come. */
#define AHEAD 48
#define FETCH(a) __builtin_prefetch(a)

/* Adds to st the sum of field x coefficient over the neighbours of n blocks of one stencil, rows (0 1), (2 3). */
INLINED void gather_scalar(const long *first, const uint32_t *column, const coefficient *values, const Block *block,
                           const int n, const double *field, v4 st[][2])
{
    for (long k = first[block->stencil]; k < first[block->stencil + 1]; k++) {
        const coefficient *a = values + 4 * k;
        size_t c[4];
        neighbours(column + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *x = field + 4L * block[m].shift;
            st[m][0] = fma4(halves(twice(x + c[0]), twice(x + c[1])), even_of(a), st[m][0]);
            st[m][1] = fma4(halves(twice(x + c[2]), twice(x + c[3])), odd_of(a), st[m][1]);
        }
    }
}

/* Sum of field x gradient over the neighbours of n blocks of one stencil, lanes 00 10 01 11; also S x field, rows (0 1),
 * (2 3). */
INLINED void gather(const KernelData *s, const Block *block, const int n, const double *field, v4 grad[][4], v4 stab[][2])
{
    v4 acc[MOST][4] = {{{0}}}, st[MOST][2] = {{{0}}};
    for (long k = s->first[block->stencil]; k < s->first[block->stencil + 1]; k++) {
        const coefficient *a = s->gradient + GRADIENT_WIDTH * k;
        FETCH(a + AHEAD * GRADIENT_WIDTH);
        FETCH(a + AHEAD * GRADIENT_WIDTH + 64 / sizeof *a);
        size_t c[4];
        neighbours(s->column + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *x = field + 4L * block[m].shift;
            const v4 x0 = twice(x + c[0]), x1 = twice(x + c[1]), x2 = twice(x + c[2]), x3 = twice(x + c[3]);
            acc[m][0] = fma4(x0, even_of(a), acc[m][0]);
            acc[m][1] = fma4(x1, odd_of(a), acc[m][1]);
            acc[m][2] = fma4(x2, even_of(a + 4), acc[m][2]);
            acc[m][3] = fma4(x3, odd_of(a + 4), acc[m][3]);
#ifdef STABILISED
            st[m][0] = fma4(halves(x0, x1), even_of(a + 8), st[m][0]);
            st[m][1] = fma4(halves(x2, x3), odd_of(a + 8), st[m][1]);
#endif
        }
    }
#ifdef STABILISED
    gather_scalar(s->first_outer, s->column_outer, s->outer, block, n, field, st);
#endif
    for (int m = 0; m < n; m++) {
        transpose(acc[m], grad[m]);
        stab[m][0] = st[m][0];
        stab[m][1] = st[m][1];
    }
}

/* Power of two tensors, P : R. */
static inline v4 power(const v4 P[2][2], const v4 R[2][2])
{
    return fma4(P[0][0], R[0][0], P[0][1] * R[0][1]) + fma4(P[1][0], R[1][0], P[1][1] * R[1][1]);
}

/* Power of forces on the four particles from `row` on, rows (0 1), (2 3), on their velocities. */
static inline v4 power_of_forces(const KernelData *s, long row, const v4 f[2])
{
    const double *v = s->state + 4 * row + 2;
    const v4 low = f[0] * halves(twice(v), twice(v + 4)), high = f[1] * halves(twice(v + 8), twice(v + 12));
    const v4 x = SHUFFLE(low, high, 0, 2, 4, 6), y = SHUFFLE(low, high, 1, 3, 5, 7);
    return x + y;
}

/* Work of what was kept of the last kick, which took `accounted_dt`, and of what is there for the coming one, `dt`, on one
 * rate: a force that resisted over a step did work with the mean of the rates at both its ends. */
static inline v4 work_of_stress(float *memory, const v4 P[2][2], const v4 R[2][2], double accounted_dt, double dt)
{
    v4 mean[2][2];
    for (int i = 0; i < 4; i++) {
        mean[i / 2][i % 2] = fma4(splat(0.5 * accounted_dt), load_single(memory + 4 * i), 0.5 * dt * P[i / 2][i % 2]);
        store_single(memory + 4 * i, P[i / 2][i % 2]);
    }
    return power(mean, R);
}

#ifdef STABILISED
static inline v4 work_of_forces(const KernelData *s, long row, double *memory, const v4 f[2], double accounted_dt, double dt)
{
    v4 mean[2];
    for (int i = 0; i < 2; i++) {
        mean[i] = fma4(splat(0.5 * accounted_dt), load(memory + 4 * i), 0.5 * dt * f[i]);
        store(memory + 4 * i, f[i]);
    }
    return power_of_forces(s, row, mean);
}
#endif

static inline void add(double *account, v4 amount) { store(account, load(account) + amount); }

/* Stress of block b, of this material, from F and its rate: V P to Q; what resists, losses and what activity drives to what
 * it keeps.  Lanes that it lacks have no volume and no forces. */
INLINED void stress_of_block(const KernelData *s, long b, const int material, const v4 f[4], const v4 r[4], const v4 stab[2],
                             double accounted_dt, double dt)
{
    const Block block = ((const Block *)s->block)[b];
    const long row = block.row;
    const v4 F[2][2] = {{f[0], f[2]}, {f[1], f[3]}}, R[2][2] = {{r[0], r[2]}, {r[1], r[3]}};
    const v4 V = load(s->volume + 4L * block.stencil);
    StepMemory *memory = (StepMemory *)s->step_memory + b;
    v4 P[2][2], W[2][2] = {{{0}}}, A[2][2] = {{{0}}};
    material_stress(s, b, material, F, R, P, W, A);
    for (int i = 0; i < 4; i++) {
        P[i / 2][i % 2] *= V;
#ifdef VISCOUS
        if (is_viscous(material)) P[i / 2][i % 2] += W[i / 2][i % 2] *= V;
#endif
#ifdef ACTIVE
        if (is_active(material)) P[i / 2][i % 2] += A[i / 2][i % 2] *= V;
#endif
    }
#ifdef VISCOUS
    if (is_viscous(material)) add(memory->viscous_loss, work_of_stress(memory->viscous, W, R, accounted_dt, dt));
#endif
#ifdef ACTIVE
    if (is_active(material)) add(memory->external_work, -work_of_stress(memory->active, A, R, accounted_dt, dt));
#endif
#if defined BULK_DAMPED || defined STABILISED
    v4 lost = {0};
#endif
#ifdef BULK_DAMPED
    const v4 rate = R[0][0] * F[1][1] - R[0][1] * F[1][0] - R[1][0] * F[0][1] + R[1][1] * F[0][0]; /* J tr d */
    const v4 q = V * load(s->bulk_damping + 4L * block.stencil) * rate * (1.0 / (F[0][0] * F[1][1] - F[0][1] * F[1][0]));
    P[0][0] += q * F[1][1];
    P[0][1] -= q * F[1][0];
    P[1][0] -= q * F[0][1];
    P[1][1] += q * F[0][0];
    lost = (0.5 * accounted_dt * load_single(memory->bulk) + 0.5 * dt * q) * rate;
    store_single(memory->bulk, q);
#endif
#ifdef STABILISED
    lost += work_of_forces(s, row, memory->stabilising, stab, accounted_dt, dt);
#endif
#if defined BULK_DAMPED || defined STABILISED
    add(memory->artificial_dissipation, lost);
#endif
    const v4 lanes[4] = {P[0][0], P[1][0], P[0][1], P[1][1]};
    v4 rows[4];
    transpose(lanes, rows);
    if (block.lanes == 4)
        for (int i = 0; i < 4; i++) store(s->Q + 4 * row + 4 * i, rows[i]);
    else
        memcpy(s->Q + 4 * row, rows, sizeof(v4) * (size_t)block.lanes);
    (void)memory, (void)accounted_dt, (void)dt, (void)stab;
}

/* The least and the largest J of the lanes that a block has, with those before in `range`. */
static inline void note_volumes(const v4 f[4], int lanes, v4 range[2])
{
    v4 J = f[0] * f[3] - f[1] * f[2];
    for (int i = lanes; i < 4; i++) J[i] = J[0];
    range[0] = smaller(range[0], J);
    range[1] = larger(range[1], J);
}

INLINED void stress_of_blocks(const KernelData *s, long b, const int n, double F_lag, double accounted_dt, double dt, v4 range[2])
{
    const Block *block = (const Block *)s->block + b;
    v4 r[MOST][4], stab[MOST][2];
    gather(s, block, n, s->state + 2, r, stab);
#ifdef STIFFENED
    v4 elastic[MOST][2] = {{{0}}};
    gather_scalar(s->first_stiff, s->column_stiff, s->stiff, block, n, s->state, elastic);
    for (int m = 0; m < n; m++)
        for (int i = 0; i < 2; i++) store(((StepMemory *)s->step_memory)[b + m].elastic + 4 * i, elastic[m][i]);
#endif
    for (int m = 0; m < n; m++) {
        v4 f[4];
        for (int c = 0; c < 4; c++) {
            double *F = s->F + 16 * (b + m) + 4 * c;
            f[c] = load(F) + F_lag * r[m][c];
            store(F, f[c]);
        }
        note_volumes(f, block[m].lanes, range);
        switch (block->material) {
#define CASE(i) case i: stress_of_block(s, b + m, i, f, r[m], stab[m], accounted_dt, dt); break;
            EACH_MATERIAL(CASE)
        }
    }
}

/* F by its rate: F += F_lag Ḟ, F_lag being the time by which the positions went on since F was brought up to date. */
void stress_of_rate(const KernelData *s, double F_lag, double accounted_dt, double dt)
{
    const Block *block = (const Block *)s->block;
    v4 range[2] = {load(s->J_range), load(s->J_range + 4)};
#define STRESS(n) stress_of_blocks(s, b, n, F_lag, accounted_dt, dt, range)
    EACH_BLOCK(0, s->n_owned_blocks, STRESS)
    EACH_BLOCK(s->n_owned_blocks, s->n_blocks, STRESS)
    store(s->J_range, range[0]);
    store(s->J_range + 4, range[1]);
}

/* F = I + grad u from the displacements as they are. */
void deformation(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        v4 h[1][4], stab[1][2];
        gather(s, (const Block *)s->block + b, 1, s->state, h, stab);
        h[0][0] += 1.0;
        h[0][3] += 1.0;
        for (int c = 0; c < 4; c++) store(s->F + 16 * b + 4 * c, h[0][c]);
    }
}

/* ---------------------------------------------------------------- internal force, pass 2: divergence */

/* Forces on the particles of blocks b … b + n - 1, of one stencil, rows (0 1), (2 3): the adjoint of the gradient, what
 * resists, and what acts on surfaces, which is taken from there. */
INLINED void divergence(const KernelData *s, long b, const int n, v4 f[][2])
{
    const Block *block = (const Block *)s->block + b;
    v4 acc[MOST][4] = {{{0}}};
    for (long k = s->first[block->stencil]; k < s->first[block->stencil + 1]; k++) {
        const coefficient *h = s->adjoint + 8 * k;
        FETCH(h + AHEAD * 8);
        size_t c[4];
        neighbours(s->column + 4 * k, c);
        for (int m = 0; m < n; m++) {
            const double *Q = s->Q + 4L * block[m].shift;
            acc[m][0] = fma4(load(Q + c[0]), even_of(h), acc[m][0]);
            acc[m][1] = fma4(load(Q + c[1]), odd_of(h), acc[m][1]);
            acc[m][2] = fma4(load(Q + c[2]), even_of(h + 4), acc[m][2]);
            acc[m][3] = fma4(load(Q + c[3]), odd_of(h + 4), acc[m][3]);
        }
    }
    for (int m = 0; m < n; m++) {
        const StepMemory *memory = (const StepMemory *)s->step_memory + b + m;
        for (int i = 0; i < 2; i++) {
            const v4 low = SHUFFLE(acc[m][2 * i], acc[m][2 * i + 1], 0, 1, 4, 5);
            const v4 high = SHUFFLE(acc[m][2 * i], acc[m][2 * i + 1], 2, 3, 6, 7);
            f[m][i] = (low + high) - load(memory->stabilising + 4 * i);
#ifdef STIFFENED
            f[m][i] -= load(memory->elastic + 4 * i);
#endif
        }
        if (!block[m].loaded) continue;
        double outside[8] = {0}, *force = s->force + 2L * block[m].row;
        const size_t size = sizeof(double) * 2 * (size_t)block->lanes;
        memcpy(outside, force, size);
        memset(force, 0, size);
        for (int i = 0; i < 2; i++) f[m][i] += load(outside + 4 * i);
    }
}

INLINED void kick_and_drift_blocks(const KernelData *s, long b, const int n, double kick, double dt)
{
    const Block *block = (const Block *)s->block + b;
    const v4 none = {0}, pull = {0, 0, kick * s->acceleration[0], kick * s->acceleration[1]};
    const double *per_mass = s->per_mass + 4L * block->stencil;
    v4 f[MOST][2];
    divergence(s, b, n, f);
    for (int m = 0; m < n; m++) {
        const v4 rows[4] = {
            SHUFFLE(f[m][0], none, 4, 4, 0, 1), SHUFFLE(f[m][0], none, 4, 4, 2, 3),
            SHUFFLE(f[m][1], none, 4, 4, 0, 1), SHUFFLE(f[m][1], none, 4, 4, 2, 3)};
        for (int i = 0; i < block->lanes; i++) {
            double *z = s->state + 4L * (block[m].row + i);
            v4 x = load(z) + kick * per_mass[i] * rows[i] + pull;
            x += dt * SHUFFLE(x, none, 2, 3, 4, 4);
            store(z, x);
        }
    }
}

/* v += kick (f/m + g), then u += dt v, for the particles of some blocks. */
static void kick_and_drift_some(const KernelData *s, long from, long end, double kick, double dt)
{
    const Block *block = (const Block *)s->block;
#define KICK(n) kick_and_drift_blocks(s, b, n, kick, dt)
    EACH_BLOCK(from, end, KICK)
}

/* The same for all owned particles. */
void kick_and_drift(const KernelData *s, double kick, double dt) { kick_and_drift_some(s, 0, s->n_owned_blocks, kick, dt); }

/* ---------------------------------------------------------------- surfaces */

/* Mean over a segment of a potential of the gap, linear from g1 to g2, and its derivatives by g1 and g2. */
#define SEGMENT_MEAN(NAME, PRIMITIVE, POTENTIAL, SLOPE)                                                               \
    static inline double NAME(const double *p, double floor, double g1, double g2, double *d1, double *d2)            \
    {                                                                                                                 \
        const double dg = g2 - g1, low = g1 < g2 ? g1 : g2;                                                           \
        if (fabs(dg) > 0.05 * (low > floor ? low : floor)) {                                                          \
            const double mean = (PRIMITIVE(p, g2) - PRIMITIVE(p, g1)) / dg;                                           \
            *d1 = (mean - POTENTIAL(p, g1)) / dg;                                                                     \
            *d2 = (POTENTIAL(p, g2) - mean) / dg;                                                                     \
            return mean;                                                                                              \
        }                                                                                                             \
        static const double at[3] = {0.11270166537925831, 0.5, 0.8872983346207417}, w[3] = {5. / 18, 8. / 18, 5. / 18}; \
        double mean = 0;                                                                                              \
        *d1 = *d2 = 0;                                                                                                \
        for (int q = 0; q < 3; q++) {                                                                                 \
            const double g = g1 + at[q] * dg, slope = w[q] * SLOPE(p, g);                                             \
            mean += w[q] * POTENTIAL(p, g);                                                                           \
            *d1 += slope * (1 - at[q]);                                                                               \
            *d2 += slope * at[q];                                                                                     \
        }                                                                                                             \
        return mean;                                                                                                  \
    }

#ifdef SUBSTRATE
enum { NORMAL, DRAG, PUSH }; /* what the substrate gives to either end of a segment: along y, x, x */

SEGMENT_MEAN(substrate_mean, substrate_primitive, substrate_potential, substrate_slope)

/* Adhesion to the plane y = 0, integrated along the segments; energy by the first particle of each, if asked; the
 * impulses of dt to the ends. */
void substrate_adhesion(const KernelData *s, double *force, double *energy, double dt)
{
    for (long k = 0; k < s->n_near; k++) {
        const long e = s->near[k], i = s->segment[2 * e], j = s->segment[2 * e + 1];
        const double g1 = s->X[2 * i + 1] + s->state[4 * i + 1], g2 = s->X[2 * j + 1] + s->state[4 * j + 1];
        double d1, d2;
        if (g1 < s->least_gap[0]) s->least_gap[0] = g1;
        const double NL = s->substrate_bonds * s->length[e];
        const double mean = substrate_mean(s->substrate, s->substrate_floor, g1, g2, &d1, &d2);
        force[2 * i + 1] -= NL * d1;
        force[2 * j + 1] -= NL * d2;
        s->bond_impulse[6 * e + NORMAL] -= dt * NL * d1;
        s->bond_impulse[6 * e + 3 + NORMAL] -= dt * NL * d2;
        if (energy) energy[i] += NL * mean;
    }
}
#endif

#ifdef FRICTION
/* Drag of the closed bonds on particles that move along the substrate; impulse and loss of a time dt to the accounts. */
void bond_friction(const KernelData *s, double *force, double dt)
{
    for (long k = 0; k < s->n_near; k++) {
        const long e = s->near[k];
        const int32_t *node = s->segment + 2 * e;
        const double g1 = s->X[2 * node[0] + 1] + s->state[4 * node[0] + 1];
        const double g2 = s->X[2 * node[1] + 1] + s->state[4 * node[1] + 1];
        double d1, d2;
        const double closed = -substrate_mean(s->substrate, s->substrate_floor, g1, g2, &d1, &d2) / s->substrate_depth;
        const double share = closed < 0 ? 0 : closed > 1 ? 1 : closed;
        for (int i = 0; i < 2; i++) {
            const double v = s->state[4 * node[i] + 2], f = 0.5 * s->length[e] * friction_drag(s->friction, share, v);
            force[2 * node[i]] -= f;
            s->bond_impulse[6 * e + 3 * i + DRAG] -= dt * f;
            s->friction_loss[node[i]] += dt * f * v;
        }
    }
}
#endif

#ifdef CORTEX
/* Tension of the surfaces, along their segments; energy by the first particle of each, if asked. */
void cortex_pull(const KernelData *s, double *force, double *energy)
{
    for (long e = 0; e < s->n_segments; e++) {
        const long i = s->segment[2 * e], j = s->segment[2 * e + 1];
        const double x = s->X[2 * j] + s->state[4 * j] - s->X[2 * i] - s->state[4 * i];
        const double y = s->X[2 * j + 1] + s->state[4 * j + 1] - s->X[2 * i + 1] - s->state[4 * i + 1];
        const double length = sqrt(x * x + y * y), stretch = length / s->length[e];
        const double t = cortex_tension(s->cortex, stretch) / length;
        force[2 * i] += t * x;
        force[2 * i + 1] += t * y;
        force[2 * j] -= t * x;
        force[2 * j + 1] -= t * y;
        if (energy) energy[i] += s->length[e] * cortex_energy(s->cortex, stretch);
    }
}
#endif

#ifdef PROTRUSION
/* Of each cell that protrudes, the middle of its surface along x, and how firmly its front half holds on to the
 * substrate.  Every rank that has a part of the cell sums over all of it, in the same order. */
static void find_hold(const KernelData *s)
{
    for (long c = 0; c < s->n_movers; c++) {
        double middle = 0, bonded = 0, d1, d2;
        for (long k = s->first_mover[c]; k < s->first_mover[c + 1]; k++)
            middle += s->mover_weight[k] * (s->X[2 * s->mover[k]] + s->state[4 * s->mover[k]]);
        for (long k = s->first_grip[c]; k < s->first_grip[c + 1] && bonded < s->firm; k++) {
            const long e = s->grip[k], i = s->segment[2 * e], j = s->segment[2 * e + 1];
            const double x = 0.5 * (s->X[2 * i] + s->state[4 * i] + s->X[2 * j] + s->state[4 * j]);
            const double g1 = s->X[2 * i + 1] + s->state[4 * i + 1], g2 = s->X[2 * j + 1] + s->state[4 * j + 1];
            const double closed = -substrate_mean(s->substrate, s->substrate_floor, g1, g2, &d1, &d2) / s->substrate_depth;
            if (closed > 0) bonded += closed * s->length[e] * protrusion_front(s->protrusion, x - middle);
        }
        s->middle[c] = middle;
        s->hold[c] = protrusion_hold(s->protrusion, bonded);
    }
}

/* Push of the leading edge along +x; push[2e], push[2e+1] hold β α N σ/2 of the ends.  Its work is accounted with the
 * velocities at both ends of a step, as losses are: `pushed` has the forces of the last kick, which took `accounted_dt`; `dt`
 * is the time of the one to come. */
void protrude(const KernelData *s, double *force, double *impulse, double *work, double accounted_dt, double dt)
{
    find_hold(s);
    for (long k = 0; k < s->n_near; k++) {
        const long e = s->near[k];
        double *pushed = s->pushed + 2 * e;
        if (s->push[2 * e] == 0 && s->push[2 * e + 1] == 0) continue;
        const long node[2] = {s->segment[2 * e], s->segment[2 * e + 1]};
        const double g1 = s->X[2 * node[0] + 1] + s->state[4 * node[0] + 1];
        const double g2 = s->X[2 * node[1] + 1] + s->state[4 * node[1] + 1], dg = g2 - g1;
        const double edge = fabs(dg) > 1e-6 * s->firm ? (protrusion_ramp(s->protrusion, g2) - protrusion_ramp(s->protrusion, g1)) / dg
                                            : protrusion_ramp_slope(s->protrusion, 0.5 * (g1 + g2));
        const double middle = s->middle[s->mover_of[e]], share = s->hold[s->mover_of[e]] * s->length[e];
        for (int i = 0; i < 2; i++) {
            const double ahead = s->X[2 * node[i]] + s->state[4 * node[i]] - middle;
            const double f = s->push[2 * e + i] * share * protrusion_front(s->protrusion, ahead) * edge;
            force[2 * node[i]] += f;
            if (!impulse) continue;
            impulse[node[i]] += dt * f;
            s->bond_impulse[6 * e + 3 * i + PUSH] += dt * f;
            work[node[i]] += 0.5 * (accounted_dt * pushed[i] + dt * f) * s->state[4 * node[i] + 2];
            pushed[i] = f;
        }
    }
}
#endif

#ifdef CONTACT
SEGMENT_MEAN(contact_mean, contact_primitive, contact_potential, contact_slope)

static inline void point(const KernelData *s, long i, double x[2])
{
    x[0] = s->X[2 * i] + s->state[4 * i];
    x[1] = s->X[2 * i + 1] + s->state[4 * i + 1];
}

static inline void add_normal(const KernelData *s, long i, long j, double n[2])
{
    double a[2], b[2];
    point(s, i, a);
    point(s, j, b);
    const double x = b[1] - a[1], y = a[0] - b[0], r = 1 / sqrt(x * x + y * y);
    n[0] += x * r;
    n[1] += y * r;
}

typedef struct { double gap, n[2], t; long a, b; } ClosestPoint;

/* Closest point to node m on the other cell's polyline: signed gap, normal, segment a-b, share t of b. */
static void find_closest_point(const KernelData *s, long m, ClosestPoint *closest)
{
    double x[2], best = INFINITY, d[2] = {0, 0};
    long at = -1;
    point(s, s->contact_node[m], x);
    for (long k = s->first_candidate[m]; k < s->first_candidate[m + 1]; k++) {
        const int32_t *c = s->candidate + 4 * k; /* particles before, start, end, after */
        double a[2], b[2];
        point(s, c[1], a);
        point(s, c[2], b);
        const double ex = b[0] - a[0], ey = b[1] - a[1];
        double t = ((x[0] - a[0]) * ex + (x[1] - a[1]) * ey) / (ex * ex + ey * ey);
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        const double dx = x[0] - a[0] - t * ex, dy = x[1] - a[1] - t * ey, r = dx * dx + dy * dy;
        if (r < best) {
            best = r;
            at = k;
            d[0] = dx;
            d[1] = dy;
            closest->t = t;
        }
    }
    if (at < 0) {
        closest->gap = INFINITY;
        return;
    }
    const int32_t *c = s->candidate + 4 * at;
    double n[2] = {0, 0};
    add_normal(s, c[1], c[2], n);
    if (closest->t == 0) add_normal(s, c[0], c[1], n);
    if (closest->t == 1) add_normal(s, c[2], c[3], n);
    /* Beyond the cutoff, of a thin body only the back may be listed: a point behind that is not inside. */
    const double r = sqrt(best), side = d[0] * n[0] + d[1] * n[1] < 0 && r < s->contact_cutoff ? -1 : 1;
    closest->a = c[1];
    closest->b = c[2];
    closest->gap = side * r;
    for (int i = 0; i < 2; i++) closest->n[i] = r > 0 ? side * d[i] / r : n[i];
}

/* Adhesion between cells: each surface against the other's polyline, half of the energy from either side; the impulses
 * of dt that a particle has from the other cell, which has the opposite. */
void cell_adhesion(const KernelData *s, double *force, double *energy, double dt)
{
    ClosestPoint *closest = s->closest_point;
    for (long m = 0; m < s->n_contact_nodes; m++) {
        find_closest_point(s, m, closest + m);
        if (closest[m].gap < s->least_gap[1]) s->least_gap[1] = closest[m].gap;
        s->contact_pull[m] = 0;
    }
    for (long e = 0; e < s->n_contact_segments; e++) {
        const long i = s->contact_segment[2 * e], j = s->contact_segment[2 * e + 1];
        const double g1 = closest[i].gap, g2 = closest[j].gap;
        if (!(g1 < s->contact_cutoff || g2 < s->contact_cutoff) || isinf(g1) || isinf(g2)) continue;
        double d1, d2;
        const double NL = 0.5 * s->contact_bonds * s->contact_length[e];
        const double mean = contact_mean(s->contact, s->contact_floor, g1, g2, &d1, &d2);
        s->contact_pull[i] -= NL * d1;
        s->contact_pull[j] -= NL * d2;
        if (energy) energy[s->contact_node[i]] += NL * mean;
    }
    for (long m = 0; m < s->n_contact_nodes; m++) {
        if (s->contact_pull[m] == 0) continue;
        const long i = s->contact_node[m];
        for (int c = 0; c < 2; c++) {
            const double f = s->contact_pull[m] * closest[m].n[c];
            force[2 * i + c] += f;
            s->contact_impulse[2 * s->contact_slot[m] + c] += dt * f;
            force[2 * closest[m].a + c] -= (1 - closest[m].t) * f;
            force[2 * closest[m].b + c] -= closest[m].t * f;
        }
    }
}
#endif

/* ---------------------------------------------------------------- director */

#ifdef DIRECTOR
static inline double wrapped(double a) { return a - 2 * M_PI * rint(a / (2 * M_PI)); }

/* Reference gradient of θ at the particles, and h = (cos θ, sin θ), by blocks. */
static void director_gradient(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block block = ((const Block *)s->block)[b];
        const double *theta = s->director + 2L * block.shift;
        for (int i = 0; i < block.lanes; i++) {
            const double own = s->director[2L * (block.row + i)];
            double g[2] = {0, 0};
            for (long k = s->first[block.stencil]; k < s->first[block.stencil + 1]; k++) {
                const coefficient *a = s->gradient + GRADIENT_WIDTH * k + 4 * (i / 2) + i % 2;
                const double d = wrapped(theta[s->column[4 * k + i] / 2] - own);
                g[0] += a[0] * d;
                g[1] += a[2] * d;
            }
            s->director_gradient[8 * b + i] = g[0];
            s->director_gradient[8 * b + 4 + i] = g[1];
            s->director_axis[8 * b + i] = cos(own);
            s->director_axis[8 * b + 4 + i] = sin(own);
        }
    }
}

void director_field(const KernelData *s) { director_gradient(s); }
#endif

#ifdef DIRECTOR_RELAXES
/* Angle of the membrane at the anchored particles. */
static void anchor_director(const KernelData *s)
{
    for (long k = 0; k < s->n_anchors; k++) {
        const int32_t *a = s->anchor + 3 * k; /* particles before, at, after */
        const double tx = s->X[2 * a[2]] + s->state[4 * a[2]] - s->X[2 * a[0]] - s->state[4 * a[0]];
        const double ty = s->X[2 * a[2] + 1] + s->state[4 * a[2] + 1] - s->X[2 * a[0] + 1] - s->state[4 * a[0] + 1];
        if (s->anchor_owned[k]) s->director[2 * a[1]] = atan2(ty, tx) + s->anchor_offset[k];
    }
}

/* Torque -∂E/∂θ of the owned particles, from the fluxes of their neighbours. */
static void director_torque(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block block = ((const Block *)s->block)[b];
        const v4 F[2][2] = {{load(s->F + 16 * b), load(s->F + 16 * b + 8)}, {load(s->F + 16 * b + 4), load(s->F + 16 * b + 12)}};
        const v4 g[2] = {load(s->director_gradient + 8 * b), load(s->director_gradient + 8 * b + 4)};
        v4 flux[2];
        material_director_flux(s, block.material, F, g, flux);
        for (int i = 0; i < block.lanes; i++)
            for (int c = 0; c < 2; c++) s->director_flux[2L * (block.row + i) + c] = s->volume[4L * block.stencil + i] * flux[c][i];
    }
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = ((const Block *)s->block)[b];
        const double *flux = s->director_flux + 2L * block.shift;
        for (int i = 0; i < block.lanes; i++) {
            double torque = 0;
            for (long k = s->first[block.stencil]; k < s->first[block.stencil + 1]; k++) {
                const coefficient *h = s->adjoint + 8 * k + 4 * (i / 2) + i % 2;
                const uint32_t j = s->column[4 * k + i] / 2;
                torque += h[0] * flux[j] + h[2] * flux[j + 1];
            }
            s->director[2L * (block.row + i) + 1] = torque;
        }
    }
}

/* θ goes on by its torque; what an anchor takes up becomes a couple on the membrane. */
static void director_relaxes(const KernelData *s, double dt)
{
    for (long i = 0; i < s->n_owned; i++) {
        const double rate = s->director_mobility[i] * s->director[2 * i + 1]; /* 0 at anchors */
        s->director[2 * i] += dt * rate;
        s->viscous_loss[i] += dt * rate * s->director[2 * i + 1];
    }
}

void anchor_couple(const KernelData *s, double *force)
{
    for (long k = 0; k < s->n_anchors; k++) {
        const int32_t *a = s->anchor + 3 * k;
        const double tx = s->X[2 * a[2]] + s->state[4 * a[2]] - s->X[2 * a[0]] - s->state[4 * a[0]];
        const double ty = s->X[2 * a[2] + 1] + s->state[4 * a[2] + 1] - s->X[2 * a[0] + 1] - s->state[4 * a[0] + 1];
        const double w = s->director[2 * a[1] + 1] / (tx * tx + ty * ty);
        force[2 * a[2]] -= w * ty;
        force[2 * a[2] + 1] += w * tx;
        force[2 * a[0]] += w * ty;
        force[2 * a[0] + 1] -= w * tx;
    }
}
#endif

/* ---------------------------------------------------------------- supports, loads and plates */

#ifdef BOUNDARY
/* Dead tractions and pressures at the time of the clock; their work is external, as that of the protrusion. */
static void boundary_loads(const KernelData *s, double *force, double accounted_dt, double dt)
{
    double *load = s->load;
    for (long k = 0; k < s->n_loaded; k++) load[2 * s->loaded[k]] = load[2 * s->loaded[k] + 1] = 0;
    for (long k = 0; k < s->n_dead; k++) {
        const double factor = load_curve_value(s, s->dead_curve[k], s->clock[0]);
        for (int c = 0; c < 2; c++) load[2 * s->dead[k] + c] += factor * s->dead_force[2 * k + c];
    }
    for (long k = 0; k < s->n_pressed; k++) {
        const long i = s->pressed[2 * k], j = s->pressed[2 * k + 1];
        const double half = 0.5 * s->pressure[k] * load_curve_value(s, s->pressed_curve[k], s->clock[0]);
        const double x = s->X[2 * j] + s->state[4 * j] - s->X[2 * i] - s->state[4 * i];
        const double y = s->X[2 * j + 1] + s->state[4 * j + 1] - s->X[2 * i + 1] - s->state[4 * i + 1];
        load[2 * i] -= half * y; /* the surface runs counterclockwise: (y, -x) points outwards */
        load[2 * i + 1] += half * x;
        load[2 * j] -= half * y;
        load[2 * j + 1] += half * x;
    }
    for (long k = 0; k < s->n_loaded; k++) {
        const long i = s->loaded[k];
        if (i >= s->n_owned) continue;
        for (int c = 0; c < 2; c++) {
            double *before = s->load_before + 2 * i + c;
            force[2 * i + c] += load[2 * i + c];
            s->external_work[i] += 0.5 * (accounted_dt * *before + dt * load[2 * i + c]) * s->state[4 * i + 2 + c];
            *before = load[2 * i + c];
        }
    }
}

/* What supports and plates change in the coming kick, as it is before. */
static void remember_boundary(const KernelData *s)
{
    for (long k = 0; k < s->n_held; k++) {
        s->held_before[2 * k] = s->state[s->held[k]];
        s->held_before[2 * k + 1] = s->state[s->held[k] + 2];
    }
    for (long k = 0; k < s->n_platable; k++)
        for (int c = 0; c < 2; c++) s->plate_before[2 * k + c] = s->state[4 * s->platable[k] + 2 + c];
}

/* Particles that went into a plate are put on its face.  It does work by its own speed; a blow loses the rest. */
static void stop_at_plates(const KernelData *s, double kick, double dt)
{
    const double t = s->clock[0];
    for (long k = 0; k < s->n_platable; k++)
        for (long p = 0; p < s->n_plates; p++) {
            const long i = s->platable[k];
            const double *n = s->plate + 6 * p, *point = n + 2, *d = n + 4;
            const double now = load_curve_value(s, s->plate_curve[p], t + dt), then = load_curve_value(s, s->plate_curve[p], t);
            double *z = s->state + 4 * i, gap = 0, mean = 0;
            for (int c = 0; c < 2; c++) gap += n[c] * (s->X[2 * i + c] + z[c] - point[c] - now * d[c]);
            s->plate_force[k * s->n_plates + p] = 0;
            if (gap >= 0) continue;
            for (int c = 0; c < 2; c++) {
                z[c] -= gap * n[c];
                z[2 + c] -= gap / dt * n[c];
                mean += 0.5 * n[c] * (s->plate_before[2 * k + c] + z[2 + c]);
            }
            const double impulse = -gap / (dt * s->inverse_mass[i]), speed = (n[0] * d[0] + n[1] * d[1]) * (now - then) / dt;
            s->plate_force[k * s->n_plates + p] = impulse / kick;
            s->external_work[i] += impulse * speed;
            s->artificial_dissipation[i] += impulse * (speed - mean);
        }
}

/* Supports: u as prescribed at the end of the step, v that which leads there; the reaction and its work. */
static void hold(const KernelData *s, double kick, double dt)
{
    for (long k = 0; k < s->n_held; k++) {
        const long d = s->held[k], i = d / 4;
        const double u = s->held_value[k] * load_curve_value(s, s->held_curve[k], s->clock[0] + dt);
        const double v = (u - s->held_before[2 * k]) / dt;
        const double impulse = (v - s->state[d + 2]) / s->inverse_mass[i];
        s->reaction[k] = impulse / kick;
        s->external_work[i] += 0.5 * impulse * (s->held_before[2 * k + 1] + v);
        s->state[d] = u;
        s->state[d + 2] = v;
    }
}

/* Supports: u and v as prescribed at the time of the clock. */
void prescribe(const KernelData *s)
{
    for (long k = 0; k < s->n_held; k++) {
        s->state[s->held[k]] = s->held_value[k] * load_curve_value(s, s->held_curve[k], s->clock[0]);
        s->state[s->held[k] + 2] = s->held_value[k] * load_curve_rate(s, s->held_curve[k], s->clock[0]);
    }
}

/* Rates of what is held, and the reactions. */
static void hold_rate(const KernelData *s, double *out)
{
    for (long k = 0; k < s->n_held; k++) {
        const long d = s->held[k];
        const double a = s->held_value[k] * load_curve_acceleration(s, s->held_curve[k], s->clock[0]);
        s->reaction[k] = (a - out[d + 2]) / s->inverse_mass[d / 4];
        out[d] = s->held_value[k] * load_curve_rate(s, s->held_curve[k], s->clock[0]);
        out[d + 2] = a;
    }
}
#endif

/* ---------------------------------------------------------------- the step */

/* Ghosts from their owners: VecGhostUpdate{Begin,End}(vec, INSERT_VALUES, SCATTER_FORWARD), absent on one rank. */
static inline int exchange(const KernelData *s, void *vec)
{
    if (!s->ghost_begin) return 0;
    return s->ghost_begin(vec, 1, 0) || s->ghost_end(vec, 1, 0);
}

/* That of the state alone, to be timed. */
int exchange_state(const KernelData *s) { return exchange(s, s->state_vec); }

static int surface_forces(const KernelData *s, double accounted_dt, double dt)
{
    memset(s->force + 2 * s->n_owned, 0, sizeof(double) * 2 * (size_t)(s->n_local - s->n_owned)); /* for their owners */
#ifdef SUBSTRATE
    substrate_adhesion(s, s->force, 0, dt);
#endif
#ifdef CONTACT
    cell_adhesion(s, s->force, 0, dt);
#endif
#ifdef CORTEX
    cortex_pull(s, s->force, 0);
#endif
#ifdef FRICTION
    bond_friction(s, s->force, dt);
#endif
#ifdef PROTRUSION
    protrude(s, s->force, s->protrusion_impulse, s->external_work, accounted_dt, dt);
#endif
#ifdef BOUNDARY
    boundary_loads(s, s->force, accounted_dt, dt);
#endif
    (void)accounted_dt;
    (void)dt;
    return 0;
}

static int director_step(const KernelData *s, double dt)
{
#ifdef DIRECTOR_RELAXES
    director_torque(s);
    if (s->n_anchors_anywhere && exchange(s, s->director_vec)) return 1;
    anchor_couple(s, s->force);
    director_relaxes(s, dt);
#else
    (void)s;
    (void)dt;
#endif
    return 0;
}

static int director_ready(const KernelData *s)
{
#ifdef DIRECTOR_RELAXES
    anchor_director(s);
    if (exchange(s, s->director_vec)) return 1;
    director_gradient(s);
#else
    (void)s;
#endif
    return 0;
}

/* Surface forces of which no step is made. */
static void forget_forces(const KernelData *s) { memset(s->force, 0, sizeof(double) * 2 * (size_t)s->n_local); }

/* What blocks have for their particles goes to these. */
static void settle_accounts(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block block = ((const Block *)s->block)[b];
        StepMemory *memory = (StepMemory *)s->step_memory + b;
        for (int i = 0; i < block.lanes; i++) {
            s->viscous_loss[block.row + i] += memory->viscous_loss[i];
            s->artificial_dissipation[block.row + i] += memory->artificial_dissipation[i];
            memory->viscous_loss[i] = memory->artificial_dissipation[i] = 0;
#ifdef ACTIVE
            s->external_work[block.row + i] += memory->external_work[i];
            memory->external_work[i] = 0;
#endif
        }
    }
}

/* n steps of M u'' = F_body + F_cs + F_cc + F_d - F_int (2), symplectic: v by the force at u, from the middle of the last
 * step to that of the coming one, then u by the new v.  `F_lag` is the time by which u went on since F was last brought up
 * to date, `accounted_dt` that for which accounts are half done, `dt_prev` the step before the first. */
int advance(const KernelData *s, long n, double dt, double F_lag, double accounted_dt, double dt_prev)
{
    for (long i = 0; i < n; i++, F_lag = dt_prev = dt) {
        const double kick = 0.5 * (dt_prev + dt);
        if (director_ready(s)) return 1;
        stress_of_rate(s, F_lag, accounted_dt, kick);
        if (surface_forces(s, accounted_dt, kick) || director_step(s, dt)) return 1;
#ifdef BOUNDARY
        remember_boundary(s);
        kick_and_drift(s, kick, dt);
        stop_at_plates(s, kick, dt);
        hold(s, kick, dt);
        s->clock[0] = s->clock[1] + (s->clock[2] += 1) * dt; /* the same number however steps are grouped */
        if (exchange(s, s->state_vec)) return 1;
#else
        kick_and_drift_some(s, 0, s->n_shared_blocks, kick, dt);
        if (s->ghost_begin && s->ghost_begin(s->state_vec, 1, 0)) return 1;
        kick_and_drift_some(s, s->n_shared_blocks, s->n_owned_blocks, kick, dt); /* while copies are on their way */
        if (s->ghost_end && s->ghost_end(s->state_vec, 1, 0)) return 1;
#endif
        accounted_dt = kick;
    }
    return 0;
}

/* Rate of the owned state, (v, a), from the state as it is; the accounts are closed for the last kick, `accounted_dt`. */
int rate(const KernelData *s, double *out, double accounted_dt)
{
    if (director_ready(s)) return 1;
    deformation(s);
    stress_of_rate(s, 0.0, accounted_dt, 0.0);
    if (surface_forces(s, accounted_dt, 0.0) || director_step(s, 0.0)) return 1;
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = ((const Block *)s->block)[b];
        v4 f[1][2];
        divergence(s, b, 1, f);
        for (int i = 0; i < block.lanes; i++)
            for (int c = 0; c < 2; c++) {
                const long row = block.row + i, k = 4 * row + c;
                out[k] = s->state[k + 2];
                out[k + 2] = s->inverse_mass[row] * f[0][i / 2][2 * (i % 2) + c] + s->acceleration[c];
            }
    }
#ifdef BOUNDARY
    hold_rate(s, out);
#endif
    settle_accounts(s);
    return 0;
}

/* Accounts of losses and work over a time dt, at the state as it is; reactions are those of `rate`. */
int account(const KernelData *s, double dt)
{
    deformation(s);
    stress_of_rate(s, 0.0, 0.0, 2.0 * dt);
#ifdef BOUNDARY
    for (long k = 0; k < s->n_held; k++)
        s->external_work[s->held[k] / 4] += dt * s->reaction[k] * s->state[s->held[k] + 2];
#endif
    settle_accounts(s);
    const int failed = surface_forces(s, 0.0, 0.0) || surface_forces(s, dt, dt);
    forget_forces(s);
    return failed;
}

/* The director alone goes on by dt, for integrators that hold it still within a step. */
int relax_director(const KernelData *s, double dt)
{
    const int failed = director_ready(s) || director_step(s, dt);
    forget_forces(s);
    return failed;
}

#ifdef STIFFENED
/* Energies u·E u/2 of the elastic stabilisation, by rows. */
void stiffness_energy(const KernelData *s, double *out)
{
    for (const Block *block = (const Block *)s->block, *end = block + s->n_owned_blocks; block < end; block++) {
        v4 st[1][2] = {{{0}}};
        gather_scalar(s->first_stiff, s->column_stiff, s->stiff, block, 1, s->state, st);
        for (int i = 0; i < block->lanes; i++) {
            const double *u = s->state + 4L * (block->row + i);
            out[block->row + i] = 0.5 * (u[0] * st[0][i / 2][2 * (i % 2)] + u[1] * st[0][i / 2][2 * (i % 2) + 1]);
        }
    }
}
#endif

/* Velocity gradients Ḟ by blocks, lanes 00 10 01 11. */
void velocity_gradient(const KernelData *s, double *out)
{
    for (long b = 0; b < s->n_blocks; b++) {
        v4 r[1][4], stab[1][2];
        gather(s, (const Block *)s->block + b, 1, s->state + 2, r, stab);
        for (int c = 0; c < 4; c++) store(out + 16 * b + 4 * c, r[0][c]);
    }
}

/* ---------------------------------------------------------------- what the step control asks */

/* Largest local bounds V J λmax(F⁻ᵀ K F⁻¹) with viscous and elastic weights, extremes of J and their particles, speed². */
void limits(const KernelData *s, double out[6])
{
    double viscous = 0, elastic = 0, low = INFINITY, high = -INFINITY, speed = 0, least = -1;
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = ((const Block *)s->block)[b];
        for (int lane = 0; lane < block.lanes; lane++) {
            const long i = block.row + lane;
            const double *F = s->F + 16 * b + lane, *K = s->bound + 3 * i, *z = s->state + 4 * i;
            const double a = F[0], c = F[4], b_ = F[8], d = F[12], J = a * d - b_ * c;
            const double r = s->volume[4L * block.stencil + lane] / J;
            const double A = (d * d * K[0] - 2 * c * d * K[2] + c * c * K[1]) * r; /* F⁻ᵀ K F⁻¹ J² by entries */
            const double B = (b_ * b_ * K[0] - 2 * a * b_ * K[2] + a * a * K[1]) * r;
            const double C = (-b_ * d * K[0] + (a * d + b_ * c) * K[2] - a * c * K[1]) * r;
            const double top = 0.5 * (A + B) + sqrt(0.25 * (A - B) * (A - B) + C * C);
            if (!(top * s->viscous_weight[i] <= viscous)) viscous = top * s->viscous_weight[i];
            double weight = s->elastic_weight[i];
#ifdef DIRECTOR
            const double *g = s->director_gradient + 8 * b + lane, g0 = d * g[0] - c * g[4], g1 = a * g[4] - b_ * g[0];
            weight += s->director_weight[i] * (g0 * g0 + g1 * g1) / (J * J * J);
#endif
            if (!(top * weight <= elastic)) elastic = top * weight;
            if (!(J >= low)) { low = J; least = (double)i; }
            if (!(J <= high)) high = J;
            const double v2 = z[2] * z[2] + z[3] * z[3];
            if (!(v2 <= speed)) speed = v2;
        }
    }
    out[0] = viscous; out[1] = elastic; out[2] = low; out[3] = high; out[4] = speed; out[5] = least;
}
