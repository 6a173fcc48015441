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
        long node[D];
        double edge[D - 1][D], f[D][D];
        for (int i = 0; i < D; i++) node[i] = s->pressed[D * k + i];
        for (int i = 1; i < D; i++) edge_between(s, node[0], node[i], edge[i - 1]);
        loads_force(0, s->pressure[k] * load_curve_value(s, s->pressed_curve[k], s->clock[0]), EDGES(edge), f);
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
