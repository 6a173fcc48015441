/* Drag of the closed bonds on membranes that slide along the substrate. */

/* Forces; impulses and losses of a time dt, see rubbing.c, unless `energy` says that forces alone are asked for. */
void add_friction(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    for (long k = 0; k < s->n_near; k++) {
        const Facet e = facet_at(s, s->near[k]);
        double v[D][D - 1], f[D][D];
        for (int i = 0; i < D; i++)
            for (int c = 0; c < D - 1; c++) v[i][c] = velocity(s, e.node[i], TANGENT + c);
        const double *law = s->friction + FRICTION_STRIDE * s->facet_friction[e.number] + 1;
        friction_force(law, LIGAND ? ligand_below(s, &e) * e.size : e.size, GAPS(e.gap), SLIDING(v), f);
        add_to_corners(force, e.node, f);
        for (int i = 0; !energy && i < D; i++) rub(s, e.node[i], f[i]);
        for (int i = 0; i < D; i++)
            for (int c = 0; c < D - 1; c++) {
                *impulse_at(s, &e, i, BY_DRAG + c) += dt * f[i][TANGENT + c];
                s->friction_loss[e.node[i]] -= dt * f[i][TANGENT + c] * v[i][c];
            }
    }
}
