"""Published facts on how cells find their way, over random seeds: what is claimed, what is measured, what holds."""
