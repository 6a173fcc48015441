/* Push of cells off other bodies, over the pieces of contact.c: on both, equal and opposite. */

/* A piece of a segment that pushes: its parameters, the segment, the edge beside it, and its range on the segment. */
typedef struct { const double *law; Source S; Edge e; double range[2]; const double *a, *b; } PushedPiece;

/* Sets the piece of segment k beside listed edge n; whether there is one. */
static int pushed_piece(const KernelData *s, PushedPiece *p, long k, long n)
{
    if (!(s->listed[2 * n + 1] & EDGE)) return 0;
    const int32_t *of = s->contact_edge + 3 * s->listed[2 * n];
    p->law = s->push_off + PUSH_OFF_STRIDE * s->contact_law[k] + 1;
    p->S = source_at(s, k);
    p->e = beside_edge(s, &p->S, of[0], of[1]);
    p->range[0] = 0, p->range[1] = 1;
    p->a = s->contact_x + D * p->e.start, p->b = s->contact_x + D * p->e.end;
    return piece_beside(s, &p->S, &p->e, p->range);
}

/* What both ends of S are ahead of the middle of its cell in the direction of drive m. */
static void set_ahead(const KernelData *s, const PushedPiece *p, long m, double ahead[2])
{
    for (int i = 0; i < 2; i++) ahead[i] = along(s, drive_at(s, m), s->contact_node[p->S.node[i]]) - s->middle[m];
}

/* Of each drive how firmly the bonds to other bodies hold the front half of its cell. */
static void find_hold_off(const KernelData *s)
{
    PushedPiece p;
    aim_all(s);
    for (long k = 0; k < s->n_contact_segments; k++) {
        const long c = s->contact_mover[k];
        for (long n = s->first_listed[k]; c >= 0 && n < s->first_listed[k + 1]; n++) {
            if (!pushed_piece(s, &p, k, n)) continue;
            for (long m = SIDES * c; m < SIDES * (c + 1); m++) {
                double ahead[2];
                set_ahead(s, &p, m, ahead);
                s->hold_off[m] += push_off_grip(p.law, p.S.length, p.range[0], p.range[1], ahead, p.S.end[0],
                                                p.S.end[1], p.a, p.b);
            }
        }
    }
    hold_all(s);
}

/* Adds what a piece exerts on the nodes of S and of the edge. */
static void push_piece(const KernelData *s, const PushedPiece *p, long k)
{
    const long node[4] = {p->S.node[0], p->S.node[1], p->e.start, p->e.end}, c = s->contact_mover[k];
    for (long m = SIDES * c; m < SIDES * (c + 1); m++) {
        const Drive *drive = drive_at(s, m);
        double f[4][D], ahead[2];
        set_ahead(s, p, m, ahead);
        push_off_force(p->law, s->contact_push + D * k, s->hold_off[m], drive->strength * drive->direction[0],
                       p->S.length, p->range[0], p->range[1], ahead, p->S.end[0], p->S.end[1], p->a, p->b, f);
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < D; j++) s->contact_force[D * node[i] + j] += f[i][j];
    }
}

/* Forces; impulses and trapezoidal work of the steps, unless `energy` says that forces alone are asked for. */
void add_push_off(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    PushedPiece p;
    place_nodes(s);
    find_hold_off(s);
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long n = s->first_listed[k]; s->contact_mover[k] >= 0 && n < s->first_listed[k + 1]; n++)
            if (pushed_piece(s, &p, k, n)) push_piece(s, &p, k);
    if (!energy) account_push_off(s, accounted_dt, dt);
    give_forces(s, force, dt);
}
