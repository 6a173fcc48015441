"""Meshfree discretisation: gradients of shape functions, stabilisation, boundary, surfaces and their contact."""
