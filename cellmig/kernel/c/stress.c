/* Pass 1 of the internal force: F, the first Piola-Kirchhoff stress P of each material, what dissipates. */

/* P : R, the power of a stress per volume. */
static inline v4 power(const v4 P[D][D], const v4 R[D][D])
{
    return fma4(P[0][0], R[0][0], P[0][1] * R[0][1]) + fma4(P[1][0], R[1][0], P[1][1] * R[1][1]);
}

/* Power of forces on the four particles from `row` on, rows (0 1), (2 3). */
static inline v4 power_of_forces(const KernelData *s, long row, const v4 f[2])
{
    const double *v = s->state + 2 * D * row + D;
    const v4 low = f[0] * halves(twice(v), twice(v + 4)), high = f[1] * halves(twice(v + 8), twice(v + 12));
    const v4 x = SHUFFLE(low, high, 0, 2, 4, 6), y = SHUFFLE(low, high, 1, 3, 5, 7);
    return x + y;
}

/* ½ (Δtₙ Pₙ + Δtₙ₊₁ Pₙ₊₁) : Ḟ, the trapezoidal work of a stress that depends on the rate; Pₙ₊₁ is remembered. */
static inline v4 work_of_stress(float *memory, const v4 P[D][D], const v4 R[D][D], double accounted_dt, double dt)
{
    v4 mean[D][D];
    for (int i = 0; i < 4; i++) {
        mean[i / 2][i % 2] = fma4(splat(0.5 * accounted_dt), load_single(memory + 4 * i), 0.5 * dt * P[i / 2][i % 2]);
        store_single(memory + 4 * i, P[i / 2][i % 2]);
    }
    return power(mean, R);
}

/* The same of forces, ½ (Δtₙ fₙ + Δtₙ₊₁ fₙ₊₁) · v. */
static inline v4 work_of_forces(const KernelData *s, long row, double *memory, const v4 f[2], double accounted_dt,
                                double dt)
{
    v4 mean[2];
    for (int i = 0; i < 2; i++) {
        mean[i] = fma4(splat(0.5 * accounted_dt), load(memory + 4 * i), 0.5 * dt * f[i]);
        store(memory + 4 * i, f[i]);
    }
    return power_of_forces(s, row, mean);
}

static inline void add(double *account, v4 amount) { store(account, load(account) + amount); }

/* P += V A. */
static inline void add_scaled(v4 P[D][D], v4 A[D][D], v4 V)
{
    for (int i = 0; i < 4; i++) P[i / 2][i % 2] += A[i / 2][i % 2] *= V;
}

/* V P of what stores energy: the material, and the gradient of the director. */
INLINED void elastic(const KernelData *s, long b, const int material, const v4 F[D][D], v4 V, v4 P[D][D])
{
    stress(s, material, F, P);
    if (has_director_stress(material)) {
        const double *gradient = s->director_gradient + 4 * D * b;
        const v4 g[D] = {load(gradient), load(gradient + 4)};
        v4 T[D][D];
        director_stress(s, material, F, g, T);
        for (int i = 0; i < 4; i++) P[i / 2][i % 2] += T[i / 2][i % 2];
    }
    for (int i = 0; i < 4; i++) P[i / 2][i % 2] *= V;
}

/* Adds the viscous stress; what it dissipates is lost. */
INLINED void viscous(const KernelData *s, StepMemory *memory, const int material, const v4 F[D][D], const v4 R[D][D],
                     v4 V, double accounted_dt, double dt, v4 P[D][D])
{
    if (!has_viscous_stress(material)) return;
    v4 W[D][D];
    viscous_stress(s, material, F, R, W);
    add_scaled(P, W, V);
    add(memory->viscous_loss, work_of_stress(memory->viscous, W, R, accounted_dt, dt));
}

/* Adds the active stress along the director; its work comes from outside. */
INLINED void active(const KernelData *s, long b, StepMemory *memory, const int material, const v4 F[D][D],
                    const v4 R[D][D], v4 V, double accounted_dt, double dt, v4 P[D][D])
{
    if (!has_active_stress(material)) return;
    const double *axis = s->director_axis + 4 * D * b;
    const v4 h[D] = {load(axis), load(axis + 4)};
    v4 A[D][D];
    active_stress(s, material, F, h, A);
    add_scaled(P, A, V);
    add(memory->external_work, -work_of_stress(memory->active, A, R, accounted_dt, dt));
}

