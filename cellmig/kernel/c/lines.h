/* Lines of a triangle T across wedges over edges of another surface, and what bonds do there. */

/* A line across a wedge: its ends on T, the direction from the edge, and what it acts on. */
typedef struct { v4 on[2], away; double *on_T[3], *on_edge[2], *energy; } Line;

/* Lines of one law that wait for what acts on them. */
typedef struct {
    const double *law;
    int n;
    double width[2][MOST_PIECES], distance[2][MOST_PIECES];
    Line line[MOST_PIECES];
} Lines;

/* What acts on the lines that wait. */
static void act_on_lines(Lines *found)
{
    const int n = found->n;
    int order[MOST_PIECES];
    double kind[MOST_PIECES], acts[2][MOST_PIECES], energy[MOST_PIECES], stiff[MOST_PIECES];
    for (int m = 0; m < n; m += 4)
        store(kind + m, contact_edge_kind(found->law, load(found->distance[0] + m), load(found->distance[1] + m)));
    by_kinds(kind, n, order);
    for (int m = 0; m < n; m += 4) {
        const int *of = order + m;
        v4 loads[2], stored[1], may[1], stiffness[1] = {{0}}, width[2], r[2];
        for (int k = 0; k < 2; k++) width[k] = pick(found->width[k], of), r[k] = pick(found->distance[k], of);
        contact_edge(found->law, width[0], width[1], r[0], r[1], loads, stored, may);
        if (signs(-may[0])) contact_edge_stiffness(found->law, width[0], width[1], r[0], r[1], stiffness);
        for (int k = 0; k < 2; k++) put(acts[k], of, loads[k]);
        put(energy, of, stored[0]);
        put(stiff, of, stiffness[0]);
    }
    for (int m = 0; m < n; m++) {
        const Line *line = found->line + m;
        const v4 on = acts[0][m] * line->on[0] + acts[1][m] * line->on[1];
        pull(line->on_T, -on, line->away);
        add4(line->on_edge[0], (acts[0][m] + acts[1][m] - on[3]) * line->away);
        add4(line->on_edge[1], on[3] * line->away);
        *line->energy += energy[m];
        if (!(stiff[m] > 0)) continue; /* of reflex edges it is negative */
        const v4 both = line->on[0] + line->on[1];
        stiffen(line->on_T, both, 0.5 * stiff[m]);
        line->on_edge[0][3] += (2 - both[3]) * 0.5 * stiff[m];
        line->on_edge[1][3] += both[3] * 0.5 * stiff[m];
    }
    found->n = 0;
}
