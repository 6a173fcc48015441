"""Time integration and equilibrium: equation (2) on a rank, stable steps, tangents, PETSc's TS and SNES."""
