/* The directions in which cells push, and the middles of their surfaces.
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
        if (GUIDED) drive->direction[c] += (s->drive_clock[0] - s->drive_time) * s->drive_rate[PLANE * m + c];
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

/* Sets drive m of cell c for the time of the clock, and the middle of the cell's surface in its direction.  Every rank
 * that owns a part of the cell sums over all of it, in the same order. */
static const Drive *aim(const KernelData *s, long c, long m)
{
    const Drive *drive = drive_at(s, m);
    double middle = 0;
    set_drive(s, m);
    for (long k = s->first_mover[c]; k < s->first_mover[c + 1]; k++)
        middle += s->mover_weight[k] * along(s, drive, s->mover[k]);
    s->middle[m] = middle;
    return drive;
}
