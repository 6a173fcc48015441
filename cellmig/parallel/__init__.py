"""Parallel computing: partition, ghosts, collectives, and sums and random numbers that are the same on any ranks."""
