"""Files of a run: frames, tables, checkpoints, manifest and log.  Nothing here changes the state."""
