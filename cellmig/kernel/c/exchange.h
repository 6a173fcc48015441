/* Copies of particles that other ranks own. */

/* Ghosts from their owners: VecGhostUpdate{Begin,End}(vec, INSERT_VALUES, SCATTER_FORWARD), absent on one rank. */
static inline int exchange(const KernelData *s, void *vec)
{
    if (!s->ghost_begin) return 0;
    return s->ghost_begin(vec, 1, 0) || s->ghost_end(vec, 1, 0);
}

/* That of the state alone, to be timed. */
int exchange_state(const KernelData *s) { return exchange(s, s->state_vec); }
