"""The step in C: layout of a rank's particles, laws translated, compiled."""
