"""What a run leaves behind: frames, tables, manifest and log.  Observers: nothing here changes the state."""
