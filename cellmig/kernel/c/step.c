/* The step: M u'' = F_body + F_cs + F_cc + F_d - F_int, equation (2), in total Lagrangian form.
 *
 * The functions before_stress, add_surface_forces, add_forces_in_motion, after_forces, before_kick, after_drift,
 * pass_time, hold_rates and account_holds are generated: they call those of the files that the scene has.
 */

/* Surface forces of both ends of a step, or of an instant; those on ghosts are for their owners to compute. */
static void surface_forces(const KernelData *s, double accounted_dt, double dt)
{
    memset(s->force + D * s->n_owned, 0, sizeof(double) * D * (size_t)(s->n_local - s->n_owned));
    add_surface_forces(s, accounted_dt, dt);
}

/* Resets forces from which no step is made. */
static void forget_forces(const KernelData *s) { memset(s->force, 0, sizeof(double) * D * (size_t)s->n_local); }

/* Losses and work that blocks have accounted go to their particles. */
static void settle_accounts(const KernelData *s)
{
    for (long b = 0; b < s->n_blocks; b++) {
        const Block block = *block_at(s, b);
        StepMemory *memory = s->step_memory + b;
        for (int i = 0; i < block.lanes; i++) {
            s->viscous_loss[block.row + i] += memory->viscous_loss[i];
            s->artificial_dissipation[block.row + i] += memory->artificial_dissipation[i];
            memory->viscous_loss[i] = memory->artificial_dissipation[i] = 0;
            if (NETWORK) {
                s->network_loss[block.row + i] += memory->network_loss[i];
                memory->network_loss[i] = 0;
            }
            if (!ACTIVE) continue;
            s->external_work[block.row + i] += memory->external_work[i];
            memory->external_work[i] = 0;
        }
    }
}

/* n steps, symplectic: v by the force at u, from the middle of the last step to that of the coming one, then u by the
 * new v.  F_lag: time since F was updated; accounted_dt: Δt of the last kick, of whose trapezoidal work this step's
 * forces are the end; dt_prev: the step before the first. */
int advance(const KernelData *s, long n, double dt, double F_lag, double accounted_dt, double dt_prev)
{
    for (long i = 0; i < n; i++, F_lag = dt_prev = dt) {
        const double kick = 0.5 * (dt_prev + dt);
        if (before_stress(s)) return 1;
        stress_of_rate(s, F_lag, accounted_dt, kick);
        surface_forces(s, accounted_dt, kick);
        if (dt_prev > 0) add_forces_in_motion(s, kick); /* at the start speeds are not half a step old */
        if (after_forces(s, dt)) return 1;
        if (CONSTRAINED) {
            before_kick(s);
            kick_and_drift(s, kick, dt);
            after_drift(s, kick, dt);
            if (exchange(s, s->state_vec)) return 1;
        } else { /* shared particles first: others get their copies meanwhile */
            kick_and_drift_some(s, 0, s->n_shared_blocks, kick, dt);
            if (s->ghost_begin && s->ghost_begin(s->state_vec, 1, 0)) return 1;
            kick_and_drift_some(s, s->n_shared_blocks, s->n_owned_blocks, kick, dt);
            if (s->ghost_end && s->ghost_end(s->state_vec, 1, 0)) return 1;
        }
        pass_time(s, dt);
        accounted_dt = kick;
    }
    return 0;
}

/* Rates (v, a) of the owned particles for the state as it is; the work of the last kick is completed.  F_lag: time
 * since F was updated. */
int rate(const KernelData *s, double *out, double F_lag, double accounted_dt)
{
    if (before_stress(s)) return 1;
    if (NETWORK && F_lag > 0) networks_follow(s, F_lag);
    deformation(s);
    stress_of_rate(s, 0.0, accounted_dt, 0.0);
    surface_forces(s, accounted_dt, 0.0);
    if (after_forces(s, 0.0)) return 1;
    for (long b = 0; b < s->n_owned_blocks; b++) {
        const Block block = *block_at(s, b);
        v4 f[1][FORCES];
        divergence(s, b, 1, f);
        for (int i = 0; i < block.lanes; i++)
            for (int c = 0; c < D; c++) {
                const long row = block.row + i, k = 2 * D * row + c;
                out[k] = s->state[k + D];
                out[k + D] = s->inverse_mass[row] * force_on(f[0], i, c) + s->acceleration[c];
            }
    }
    hold_rates(s, out);
    settle_accounts(s);
    return 0;
}

/* Accounts of losses and work over a time dt, at the state as it is; reactions are those of `rate`.  Work is
 * trapezoidal: the first evaluation of the surface forces leaves what the second takes for those at the start. */
void account(const KernelData *s, double dt)
{
    deformation(s);
    stress_of_rate(s, 0.0, 0.0, 2.0 * dt);
    if (NETWORK) networks_lose(s, dt);
    account_holds(s, dt);
    settle_accounts(s);
    surface_forces(s, 0.0, 0.0);
    surface_forces(s, dt, dt);
    forget_forces(s);
}

/* A step of the director alone, for integrators that hold it still within a step. */
int relax_director(const KernelData *s, double dt)
{
    const int failed = before_stress(s) || after_forces(s, dt);
    forget_forces(s);
    return failed;
}
