/* Drag of the closed bonds on membranes that slide along the substrate. */

/* Forces; impulses and losses of a time dt. */
void add_friction(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long k = 0; k < s->n_near; k++) {
        const Facet e = facet_at(s, s->near[k]);
        const double v[2] = {velocity(s, e.node[0], TANGENT), velocity(s, e.node[1], TANGENT)};
        double f[2][D];
        friction_force(s->friction, e.size, e.gap[0], e.gap[1], v[0], v[1], f);
        add_to_corners(force, e.node, f);
        for (int i = 0; i < 2; i++) {
            *impulse_at(s, &e, i, BY_DRAG) += dt * f[i][TANGENT];
            s->friction_loss[e.node[i]] -= dt * f[i][TANGENT] * v[i];
        }
    }
}
