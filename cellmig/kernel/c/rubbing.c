/* Friction is accounted where it is found, at speeds of half a step before.  A force takes from a kick what it does at
 * the mean of the speeds before and behind it: the rest is added when those are known, at the next kick. */

/* The rest of the losses of the last kick, and what is too much so far of those of this one. */
void complete_friction(const KernelData *s, double accounted_dt, double dt)
{
    for (long k = 0; k < s->n_rubbing; k++) {
        const long i = s->rubbing[k];
        double *before = s->rubbed + D * k, *now = s->rubs + D * i;
        for (int c = 0; c < D; c++) {
            s->friction_loss[i] += 0.5 * (dt * now[c] - accounted_dt * before[c]) * velocity(s, i, c);
            before[c] = now[c];
            now[c] = 0;
        }
    }
}
