/* Which features of another surface may act on a triangle T until a node has moved by half of a margin: bounds of what
 * over_face, beside_edge3 and beside_vertex3 would find. */

/* A ball around T. */
typedef struct { double middle[3], radius; } Ball;

/* The ball about the mean of the corners. */
static Ball ball_around(const Triangle *T)
{
    Ball ball = {.radius = 0};
    for (int i = 0; i < 3; i++) ball.middle[i] = (T->x[0][i] + T->x[1][i] + T->x[2][i]) / 3;
    for (int k = 0; k < 3; k++) {
        double from[3];
        less3(T->x[k], ball.middle, from);
        ball.radius = fmax(ball.radius, sqrt(dot3(from, from)));
    }
    return ball;
}

/* Change of a length beside a feature, of a size and at a distance from it, as its ends and T move by half a margin:
 * both ends move by that, and the feature turns by at most four times the margin over its size. */
static inline double change_of(double margin, double size, double distance)
{
    return margin * (1 + 4 * (distance + margin) / size);
}

/* Whether T may be over the face, on its outer side and within reach. */
static int face_may_act(const Triangle *T, const Face *f, double margin)
{
    int far = 1, behind = 1, before[3] = {1, 1, 1};
    const double steep[2] = {sqrt(dot3(f->gradient[0], f->gradient[0])), sqrt(dot3(f->gradient[1], f->gradient[1]))};
    double third[3];
    for (int i = 0; i < 3; i++) third[i] = f->gradient[0][i] + f->gradient[1][i];
    const double slope[3] = {sqrt(dot3(third, third)), steep[0], steep[1]}; /* over the heights of the face */
    const double size = 1 / fmax(slope[0], fmax(slope[1], slope[2]));
    for (int k = 0; k < 3; k++) {
        double from[3], on[3];
        less3(T->x[k], f->start, from);
        const double gap = dot3(from, f->normal), change = change_of(margin, size, sqrt(dot3(from, from)));
        on[1] = dot3(from, f->gradient[0]);
        on[2] = dot3(from, f->gradient[1]);
        on[0] = 1 - on[1] - on[2];
        far &= gap > T->within + change;
        behind &= gap < -change;
        for (int c = 0; c < 3; c++) before[c] &= on[c] < -2 * change * slope[c];
    }
    return !(far || behind || before[0] || before[1] || before[2]);
}

/* Whether T may be in the wedge over the edge and within reach. */
static int edge_may_act(const Triangle *T, const Ball *ball, const Edge3 *e, double margin)
{
    double from[3], beside = 0, first[2] = {INFINITY, -INFINITY}, last[2] = {INFINITY, -INFINITY};
    less3(ball->middle, e->start, from);
    const double t = dot3(from, e->along), change = change_of(margin, e->size, sqrt(dot3(from, from)) + ball->radius);
    for (int i = 0; i < 3; i++) beside += (from[i] - t * e->along[i]) * (from[i] - t * e->along[i]);
    if (sqrt(beside) > T->within + ball->radius + change || t < -ball->radius - change
        || t > e->length + ball->radius + change) return 0;
    for (int k = 0; k < 3 && e->sign != 0; k++) { /* beside the wedge, also if the edge turns over */
        less3(T->x[k], e->start, from);
        const double a = dot3(from, e->gradient[0]), b = dot3(from, e->gradient[1]);
        first[0] = fmin(first[0], a);
        first[1] = fmax(first[1], a);
        last[0] = fmin(last[0], b);
        last[1] = fmax(last[1], b);
    }
    return e->sign == 0 || !((first[1] < -change || last[1] < -change) && (first[0] > change || last[0] > change));
}

/* Whether T may be within reach of the vertex. */
static int vertex_may_act(const Triangle *T, const Ball *ball, const Vertex *v, double margin)
{
    double from[3];
    less3(ball->middle, v->at, from);
    return sqrt(dot3(from, from)) < T->within + ball->radius + 2 * margin;
}
