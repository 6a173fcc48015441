"""Exit codes of all commands, as `run` and docs/troubleshooting.md list them."""

DONE = 0
DIFFERENT = 1  # two runs differ, a claim or a reference does not hold, or the program has an error
INVALID_INPUT = 2  # invalid case or command line
ENVIRONMENT = 3
FAILED = 4  # the numerical solution failed: not finite, volumes not kept, energy error
INPUT_OUTPUT = 5
STOPPED = 75  # on request; `resume` continues the run
INTERRUPTED = 130  # by a second ^C
