/* Clutches that couple flowing actin to a spring of the substrate (Chan & Odde 2008), event by event.
 *
 * The state is the force f_i >= 0 on each of n closed clutches; an open one has -1.  The substrate bears F = Σ f_i,
 * actin flows at v = v_u (1 - F/F_s), and between events F approaches F_s as exp(-λ t) does, with λ = K v_u/F_s and
 * 1/K = 1/κ_s + 1/(n κ_c).  Each closed clutch takes (F - F_0)/n of that, so that the rates at which they open have one
 * factor e^g in common, g = (F - F_0)/(n F_b), which never falls.  The time of the next event is exact, by thinning
 * (Lewis & Shedler 1979) in windows in which g rises by at most WINDOW. */

#include <math.h>

#define WINDOW 0.5
#define FASTEST 1e200  /* times k_off */

/* Adds the force `more` to each closed clutch. */
static void load(long count, double *f, double *w, double more, double bell)
{
    const double factor = exp(fmin(more / bell, 600.0));
    for (long i = 0; i < count; i++)
        if (f[i] >= 0.0) f[i] += more, w[i] = fmin(w[i] * factor, FASTEST);
}

/* The closed clutch at which the sum of w reaches `sum`. */
static long chosen(long count, const double *f, const double *w, double sum)
{
    long last = -1;
    for (long i = 0; i < count && (last < 0 || sum >= 0.0); i++)
        if (f[i] >= 0.0) last = i, sum -= w[i];
    return last;
}

/* Advances f[count] by `duration` and returns ∫ F dt.  w[count]: room for rates over k_off;  motors, speed, spring,
 * clutch, on, off, bell: F_s, v_u, κ_s, κ_c, k_on, k_off, F_b;  uniform(state) draws from [0, 1). */
double advance_clutches(long count, double *f, double *w, double motors, double speed, double spring, double clutch,
                        double on, double off, double bell, double duration, double (*uniform)(void *), void *state)
{
    double impulse = 0.0, time = 0.0;
    for (long i = 0; i < count; i++) w[i] = fmin(exp(fmin(f[i] / bell, 600.0)), FASTEST);
    while (time < duration) {
        long n = 0;
        double F = 0.0, opening = 0.0;
        for (long i = 0; i < count; i++)
            if (f[i] >= 0.0) n++, F += f[i], opening += off * w[i];
        const double closing = (count - n) * on, left = duration - time;
        const double decay = n ? speed / motors / (1.0 / spring + 1.0 / (n * clutch)) : 0.0;  /* λ */
        const double rise = n ? (motors - F) / (n * bell) : 0.0;                              /* of g, in the end */
        const double window = rise > WINDOW ? fmin(left, -log1p(-WINDOW / rise) / decay) : left;
        const double bound = closing + opening * exp(rise * -expm1(-decay * window));
        const double wait = -log1p(-uniform(state)) / bound, dt = fmin(wait, window);
        const double part = -expm1(-decay * dt), more = n ? (motors - F) * part / n : 0.0;
        impulse += n ? motors * dt - (motors - F) * part / decay : 0.0;
        time += dt;
        load(count, f, w, more, bell);
        if (wait >= window) continue;
        const double pick = uniform(state) * bound;
        if (pick < closing) {  /* any open one: they are alike */
            long i = 0;
            while (f[i] >= 0.0) i++;
            f[i] = 0.0, w[i] = 1.0;
        } else if (pick < closing + opening * exp(more / bell)) {  /* the others take up what it bore */
            const long i = chosen(count, f, w, (pick - closing) / off);
            const double borne = f[i];
            f[i] = -1.0;
            load(count, f, w, borne * clutch / (spring + (n - 1) * clutch), bell);
        }
    }
    return impulse;
}
