"""Exit codes of all commands; `run` and docs/troubleshooting.md list the same."""

DONE = 0
DIFFERENT = 1  # two runs differ, a claim or a test does not hold; also a mistake of the program
WRONG = 2  # the case or the call
ENVIRONMENT = 3
BROKEN = 4  # the numbers: NaN, a volume not kept, energy that does not add up
INPUT_OUTPUT = 5
STOPPED = 75  # on request; `resume` goes on
INTERRUPTED = 130  # a second ^C
