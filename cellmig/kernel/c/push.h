/* The directions in which cells push, how firmly they hold on to the substrate against it, and the accounts of this.
 *
 * A cell that protrudes pushes in SIDES directions along the substrate: drive c SIDES + m is a vector of D - 1
 * components, whose length is a factor of the push.  It changes linearly in time from knot to knot. */

#define PLANE (D - 1) /* dimensions of the substrate */

typedef struct { double strength, direction[PLANE]; } Drive;

static inline const Drive *drive_at(const KernelData *s, long m) { return (const Drive *)s->drive_now + m; }

/* Sets drive m for the time of the clock. */
static inline void set_drive(const KernelData *s, long m)
{
    Drive *drive = (Drive *)s->drive_now + m;
    double square = 0;
    for (int c = 0; c < PLANE; c++) {
        drive->direction[c] = s->drive[PLANE * m + c];
        if (GUIDED) drive->direction[c] += s->drive_clock[0] * s->drive_rate[PLANE * m + c];
        square += drive->direction[c] * drive->direction[c];
    }
    drive->strength = sqrt(square);
    for (int c = 0; c < PLANE && square > 0; c++) drive->direction[c] /= drive->strength;
}

/* Place of a particle along a direction. */
static inline double along(const KernelData *s, const Drive *drive, long node)
{
    double x = 0;
    for (int c = 0; c < PLANE; c++) x += drive->direction[c] * coordinate(s, node, TANGENT + c);
    return x;
}

/* Of each drive of each cell that protrudes, the middle of its surface in this direction, and how firmly its front half
 * holds on to the substrate.  Every rank that owns a part of the cell sums over all of it, in the same order. */
static void find_hold(const KernelData *s)
{
    for (long m = 0; m < SIDES * s->n_movers; m++) {
        const long c = m / SIDES;
        const Drive *drive = drive_at(s, m);
        double middle = 0, bonded = 0;
        set_drive(s, m);
        for (long k = s->first_mover[c]; k < s->first_mover[c + 1]; k++)
            middle += s->mover_weight[k] * along(s, drive, s->mover[k]);
        for (long k = s->first_grip[c]; k < s->first_grip[c + 1] && bonded < s->firm; k++) {
            const Facet e = facet_at(s, s->grip[k]);
            double x = 0;
            for (int i = 0; i < D; i++) x += along(s, drive, e.node[i]) / D;
            bonded += protrusion_grip(s->protrusion, e.size, x - middle, GAPS(e.gap));
        }
        s->middle[m] = middle;
        s->hold[m] = protrusion_hold(s->protrusion, bonded);
    }
}

/* Whether facet e is pushed, or was at the start of the step. */
static int is_pushed(const KernelData *s, long e)
{
    for (int i = 0; i < D; i++) {
        if (s->push[D * e + i] > 0) return 1;
        for (int c = 0; c < PLANE && GUIDED; c++)
            if (s->pushed[PLANE * (D * e + i) + c] != 0) return 1;
    }
    return 0;
}

/* Accounts of a force `now` on corner i of facet e along the substrate. */
static inline void account_push(const KernelData *s, const Facet *e, int i, const double now[PLANE],
                                double accounted_dt, double dt)
{
    double *pushed = s->pushed + PLANE * (D * e->number + i);
    s->protrusion_impulse[e->node[i]] += dt * now[0];
    for (int c = 0; c < PLANE; c++) {
        const double v = velocity(s, e->node[i], TANGENT + c);
        impulse_at(s, e, i, BY_PUSH)[c] += dt * now[c];
        s->external_work[e->node[i]] += 0.5 * (accounted_dt * pushed[c] + dt * now[c]) * v;
        pushed[c] = now[c];
    }
}
