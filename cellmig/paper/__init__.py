"""The publication: its claims over seeds, its figures."""
