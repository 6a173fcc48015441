/* Tractions, pressures and loads on bodies at the time of the clock. */

/* Forces, and their external work, trapezoidal as that of the protrusion. */
void add_loads(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    double *load = s->load;
    for (long k = 0; k < s->n_loaded; k++)
        for (int c = 0; c < D; c++) load[D * s->loaded[k] + c] = 0;
    for (long k = 0; k < s->n_dead; k++) {
        const double factor = load_curve_value(s, s->dead_curve[k], s->clock[0]);
        for (int c = 0; c < D; c++) load[D * s->dead[k] + c] += factor * s->dead_force[D * k + c];
    }
    for (long k = 0; k < s->n_pressed; k++) {
        const long node[2] = {s->pressed[2 * k], s->pressed[2 * k + 1]};
        double edge[D], f[D][D];
        edge_between(s, node[0], node[1], edge);
        loads_force(0, s->pressure[k] * load_curve_value(s, s->pressed_curve[k], s->clock[0]), edge, f);
        add_to_corners(load, node, f);
    }
    for (long k = 0; k < s->n_loaded; k++) {
        const long i = s->loaded[k];
        if (i >= s->n_owned) continue;
        for (int c = 0; c < D; c++) {
            const double now = load[D * i + c];
            double *before = s->load_before + D * i + c;
            force[D * i + c] += now;
            s->external_work[i] += 0.5 * (accounted_dt * *before + dt * now) * velocity(s, i, c);
            *before = now;
        }
    }
}
