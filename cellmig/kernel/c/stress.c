/* Pass 1 of the internal force: F, the first Piola-Kirchhoff stress P of each material, what dissipates. */

/* P : R, the power of a stress per volume. */
static inline v4 power(const v4 P[D][D], const v4 R[D][D])
{
    v4 sum = {0};
    for (int i = 0; i < D; i++) {
        v4 row = P[i][D - 1] * R[i][D - 1];
        for (int j = D - 1; j--;) row = fma4(P[i][j], R[i][j], row);
        sum += row;
    }
    return sum;
}

/* ½ (Δtₙ Pₙ + Δtₙ₊₁ Pₙ₊₁) : Ḟ, the trapezoidal work of a stress that depends on the rate; Pₙ₊₁ is remembered. */
static inline v4 work_of_stress(float *memory, const v4 P[D][D], const v4 R[D][D], double accounted_dt, double dt)
{
    v4 mean[D][D];
    for (int i = 0; i < D * D; i++) {
        mean[i / D][i % D] = fma4(splat(0.5 * accounted_dt), load_single(memory + 4 * i), 0.5 * dt * P[i / D][i % D]);
        store_single(memory + 4 * i, P[i / D][i % D]);
    }
    return power(mean, R);
}

/* The same of the stress that is conjugate to the Laplacian of v. */
static inline v4 work_of_bending(float *memory, const v4 q[D], const v4 rate[D], double accounted_dt, double dt)
{
    v4 work = {0};
    for (int i = 0; i < D; i++) {
        work += fma4(splat(0.5 * accounted_dt), load_single(memory + 4 * i), 0.5 * dt * q[i]) * rate[i];
        store_single(memory + 4 * i, q[i]);
    }
    return work;
}

/* P += A. */
static inline void add_stress(v4 P[D][D], v4 A[D][D])
{
    for (int i = 0; i < D * D; i++) P[i / D][i % D] += A[i / D][i % D];
}

static inline void scale(v4 A[D][D], v4 V)
{
    for (int i = 0; i < D * D; i++) A[i / D][i % D] *= V;
}

/* V P of what stores energy: the material, and the gradient of the director. */
INLINED void elastic(const KernelData *s, long b, const int material, const v4 F[D][D], v4 V, v4 P[D][D])
{
    v4 A[D][D] = {{{0}}}, share = {0};
    if (NETWORK) {
        load_network(s, b, A);
        share = splat(s->network_share[material]);
    }
    stress(s, material, F, A, share, P);
    if (has_director_stress(material)) {
        v4 g[M][D], T[D][D];
        load_director_gradient(s, b, g);
        director_stress(s, material, F, g, T);
        add_stress(P, T);
    }
    if (GRADED) V *= load(s->grade + 4L * block_at(s, b)->stencil);
    scale(P, V);
}

/* Adds the viscous stress and that of the stabilisation, with the Laplacians (C u, C v).  What they dissipate is the
 * viscous loss of a viscous material: the stabilisation restores what nodal integration misses of it. */
INLINED void viscous(const KernelData *s, const Block *block, StepMemory *memory, const int material,
                     const v4 F[D][D], const v4 R[D][D], const v4 bend[2 * D], v4 V, double accounted_dt,
                     double dt, v4 P[D][D], v4 bent[D])
{
    if (!STABILISED && !has_viscous_stress(material)) return;
    v4 W[D][D] = {{{0}}}, work = {0};
    if (has_viscous_stress(material)) {
        viscous_stress(s, material, F, R, W);
        scale(W, V);
    }
    if (STABILISED) {
        v4 q[D], T[D][D];
        stabilisation_stress(0, load(s->bending_weight + 4L * block->stencil), F, R, bend, bend + D, q, T);
        add_stress(W, T);
        for (int i = 0; i < D; i++) bent[i] += q[i];
        work = work_of_bending(memory->bent, q, bend + D, accounted_dt, dt);
    }
    add_stress(P, W);
    work += work_of_stress(memory->viscous, W, R, accounted_dt, dt);
    add(has_viscous_stress(material) ? memory->viscous_loss : memory->artificial_dissipation, work);
}

/* Adds the active stress along the director; its work comes from outside. */
INLINED void active(const KernelData *s, long b, StepMemory *memory, const int material, const v4 F[D][D],
                    const v4 R[D][D], v4 V, double accounted_dt, double dt, v4 P[D][D])
{
    if (!has_active_stress(material)) return;
    const double *axis = s->director_axis + 4 * D * b;
    v4 h[D], A[D][D];
    for (int c = 0; c < D; c++) h[c] = load(axis + 4 * c);
    active_stress(s, material, F, h, A);
    scale(A, V);
    add_stress(P, A);
    add(memory->external_work, -work_of_stress(memory->active, A, R, accounted_dt, dt));
}

