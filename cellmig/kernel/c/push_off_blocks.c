/* The tangent of the push off other bodies in space, by central differences as in contact_blocks.c. */

/* Adds what drive m does in a pair, at the middle and the hold of its cell; closed bonds that count. */
static double push_in_pair(const KernelData *s, Pair *p, long m)
{
    const double *x[MOST_IN_PAIR];
    double *force[MOST_MOVED];
    PushedPart part;
    Triangle T = triangle_in_pair(s, p, x, force);
    Face f;
    set_face(&f, x);
    const double stored = find_in_pair(&T, &f)->load[3];
    if (!in_pair.used || !pushed_part(s, &part, p->triangle, &T, &f, in_pair.on, in_pair.used)) return 0;
    push_part(s, &part, &T, &f, m, force);
    return push_off_grip(part.law, part.o.area, stored, ahead_of(s, &part, &T, m));
}

/* The pair of a triangle that pushes and the face number `near` of those near it; whether it may act. */
static int set_pushing(const KernelData *s, Pair *p, const Near *faces, long k, long near)
{
    if (s->contact_mover[k] < 0 || !may_act(s, faces, k, near)) return 0;
    set_pair(s, p, OVER_FACE, k, s->contact_face + 3L * faces->feature[near], 3, 3);
    return 1;
}

/* As contact_blocks, at the middles and holds of cells as they are. */
int push_off_blocks(const KernelData *s, double h, double by_u, double by_v, long secant, long *row, long *column,
                    double *block)
{
    const Near faces = near_of(s, OVER_FACE);
    Pair p;
    long n = 0;
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long near = faces.first[k]; near < faces.first[k + 1]; near++) {
            if (!set_pushing(s, &p, &faces, k, near)) continue;
            for (long m = SIDES * s->contact_mover[k]; row && m < SIDES * (s->contact_mover[k] + 1); m++)
                for (int j = 0; j < 6; j++)
                    for (int c = 0; c < D; c++) {
                        double before[MOST_MOVED][D + 1];
                        const double x = p.x[j][c];
                        p.x[j][c] = x - h;
                        push_in_pair(s, &p, m);
                        memcpy(before, p.force, sizeof before);
                        p.x[j][c] = x + h;
                        push_in_pair(s, &p, m);
                        p.x[j][c] = x;
                        for (int i = 0; i < 6; i++) {
                            const long b = n + 6L * j + i;
                            row[b] = s->contact_node[p.node[i]];
                            column[b] = s->contact_node[p.node[j]];
                            for (int r = 0; r < D; r++)
                                block[D * (D * b + r) + c] += by_u * (before[i][r] - p.force[i][r]) / (2 * h);
                        }
                    }
            n += 36;
        }
    return (int)n;
}

/* Derivatives of what drive m does, for nodes of contact (n, D): of the forces on them by the middle of the cell and by
 * its hold, and of closed bonds by their places; of closed bonds by the middle, and all of these. */
int push_off_of_cell(const KernelData *s, double h, long m, double *by_middle, double *by_hold, double *of_bonds,
                     double total[2])
{
    const Near faces = near_of(s, OVER_FACE);
    const double hold = s->hold_off[m], middle = s->middle[m];
    Pair p;
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long near = faces.first[k]; near < faces.first[k + 1]; near++) {
            if (s->contact_mover[k] != m / SIDES || !set_pushing(s, &p, &faces, k, near)) continue;
            double before[MOST_MOVED][D + 1];
            s->middle[m] = middle - h;
            total[0] -= push_in_pair(s, &p, m) / (2 * h);
            memcpy(before, p.force, sizeof before);
            s->middle[m] = middle + h;
            total[0] += push_in_pair(s, &p, m) / (2 * h);
            s->middle[m] = middle;
            for (int i = 0; i < 6; i++)
                for (int c = 0; c < D; c++)
                    by_middle[D * p.node[i] + c] += (p.force[i][c] - before[i][c]) / (2 * h);
            s->hold_off[m] = 1;
            total[1] += push_in_pair(s, &p, m);
            s->hold_off[m] = hold;
            for (int i = 0; i < 6; i++)
                for (int c = 0; c < D; c++) by_hold[D * p.node[i] + c] += p.force[i][c];
            for (int j = 0; j < 6; j++)
                for (int c = 0; c < D; c++) {
                    const double x = p.x[j][c];
                    p.x[j][c] = x - h;
                    const double less = push_in_pair(s, &p, m);
                    p.x[j][c] = x + h;
                    of_bonds[D * p.node[j] + c] += (push_in_pair(s, &p, m) - less) / (2 * h);
                    p.x[j][c] = x;
                }
        }
    return 0;
}
