"""Shapes of cells and the particles that fill them."""
