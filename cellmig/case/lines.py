"""Lines of the keys in a TOML text, for messages; tomllib does not give them."""

from __future__ import annotations

import re
from bisect import bisect_right

_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_STRING = re.compile(r'"""(?:\\.|[^\\])*?"""+|\'\'\'.*?\'\'\'+|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'', re.DOTALL)
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_PLAIN = re.compile(r"[^,\]}\n#]*")


def key_lines(text: str) -> dict[tuple, int]:
    """Line of each key and table of a TOML text that tomllib has accepted, by path, such as ("cells", 0, "radius")."""
    scan = _Scan(text)
    try:
        scan.document()
    except (RecursionError, AttributeError):  # the scan cannot follow: lines found so far are returned
        pass
    return scan.lines


class _Scan:
    """Scanner that notes lines of keys without reading values."""

    def __init__(self, text: str):
        self.text, self.at = text, 0
        self.lines: dict[tuple, int] = {(): 1}
        self.last: dict[tuple, int] = {}  # index of the latest table of each array of tables
        self.breaks = [m.start() for m in re.finditer("\n", text)]

    def document(self) -> None:
        table: tuple = ()
        self.skip()
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                table = self.header()
            else:
                self.assignment(table)
            self.skip()

    def skip(self) -> None:
        """Skip blanks, line ends and comments."""
        self.at = _BLANK.match(self.text, self.at).end()

    def take(self, mark: str) -> bool:
        """Whether `mark` comes next; if so, skip it and the blanks after it."""
        here = self.text.startswith(mark, self.at)
        if here:
            self.at += len(mark)
            self.skip()
        return here

    def note(self, path: tuple) -> tuple:
        self.lines.setdefault(path, bisect_right(self.breaks, self.at) + 1)
        return path

    def header(self) -> tuple:
        """Read [a.b] or [[a.b]]; returns the path of the table that begins here."""
        start, many = self.at, self.text.startswith("[[", self.at)
        self.take("[[" if many else "[")
        keys = self.key()
        end, self.at = self.at, start
        path: tuple = ()
        for i, key in enumerate(keys):
            path = self.note((*path, key))
            if many and i == len(keys) - 1:
                self.last[path] = self.last.get(path, -1) + 1
            if path in self.last:
                path = self.note((*path, self.last[path]))
        self.at = end
        self.take("]]" if many else "]")
        return path

    def key(self) -> list[str]:
        """Read a dotted key."""
        keys = []
        while True:
            quoted = self.text[self.at] in "\"'"
            match = (_STRING if quoted else _BARE).match(self.text, self.at)
            keys.append(match.group()[1:-1] if quoted else match.group())
            self.at = match.end()
            self.skip()
            if not self.take("."):
                return keys

    def assignment(self, table: tuple) -> None:
        """Read a key and its value, in a table or an inline table."""
        start, path = self.at, table
        keys = self.key()
        end, self.at = self.at, start
        for key in keys:
            path = self.note((*path, key))
        self.at = end
        self.take("=")
        self.value(path)

    def value(self, path: tuple) -> None:
        if self.take("["):
            item = 0
            while not self.take("]"):
                self.value(self.note((*path, item)))
                self.take(",")
                item += 1
        elif self.take("{"):
            while not self.take("}"):
                self.assignment(path)
                self.take(",")
        else:
            match = _STRING.match(self.text, self.at) or _PLAIN.match(self.text, self.at)
            self.at = match.end()
            self.skip()
