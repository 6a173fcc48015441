"""Pages for a browser, each one file: of a run, of a study of many runs, and of a run that goes on."""
