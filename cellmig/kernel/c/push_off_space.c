/* Push of cells off other bodies in space, over the pieces of contact_space.c: on both, equal and opposite. */

/* A triangle T of a cell that pushes over a face: parameters of its law, pushes of its corners, the first of the cell's
 * drives, its overlap with the face, the energy of bonds there, and the area times the mean slope of the ramp. */
typedef struct { const double *law, *push; long drive; Overlap o; double stored, edge; } PushedPart;

/* The part of triangle k with these pieces; whether it pushes. */
static int pushed_part(const KernelData *s, PushedPart *p, long k, const Triangle *T, const Face *f, const v4 *on,
                       long n)
{
    if (s->contact_mover[k] < 0) return 0;
    const Four four = planes_on(T, &f->planes);
    const double *law = s->push_off + PUSH_OFF_STRIDE * s->contact_law[k] + 1;
    *p = (PushedPart){law, s->contact_push + D * k, SIDES * s->contact_mover[k], overlap_of(T, f, on, n), 0, 0};
    double gap[MOST_CORNERS];
    for (int i = 0; i < n; i++) gap[i] = value_at(&four, on[i])[3];
    for (int i = 0; i + 2 < n; i++)
        p->edge += T->area * fan(on, i) * push_off_edge(law, gap[0], gap[i + 1], gap[i + 2]);
    return p->o.area > 0;
}

/* What the middle of a part is ahead of the middle of its cell in the direction of drive m. */
static double ahead_of(const KernelData *s, const PushedPart *p, const Triangle *T, long m)
{
    const Drive *drive = drive_at(s, m);
    double ahead = -s->middle[m];
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < PLANE; c++) ahead += p->o.on[i] * drive->direction[c] * T->x[i][TANGENT + c];
    return ahead;
}

/* Adds the push of drive m on T and the face. */
static void push_part(const KernelData *s, const PushedPart *p, const Triangle *T, const Face *f, long m,
                      double *const force[3])
{
    const Drive *drive = drive_at(s, m);
    const double size = p->o.on[0] * p->push[0] + p->o.on[1] * p->push[1] + p->o.on[2] * p->push[2];
    const double along = push_off_force(p->law, drive->strength * size, s->hold_off[m], p->edge, ahead_of(s, p, T, m));
    v4 way = {0};
    for (int c = 0; c < PLANE; c++) way[TANGENT + c] = drive->direction[c];
    drag_along(T, f, &p->o, along * (way - dot4(way, f->normal) * f->normal), force);
}

/* The part in a meeting over a face; whether it pushes. */
static int part_in(const KernelData *s, PushedPart *p, const Meeting *m, const Face **f)
{
    if (s->contact_mover[m->triangle] < 0) return 0;
    const Triangle *T = kept.triangle + m->triangle;
    *f = face_at(s, m->feature, *s->contact_call);
    if (!pushed_part(s, p, m->triangle, T, *f, kept.of[OVER_FACE].on + m->from, m->n)) return 0;
    p->stored = stored_over_face(over_face_of(kept.of + OVER_FACE, m->action), T, *f);
    return 1;
}

/* Of each drive how firmly the bonds to other bodies hold the front half of its cell. */
static void find_hold_off(const KernelData *s)
{
    const Face *f;
    PushedPart p;
    aim_all(s);
    for (long n = 0; n < kept.of[OVER_FACE].lists; n++) {
        const Meeting *at = met_over_face(n);
        if (!at || !part_in(s, &p, at, &f)) continue;
        for (long m = p.drive; m < p.drive + SIDES; m++) {
            const double ahead = ahead_of(s, &p, kept.triangle + at->triangle, m);
            s->hold_off[m] += push_off_grip(p.law, p.o.area, p.stored, ahead);
        }
    }
    hold_all(s);
}

/* Forces; impulses and trapezoidal work of the steps, unless `energy` says that forces alone are asked for. */
void add_push_off(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    const Face *f;
    PushedPart p;
    if (energy) contact_now(s, 0, 0);
    forget_loads(s);
    find_hold_off(s);
    for (long n = 0; n < kept.of[OVER_FACE].lists; n++) {
        const Meeting *at = met_over_face(n);
        if (!at || !part_in(s, &p, at, &f)) continue;
        const int32_t *node;
        const double *x[3];
        double *load[3];
        nodes_of(s, OVER_FACE, at->feature, &node, x, load);
        for (long m = p.drive; m < p.drive + SIDES; m++) push_part(s, &p, kept.triangle + at->triangle, f, m, load);
    }
    if (!energy) account_push_off(s, accounted_dt, dt);
    give_loads(s, force, dt);
}
