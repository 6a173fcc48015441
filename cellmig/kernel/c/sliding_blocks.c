/* The tangent of drag between surfaces in space, by central differences as in contact_blocks.c. */

static const double SLOWEST = 1e-16; /* speed of which the ratio is taken [µm/µs] */

/* A pair of a triangle and a face that slide: velocities of their corners, law, drag over speed if that stays, and
 * the speed. */
typedef struct { Pair pair; v4 v[6]; const double *law; double fixed, speed; } SlidingPair;

/* Sets what acts in a pair; drag over speed, 0 if none acts. */
static double slide_in_pair(const KernelData *s, SlidingPair *p)
{
    const double *x[MOST_IN_PAIR];
    double *force[MOST_MOVED], drag[3];
    Triangle T = triangle_in_pair(s, &p->pair, x, force);
    Face f;
    set_face(&f, x);
    const double stored = find_in_pair(&T, &f)->load[3];
    if (!in_pair.used) return 0;
    const Overlap o = overlap_of(&T, &f, in_pair.on, in_pair.used);
    if (!(o.area > 0)) return 0;
    if (!(p->fixed > 0)) slide(p->law, &T, &f, &o, stored, p->v, force);
    const v4 w = velocity_along(&f, &o, p->v);
    if (p->fixed > 0) drag_along(&T, &f, &o, -p->fixed * w, force);
    p->speed = d_maximum(sqrt(dot4(w, w)), SLOWEST);
    sliding_drag(p->law, o.area, stored, (double[3]){p->speed, 0, 0}, drag);
    return -drag[0] / p->speed;
}

/* Change of speeds for their derivatives: far below that at which the pair slides, at which a drag may begin to fall,
 * but far above rounding errors of the speeds themselves [µm/µs]. */
static double change_of_speed(const SlidingPair *p)
{
    double fastest = SLOWEST;
    for (int i = 0; i < 6; i++) fastest = d_maximum(fastest, sqrt(dot4(p->v[i], p->v[i])));
    return d_maximum(1e-3 * p->speed, 1e-7 * fastest);
}

/* Adds a factor times what the forces lose per place of node j along c, by -h and h, or per velocity, by -e and e. */
static void add_changes(const KernelData *s, SlidingPair *p, int j, int c, double h, double e, double factor,
                        double change[6][D])
{
    double before[MOST_MOVED][D + 1];
    const double x = p->pair.x[j][c], v = p->v[j][c], over = factor / (2 * (h + e));
    p->pair.x[j][c] = x - h;
    p->v[j][c] = v - e;
    slide_in_pair(s, p);
    memcpy(before, p->pair.force, sizeof before);
    p->pair.x[j][c] = x + h;
    p->v[j][c] = v + e;
    slide_in_pair(s, p);
    p->pair.x[j][c] = x;
    p->v[j][c] = v;
    for (int i = 0; i < 6; i++)
        for (int r = 0; r < D; r++) change[i][r] += over * (before[i][r] - p->pair.force[i][r]);
}

/* Adds the blocks of a pair that slides, or without memory their number alone. */
static void add_sliding_pair(const KernelData *s, SlidingPair *p, double by_v, int secant, Blocks *out)
{
    p->fixed = 0;
    const double over_speed = slide_in_pair(s, p);
    if (!(over_speed > 0)) return;
    if (secant) p->fixed = over_speed;
    const double e = change_of_speed(p);
    for (int j = 0; out->row && j < 6; j++)
        for (int c = 0; c < D; c++) {
            double change[6][D] = {{0}};
            if (out->factor != 0) add_changes(s, p, j, c, out->h, 0, out->factor, change);
            if (by_v != 0) add_changes(s, p, j, c, 0, e, by_v, change);
            for (int i = 0; i < 6; i++) {
                const long b = out->n + 6L * j + i;
                out->row[b] = s->contact_node[p->pair.node[i]];
                out->column[b] = s->contact_node[p->pair.node[j]];
                for (int r = 0; r < D; r++) out->block[D * (D * b + r) + c] = change[i][r];
            }
        }
    out->n += 36;
}

/* As contact_blocks, of both places and velocities; `secant` : whether drag over speed stays. */
int sliding_blocks(const KernelData *s, double h, double by_u, double by_v, long secant, long *row, long *column,
                   double *block)
{
    Blocks out = {h, by_u, row, column, 0, block};
    const Near faces = near_of(s, OVER_FACE);
    SlidingPair p;
    for (long k = 0; k < s->n_contact_segments; k++)
        for (long m = faces.first[k]; m < faces.first[k + 1]; m++) {
            if (!may_act(s, &faces, k, m)) continue;
            set_pair(s, &p.pair, OVER_FACE, k, s->contact_face + 3L * faces.feature[m], 3, 3);
            for (int i = 0; i < 6; i++) p.v[i] = velocity_of(s, p.pair.node[i]);
            p.law = s->sliding + SLIDING_STRIDE * s->contact_law[k] + 1;
            add_sliding_pair(s, &p, by_v, secant != 0, &out);
        }
    return (int)out.n;
}
