/* Supports and plates at the time of the clock: they change positions and velocities after the kick and drift. */

/* The state before the kick, where supports and plates may change it. */
void remember_boundary(const KernelData *s)
{
    for (long k = 0; k < s->n_held; k++) {
        s->held_before[2 * k] = s->state[s->held[k]];
        s->held_before[2 * k + 1] = s->state[s->held[k] + D];
    }
    for (long k = 0; k < s->n_platable; k++)
        for (int c = 0; c < D; c++) s->plate_before[D * k + c] = velocity(s, s->platable[k], c);
}

/* Particle platable[k] is put back on the face of plate p if it is inside.  The plate does work by its own speed; the
 * rest of what the blow takes is lost. */
static void stop_at_plate(const KernelData *s, long k, long p, double kick, double dt)
{
    const long i = s->platable[k], of = s->plate_curve[p];
    const double *n = s->plate + 3 * D * p, *point = n + D, *d = n + 2 * D, t = s->clock[0];
    const double now = load_curve_value(s, of, t + dt), then = load_curve_value(s, of, t);
    double *z = s->state + 2 * D * i, gap = 0, mean = 0;
    for (int c = 0; c < D; c++) gap += n[c] * (s->X[D * i + c] + z[c] - point[c] - now * d[c]);
    s->plate_force[k * s->n_plates + p] = 0;
    if (gap >= 0) return;
    for (int c = 0; c < D; c++) {
        z[c] -= gap * n[c];
        z[D + c] -= gap / dt * n[c];
        mean += 0.5 * n[c] * (s->plate_before[D * k + c] + z[D + c]);
    }
    const double impulse = -gap / (dt * s->inverse_mass[i]);
    double speed = 0;
    for (int c = 0; c < D; c++) speed += n[c] * d[c] * (now - then) / dt;
    s->plate_force[k * s->n_plates + p] = impulse / kick;
    s->external_work[i] += impulse * speed;
    s->artificial_dissipation[i] += impulse * (speed - mean);
}

/* All particles that may meet a plate, with all plates. */
void stop_at_plates(const KernelData *s, double kick, double dt)
{
    for (long k = 0; k < s->n_platable; k++)
        for (long p = 0; p < s->n_plates; p++) stop_at_plate(s, k, p, kick, dt);
}

/* Supports: u as prescribed at the end of the step, v the velocity that leads there; the reaction and its work. */
void hold(const KernelData *s, double kick, double dt)
{
    for (long k = 0; k < s->n_held; k++) {
        const long d = s->held[k], i = d / (2 * D);
        const double u = s->held_value[k] * load_curve_value(s, s->held_curve[k], s->clock[0] + dt);
        const double v = (u - s->held_before[2 * k]) / dt;
        const double impulse = (v - s->state[d + D]) / s->inverse_mass[i];
        s->reaction[k] = impulse / kick;
        s->external_work[i] += 0.5 * impulse * (s->held_before[2 * k + 1] + v);
        s->state[d] = u;
        s->state[d + D] = v;
    }
}

void advance_clock(const KernelData *s, double dt) { tick(s->clock, dt); }

/* Supports: u and v as prescribed at the time of the clock. */
void prescribe(const KernelData *s)
{
    for (long k = 0; k < s->n_held; k++) {
        s->state[s->held[k]] = s->held_value[k] * load_curve_value(s, s->held_curve[k], s->clock[0]);
        s->state[s->held[k] + D] = s->held_value[k] * load_curve_rate(s, s->held_curve[k], s->clock[0]);
    }
}

/* Supports: rates as prescribed, and the reactions. */
void hold_rate(const KernelData *s, double *out)
{
    for (long k = 0; k < s->n_held; k++) {
        const long d = s->held[k];
        const double a = s->held_value[k] * load_curve_acceleration(s, s->held_curve[k], s->clock[0]);
        s->reaction[k] = (a - out[d + D]) / s->inverse_mass[d / (2 * D)];
        out[d] = s->held_value[k] * load_curve_rate(s, s->held_curve[k], s->clock[0]);
        out[d + D] = a;
    }
}

/* Work of the reactions in a time dt. */
void account_reactions(const KernelData *s, double dt)
{
    for (long k = 0; k < s->n_held; k++)
        s->external_work[s->held[k] / (2 * D)] += dt * s->reaction[k] * s->state[s->held[k] + D];
}
