/* The tangent of contact in space, by central differences of what a triangle and a feature do to each other. */

enum { MOST_IN_PAIR = 4 + MOST_SPOKES, MOST_MOVED = 6 };

/* A triangle near another cell and a feature of that: particles on which it depends, on the first `moved` of which it
 * acts, those of the triangle first; their places, and what acts on them. */
typedef struct {
    long triangle;
    int kind, n, moved;
    int32_t node[MOST_IN_PAIR];
    double x[MOST_IN_PAIR][D], force[MOST_MOVED][D + 1];
} Pair;

/* The pair of triangle k and feature m of those of a kind, of which n particles are given. */
static void set_pair(const KernelData *s, Pair *p, int kind, long k, const int32_t *feature, int n, int moved)
{
    p->triangle = k, p->kind = kind, p->n = 3 + n, p->moved = 3 + moved;
    memcpy(p->node, s->contact_segment + 3 * k, 3 * sizeof *p->node);
    memcpy(p->node + 3, feature, (size_t)n * sizeof *p->node);
    for (int i = 0; i < p->n; i++) memcpy(p->x[i], contact_place(s, p->node[i]), sizeof p->x[i]);
}

/* Pieces of a pair, and what acts there. */
static Pieces in_pair, acts_in_pair;

/* The triangle of a pair, and places of the feature with what acts on them: nothing yet, as no pieces are found. */
static Triangle triangle_in_pair(const KernelData *s, Pair *p, const double *x[MOST_IN_PAIR], double *force[MOST_MOVED])
{
    Triangle T = triangle_at(s, p->triangle, 0);
    in_pair.used = 0;
    acts_in_pair.action = enough(acts_in_pair.action, 0, 1, acts_in_pair.room + 2, sizeof(Beside));
    memset(p->force, 0, sizeof p->force);
    for (int i = 3; i < p->n; i++) x[i - 3] = p->x[i];
    for (int i = 3; i < p->moved; i++) force[i - 3] = p->force[i];
    for (int i = 0; i < 3; i++) T.x[i] = p->x[i], T.force[i] = p->force[i];
    set_sides(&T);
    return T;
}

/* Finds the pieces of T over a face, and what acts there. */
static const OverFace *find_in_pair(const Triangle *T, const Face *f)
{
    FacePieces waiting = {.of = &acts_in_pair};
    double pierced = 0;
    over_face(T, f, &in_pair, &pierced);
    wait_over_face(T, f, in_pair.on, in_pair.used, 0, &waiting);
    add_over_faces(&waiting);
    return over_face_of(&acts_in_pair, 0);
}

/* Sets what acts in a pair; whether anything does. */
static int act_in_pair(const KernelData *s, Pair *p)
{
    const double *x[MOST_IN_PAIR];
    double *force[MOST_MOVED];
    Triangle T = triangle_in_pair(s, p, x, force);
    if (p->kind == OVER_FACE) {
        Face f;
        set_face(&f, x);
        act_over_face(find_in_pair(&T, &f), &T, &f, force);
    } else if (p->kind == BESIDE_EDGE) {
        Lines waiting = {.of = &acts_in_pair};
        Edge3 e;
        set_edge(&e, x);
        beside_edge3(&T, &e, &in_pair);
        wait_beside_edge(&T, x, in_pair.on, in_pair.used, 0, &waiting);
        add_beside_edges(&waiting);
        act_beside_edge(beside_of(&acts_in_pair, 0), &T, x, force);
    } else {
        Points waiting = {.of = &acts_in_pair};
        Vertex v;
        const Ball ball = ball_around(&T);
        set_vertex(&v, x[0], x + 1, p->n - 4);
        beside_vertex3(&T, &ball, &v, &in_pair);
        wait_beside_vertex(&T, x[0], in_pair.on, in_pair.used, 0, &waiting);
        add_beside_vertices(&waiting);
        act_beside_vertex(beside_of(&acts_in_pair, 0), &T, x[0], force[0]);
    }
    int any = 0;
    for (int i = 0; i < p->moved; i++)
        for (int c = 0; c < D; c++) any |= p->force[i][c] != 0;
    return any;
}

/* Where blocks are stored: the change of a place, the factor of blocks, rows and columns, numbers of particles; their
 * number so far. */
typedef struct { double h, factor; long *row, *column, n; double *block; } Blocks;

/* Adds the blocks -∂f/∂u of a pair that acts, or without memory their number alone. */
static void add_pair(const KernelData *s, Pair *p, Blocks *out)
{
    if (!act_in_pair(s, p)) return;
    for (int j = 0; out->row && j < p->n; j++)
        for (int c = 0; c < D; c++) {
            double before[MOST_MOVED][D + 1];
            const double x = p->x[j][c];
            p->x[j][c] = x - out->h;
            act_in_pair(s, p);
            memcpy(before, p->force, sizeof before);
            p->x[j][c] = x + out->h;
            act_in_pair(s, p);
            p->x[j][c] = x;
            for (int i = 0; i < p->moved; i++) {
                const long b = out->n + (long)j * p->moved + i;
                out->row[b] = s->contact_node[p->node[i]];
                out->column[b] = s->contact_node[p->node[j]];
                for (int r = 0; r < D; r++)
                    out->block[D * (D * b + r) + c] = out->factor * (before[i][r] - p->force[i][r]) / (2 * out->h);
            }
        }
    out->n += (long)p->n * p->moved;
}

/* Number of blocks -by_u ∂f/∂u - by_v ∂f/∂v of the pairs that acted when forces were last added; without `row` that
 * alone, else also the blocks (D, D) with their rows and columns, local numbers.  h : by how much places change.  What
 * acts does not depend on velocities. */
int contact_blocks(const KernelData *s, double h, double by_u, double by_v, long secant, long *row, long *column,
                   double *block)
{
    Blocks out = {h, by_u, row, column, 0, block};
    const Near faces = near_of(s, OVER_FACE), edges = near_of(s, BESIDE_EDGE), vertices = near_of(s, BESIDE_VERTEX);
    Pair p;
    for (long k = 0; k < s->n_contact_segments; k++) {
        for (long m = faces.first[k]; m < faces.first[k + 1]; m++) {
            if (!may_act(s, &faces, k, m)) continue;
            set_pair(s, &p, OVER_FACE, k, s->contact_face + 3L * faces.feature[m], 3, 3);
            add_pair(s, &p, &out);
        }
        for (long m = edges.first[k]; m < edges.first[k + 1]; m++) {
            if (!may_act(s, &edges, k, m)) continue;
            set_pair(s, &p, BESIDE_EDGE, k, s->contact_side + 4L * edges.feature[m], 4, 2);
            add_pair(s, &p, &out);
        }
        for (long m = vertices.first[k]; m < vertices.first[k + 1]; m++) {
            const long v = vertices.feature[m], first = s->first_ring[v];
            if (!may_act(s, &vertices, k, m)) continue;
            const int around = (int)(s->first_ring[v + 1] - first);
            int32_t feature[MOST_SPOKES + 1] = {s->contact_vertex[v]};
            memcpy(feature + 1, s->contact_ring + first, (size_t)around * sizeof *feature);
            set_pair(s, &p, BESIDE_VERTEX, k, feature, 1 + around, 1);
            add_pair(s, &p, &out);
        }
    }
    return (int)out.n;
}
