"""The publication: its claims, judged over random seeds, and its figures."""
