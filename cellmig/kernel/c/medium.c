/* Drag of the liquid around the cells, on all of their surfaces. */

/* Forces; trapezoidal losses of the steps, unless `energy` says that forces alone are asked for. */
void add_medium(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long k = 0; k < s->n_immersed; k++) {
        const long i = s->immersed[k];
        double *before = s->dragged + D * k, v[D], now[D];
        for (int c = 0; c < D; c++) v[c] = velocity(s, i, c);
        medium_force(s->medium, s->immersed_size[k], v, now);
        for (int c = 0; c < D; c++) {
            force[D * i + c] += now[c];
            if (energy) continue;
            s->medium_loss[i] -= 0.5 * (accounted_dt * before[c] + dt * now[c]) * v[c];
            before[c] = now[c];
        }
    }
}
