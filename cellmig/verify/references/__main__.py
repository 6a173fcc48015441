"""`python -m cellmig.verify.references` reads lines of JSON, [name, resolution], and writes what it measured."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import traceback


def serve() -> None:
    """Answer every line of stdin with a line on stdout; all other output goes to stderr."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    from cellmig.verify.verify import load_references  # MPI and PETSc start here

    references = load_references()
    for line in sys.stdin:
        name, resolution = json.loads(line)
        try:
            answer = dataclasses.asdict(references[name].measure(resolution))
        except Exception as error:
            traceback.print_exception(error)
            answer = {"failed": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    serve()
