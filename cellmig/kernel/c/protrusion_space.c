/* F_d of equation (2) in space: push of the leading edge, over the triangles near the substrate. */

/* Areas of closed bonds of n triangles that count to the front half, `ahead` of the middle of the cell. */
static void find_grips(const KernelData *s, const Facet *e, const double ahead[TOGETHER], int n, double area[TOGETHER])
{
    int order[TOGETHER];
    double size[TOGETHER], gap[D][TOGETHER], kind[TOGETHER];
    sizes_and_gaps(e, n, size, gap);
    for (int m = 0; m < n; m += 4)
        store(kind + m, protrusion_grip_kind(s->protrusion, load(gap[0] + m), load(gap[1] + m), load(gap[2] + m)));
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        put(area, of, protrusion_grip(s->protrusion, pick(size, of), pick(ahead, of), pick(gap[0], of),
                                      pick(gap[1], of), pick(gap[2], of)));
    }
}

/* Area of closed bonds under the front half of a cell along a drive, up to what holds it. */
static double bonded_along(const KernelData *s, const Drive *drive, long m)
{
    const long c = m / SIDES;
    Facet e[TOGETHER];
    double ahead[TOGETHER], area[TOGETHER], bonded = 0;
    for (long k = s->first_grip[c]; k < s->first_grip[c + 1] && bonded < s->firm;) {
        int n = 0;
        for (; n < TOGETHER && k < s->first_grip[c + 1]; k++) {
            e[n] = facet_at(s, s->grip[k]);
            ahead[n] = ahead_of_middle(s, drive, m, e + n);
            n += protrusion_front(s->protrusion, ahead[n]) > 0;
        }
        find_grips(s, e, ahead, n, area);
        for (int i = 0; i < n; i++) bonded += area[i];
    }
    return bonded;
}

/* A triangle that is pushed: forces on its corners, over the mean slope of the ramp. */
typedef struct { Facet e; double push[D][PLANE]; } Pushed;

/* Sets that of facet k; whether any force is there, or was at the start of the step. */
static int set_pushed(const KernelData *s, long k, Pushed *p)
{
    if (!is_pushed(s, k)) return 0;
    *p = (Pushed){.e = facet_at(s, k)};
    int any = 0;
    for (long m = SIDES * s->mover_of[k]; m < SIDES * (s->mover_of[k] + 1); m++) {
        const Drive *drive = drive_at(s, m);
        for (int i = 0; i < D; i++) {
            const double push = s->push[D * k + i];
            if (!(push > 0)) continue;
            const double ahead = along(s, drive, p->e.node[i]) - s->middle[m];
            const double size = s->hold[m] * p->e.size * push * protrusion_front(s->protrusion, ahead);
            for (int c = 0; c < PLANE; c++) p->push[i][c] += drive->strength * size * drive->direction[c];
        }
    }
    for (int i = 0; i < D; i++)
        for (int c = 0; c < PLANE; c++)
            any |= p->push[i][c] != 0 || s->pushed[PLANE * (D * k + i) + c] != 0;
    return any;
}

/* Mean slopes of the ramp over n triangles. */
static void find_slopes(const KernelData *s, const Pushed *p, int n, double slope[TOGETHER])
{
    int order[TOGETHER];
    double gap[D][TOGETHER], kind[TOGETHER];
    for (int m = 0; m < n; m++)
        for (int i = 0; i < D; i++) gap[i][m] = p[m].e.gap[i];
    for (int m = 0; m < n; m += 4)
        store(kind + m, protrusion_kind(s->protrusion, load(gap[0] + m), load(gap[1] + m), load(gap[2] + m)));
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        put(slope, of, protrusion_edge(s->protrusion, pick(gap[0], of), pick(gap[1], of), pick(gap[2], of)));
    }
}

/* Forces; impulses and trapezoidal work of the steps, unless `energy` says that forces alone are asked for.  push[D e]
 * and on hold β α N σ/D of the corners of facet e, `pushed` their forces at the start of the step. */
void add_protrusion(const KernelData *s, double *force, double *energy, double accounted_dt, double dt)
{
    Pushed found[TOGETHER];
    double slope[TOGETHER];
    find_hold(s);
    for (long k = 0; k < s->n_near;) {
        int n = 0;
        for (; n < TOGETHER && k < s->n_near; k++) n += set_pushed(s, s->near[k], found + n);
        find_slopes(s, found, n, slope);
        for (int m = 0; m < n; m++)
            for (int i = 0; i < D; i++) {
                double now[PLANE];
                for (int c = 0; c < PLANE; c++) {
                    now[c] = found[m].push[i][c] * slope[m];
                    force[D * found[m].e.node[i] + TANGENT + c] += now[c];
                }
                if (!energy) account_push(s, &found[m].e, i, now, accounted_dt, dt);
            }
    }
}
