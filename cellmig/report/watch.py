"""`cellmig watch`: the page of a run that goes on, served to this machine alone."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock

from cellmig.output.directory import INDEX, MANIFEST, READABLE, OutputError

HOST = "127.0.0.1"
_NAMES = (HOST, "localhost", "[::1]")  # of this machine, in requests; another port is that of a tunnel
_LOOKED_AT = (INDEX, MANIFEST, "history.csv", "run.log")  # files that tell news


class Server(ThreadingHTTPServer):
    """A server of the page of one run; it reads files, and writes none.

    port : of the machine, 0 for a free one;  make : the page of a directory.  Raises OutputError where the port cannot
    be used.
    """

    daemon_threads = True

    def __init__(self, directory: Path, port: int, make: Callable[[Path], str]) -> None:
        self.directory, self._make, self._lock = directory, make, Lock()
        self._made = "", ""
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise OutputError(f"port {port} of {HOST} cannot be used ({error.strerror}); without --port a free one is "
                              "taken") from error

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def state(self) -> str:
        """Sizes and times of the files of the run, as JSON: another one means news."""
        found = {}
        for name in _LOOKED_AT:
            try:
                stat = os.stat(self.directory / name)
                found[name] = stat.st_size, stat.st_mtime_ns
            except OSError:
                continue
        return json.dumps(found)

    def page(self) -> str:
        """The page, made anew only where there is news."""
        with self._lock:
            state = self.state()
            if self._made[0] != state:
                self._made = state, self._make(self.directory)
            return self._made[1]


class _Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        """Answer with the page, or whether there is news."""
        try:
            if _name(self.headers.get("Host", HOST)) not in _NAMES:  # a site that gave its name to this machine asks
                self.send_error(HTTPStatus.FORBIDDEN)
            elif self.path == "/":
                self._answer(self.server.page(), "text/html")
            elif self.path == "/state.json":
                self._answer(self.server.state(), "application/json")
            else:
                self.send_error(HTTPStatus.NOT_FOUND)
        except ConnectionError:  # the reader has gone
            pass
        except OSError as error:  # a file is being replaced, was taken away, or cannot be read
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, explain=str(error))

    def _answer(self, text: str, kind: str) -> None:
        body = text.encode(*READABLE)
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def _name(host: str) -> str:
    """The name in a header such as "localhost:8000"."""
    return re.sub(r":\d*$", "", host.strip()).lower()


def serve(directory: Path, port: int, make: Callable[[Path], str]) -> None:
    """Serve until Ctrl-C or SIGTERM.  Raises OutputError where the port is taken."""
    for sign in (signal.SIGINT, signal.SIGTERM):  # whatever the shell that started this has done to them
        signal.signal(sign, signal.default_int_handler)
    with Server(directory, port, make) as server:
        print(f"{server.url} shows '{directory}' as it is; Ctrl-C ends this", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print(flush=True)