/* Adds the numerical damping of sound; returns the work that it takes. */
static inline v4 bulk_damping(StepMemory *memory, v4 viscosity, const v4 F[D][D], const v4 R[D][D],
                              double accounted_dt, double dt, v4 P[D][D])
{
    v4 damping[D][D], q, rate;
    bulk_damping_stress(0, viscosity, F, R, damping, &q, &rate);
    for (int i = 0; i < 4; i++) P[i / 2][i % 2] += damping[i / 2][i % 2];
    const v4 work = (0.5 * accounted_dt * load_single(memory->bulk) + 0.5 * dt * q) * rate;
    store_single(memory->bulk, q);
    return work;
}

/* The rows of Q that block b has: V P of its particles, by entries 00 10 01 11; lanes that it lacks have no volume. */
static inline void store_stress(const KernelData *s, const Block *block, const v4 P[D][D])
{
    const v4 lanes[4] = {P[0][0], P[1][0], P[0][1], P[1][1]};
    double *Q = s->Q + D * D * (long)block->row;
    v4 rows[4];
    transpose(lanes, rows);
    if (block->lanes == 4)
        for (int i = 0; i < 4; i++) store(Q + 4 * i, rows[i]);
    else
        memcpy(Q, rows, sizeof(v4) * (size_t)block->lanes);
}

/* Stress of block b, of this material, from F and Ḟ (lanes 00 10 01 11); work over the steps is accounted. */
INLINED void stress_of_block(const KernelData *s, long b, const int material, const v4 f[4], const v4 r[4],
                             const v4 stab[2], double accounted_dt, double dt)
{
    const Block *block = block_at(s, b);
    const v4 F[D][D] = {{f[0], f[2]}, {f[1], f[3]}}, R[D][D] = {{r[0], r[2]}, {r[1], r[3]}};
    const v4 V = load(s->volume + 4L * block->stencil);
    StepMemory *memory = s->step_memory + b;
    v4 P[D][D], lost = {0};
    elastic(s, b, material, F, V, P);
    viscous(s, memory, material, F, R, V, accounted_dt, dt, P);
    active(s, b, memory, material, F, R, V, accounted_dt, dt, P);
    if (BULK_DAMPED) {
        const v4 viscosity = V * load(s->bulk_damping + 4L * block->stencil);
        lost = bulk_damping(memory, viscosity, F, R, accounted_dt, dt, P);
    }
    if (STABILISED) lost += work_of_forces(s, block->row, memory->stabilising, stab, accounted_dt, dt);
    if (BULK_DAMPED || STABILISED) add(memory->artificial_dissipation, lost);
    store_stress(s, block, P);
}

/* Stresses of n blocks of one stencil at b, after F += F_lag Ḟ; `range` gets the extremes of J. */
INLINED void stress_of_blocks(const KernelData *s, long b, const int n, double F_lag, double accounted_dt, double dt,
                              v4 range[2])
{
    const Block *block = block_at(s, b);
    v4 r[MOST][4], stab[MOST][2], stiff[MOST][2] = {{{0}}};
    gather(s, block, n, s->state + D, r, stab);
    if (STIFFENED) {
        gather_scalar(s->first_stiff, s->column_stiff, s->stiff, block, n, s->state, stiff);
        for (int m = 0; m < n; m++)
            for (int i = 0; i < 2; i++) store(s->step_memory[b + m].elastic + 4 * i, stiff[m][i]);
    }
    for (int m = 0; m < n; m++) {
        v4 f[4];
        for (int c = 0; c < 4; c++) {
            double *F = s->F + 16 * (b + m) + 4 * c;
            f[c] = load(F) + F_lag * r[m][c];
            store(F, f[c]);
        }
        extend_range(f, block[m].lanes, range);
        switch (block->material) {
#define CASE(i) case i: stress_of_block(s, b + m, i, f, r[m], stab[m], accounted_dt, dt); break;
            EACH_MATERIAL(CASE)
        }
    }
}

/* Stresses of all blocks.  F_lag: time since F was updated; accounted_dt, dt: Δtₙ and Δtₙ₊₁ of the accounts. */
void stress_of_rate(const KernelData *s, double F_lag, double accounted_dt, double dt)
{
    v4 range[2] = {load(s->J_range), load(s->J_range + 4)};
#define STRESS(n) stress_of_blocks(s, b, n, F_lag, accounted_dt, dt, range)
    EACH_BLOCK(0, s->n_owned_blocks, STRESS)
    EACH_BLOCK(s->n_owned_blocks, s->n_blocks, STRESS)
    store(s->J_range, range[0]);
    store(s->J_range + 4, range[1]);
}
