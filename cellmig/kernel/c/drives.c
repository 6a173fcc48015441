/* The clock by which the directions of pushes change. */

void turn_drives(const KernelData *s, double dt) { tick(s->drive_clock, dt); }
