"""Meshfree discretisation: shapes, RKPM gradients and their adjoint, stabilisation, surfaces, the compiled kernel."""
