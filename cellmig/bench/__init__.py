"""Is it fast: speed, scaling, error against time."""
