/* Drag of the closed bonds between surfaces that slide along each other, over the pieces of contact.c. */

/* The piece of S beside an edge, by a law: forces; the loss of a time dt, on the ends of S. */
static void add_sliding_piece(const KernelData *s, const double *law, const Source *S, const Edge *e, double dt)
{
    double range[2] = {0, 1}, v[4][D], f[4][D], power;
    if (!piece_beside(s, S, e, range)) return;
    const long node[4] = {S->node[0], S->node[1], e->start, e->end};
    for (int i = 0; i < 4; i++)
        for (int c = 0; c < D; c++) v[i][c] = velocity(s, s->contact_node[node[i]], c);
    const double *a = s->contact_x + D * e->start, *b = s->contact_x + D * e->end;
    sliding_force(law, S->length, range[0], range[1], S->end[0], S->end[1], a, b, v[0], v[1], v[2], v[3], f, &power);
    for (int i = 0; i < 4; i++)
        for (int c = 0; c < D; c++) s->contact_force[D * node[i] + c] += f[i][c];
    for (int i = 0; i < 2; i++) s->friction_loss[s->contact_node[node[i]]] += 0.5 * dt * power;
}

/* Forces; impulses and losses of a time dt, see rubbing.c, unless `energy` says that forces alone are asked for. */
void add_sliding(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    place_nodes(s);
    for (long k = 0; k < s->n_contact_segments; k++) {
        const Source S = source_at(s, k);
        const double *law = s->sliding + SLIDING_STRIDE * s->contact_law[k] + 1;
        for (long n = s->first_listed[k]; n < s->first_listed[k + 1]; n++) {
            if (!(s->listed[2 * n + 1] & EDGE)) continue;
            const int32_t *of = s->contact_edge + 3 * s->listed[2 * n];
            const Edge e = beside_edge(s, &S, of[0], of[1]);
            add_sliding_piece(s, law, &S, &e, dt);
        }
    }
    give_forces(s, force, dt);
    for (long m = 0; !energy && m < s->n_contact_nodes; m++) rub(s, s->contact_node[m], s->contact_force + D * m);
}
