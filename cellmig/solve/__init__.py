"""Time integration: the right-hand side of equation (2) on a rank, its stable step, and PETSc's TS."""
