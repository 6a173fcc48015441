/* The clock by which directions of pushes change: counted in steps, so that it does not matter where batches end.
 * Forces alone, which take no time, leave it. */

void turn_drives(const KernelData *s, double dt)
{
    double *clock = s->drive_clock;
    if (dt > 0) clock[0] = clock[1] + (clock[2] += 1) * dt - clock[3];
}
