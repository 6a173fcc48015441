/* The clock by which directions of pushes change: counted in steps, so that it does not matter where batches end. */

void turn_drives(const KernelData *s, double dt)
{
    double *clock = s->drive_clock;
    clock[0] = clock[1] + (clock[2] += 1) * dt - clock[3];
}
