/* The clock by which the directions of pushes change. */

void turn_drives(const KernelData *s, double dt) { s->drive_clock[0] += dt; }