/* Adds the numerical damping of sound; returns the work that it takes. */
static inline v4 bulk_damping(StepMemory *memory, v4 viscosity, const v4 F[D][D], const v4 R[D][D],
                              double accounted_dt, double dt, v4 P[D][D])
{
    v4 damping[D][D], q, rate;
    bulk_damping_stress(0, viscosity, F, R, damping, &q, &rate);
    add_stress(P, damping);
    const v4 work = (0.5 * accounted_dt * load_single(memory->bulk) + 0.5 * dt * q) * rate;
    store_single(memory->bulk, q);
    return work;
}

/* Stress of block b, of this material, from F and Ḟ (entries by columns), after a network has followed F for F_lag;
 * work over the steps is accounted. */
INLINED void stress_of_block(const KernelData *s, long b, const int material, const v4 f[D * D], const v4 r[D * D],
                             const v4 bend[2 * D], double F_lag, double accounted_dt, double dt)
{
    const Block *block = block_at(s, b);
    v4 F[D][D], R[D][D];
    matrix_of(f, F);
    matrix_of(r, R);
    const v4 V = load(s->volume + 4L * block->stencil);
    StepMemory *memory = s->step_memory + b;
    v4 P[D][D], bent[D] = {{0}};
    if (NETWORK && F_lag > 0) {
        v4 before[D][D];
        for (int k = 0; k < D * D; k++) before[k % D][k / D] = f[k] - F_lag * r[k];
        renew_network(s, b, material, before, F, F_lag);
    }
    elastic(s, b, material, F, V, P);
    if (STIFFENED)
        for (int i = 0; i < D; i++) bent[i] = load(s->bending_modulus + 4L * block->stencil) * bend[i];
    viscous(s, block, memory, material, F, R, bend, V, accounted_dt, dt, P, bent);
    active(s, b, memory, material, F, R, V, accounted_dt, dt, P);
    if (BULK_DAMPED) {
        const v4 viscosity = V * load(s->bulk_damping + 4L * block->stencil);
        add(memory->artificial_dissipation, bulk_damping(memory, viscosity, F, R, accounted_dt, dt, P));
    }
    store_stress(s, block, P, bent);
}

/* A quantity a time later, which is stored. */
static inline v4 advanced(double *at, double time, v4 rate)
{
    const v4 now = load(at) + time * rate;
    store(at, now);
    return now;
}

/* Stresses of n blocks of one stencil at b, after F += F_lag Ḟ and C u likewise; `range` gets the extremes of J. */
INLINED void stress_of_blocks(const KernelData *s, long b, const int n, double F_lag, double accounted_dt, double dt,
                              v4 range[2])
{
    const Block *block = block_at(s, b);
    v4 r[MOST][D * D], rate[MOST][D];
    gather_both(s, block, n, BENDS, s->state + D, r, rate);
    for (int m = 0; m < n; m++) {
        v4 f[D * D], bend[2 * D];
        for (int k = 0; k < D * D; k++) f[k] = advanced(s->F + 4 * (D * D * (b + m) + k), F_lag, r[m][k]);
        for (int c = 0; BENDS && c < D; c++) {
            bend[c] = advanced(s->bend + 4 * (D * (b + m) + c), F_lag, rate[m][c]);
            bend[D + c] = rate[m][c];
        }
        extend_range(f, block[m].lanes, range);
        switch (block->material) {
#define CASE(i) case i: stress_of_block(s, b + m, i, f, r[m], bend, F_lag, accounted_dt, dt); break;
            EACH_MATERIAL(CASE)
        }
    }
}

/* Stresses of some blocks.  F_lag: time since F was updated; accounted_dt, dt: Δtₙ and Δtₙ₊₁ of the accounts. */
static void stress_of_some(const KernelData *s, long from, long end, double F_lag, double accounted_dt, double dt)
{
    v4 range[2] = {load(s->J_range), load(s->J_range + 4)};
#define STRESS(n) stress_of_blocks(s, b, n, F_lag, accounted_dt, dt, range)
    EACH_BLOCK(from, end, STRESS)
    store(s->J_range, range[0]);
    store(s->J_range + 4, range[1]);
}

/* The same of all blocks. */
void stress_of_rate(const KernelData *s, double F_lag, double accounted_dt, double dt)
{
    if (NETWORK && F_lag > 0) set_network_step(s, F_lag);
    stress_of_some(s, 0, s->n_owned_blocks, F_lag, accounted_dt, dt);
    stress_of_some(s, s->n_owned_blocks, s->n_blocks, F_lag, accounted_dt, dt);
}
