"""Claims that runs over random seeds decide: measured numbers, their bounds, verdicts, and tables of them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .batch import write_rows

HOLDS, AVERAGE, FAILS, UNKNOWN = "holds", "holds on average", "does not hold", "not measured"


@dataclass(frozen=True)
class Part:
    """A statement that one number decides.

    what : the number and its unit;  values : by seed;  above, below : bounds of the number.
    """

    what: str
    values: Mapping[int, float]
    above: float = -np.inf
    below: float = np.inf

    @property
    def text(self) -> str:
        """The statement with its bounds."""
        if np.isfinite(self.above) and np.isfinite(self.below):
            return f"{self.what} in {self.above:g}-{self.below:g}"
        return f"{self.what} > {self.above:g}" if np.isfinite(self.above) else f"{self.what} < {self.below:g}"

    @property
    def mean(self) -> float:
        """Mean over the seeds."""
        return float(np.mean(list(self.values.values()))) if self.values else np.nan

    @property
    def spread(self) -> float:
        """Standard deviation over the seeds; nan for one."""
        return float(np.std(list(self.values.values()), ddof=1)) if len(self.values) > 1 else np.nan

    def within(self, value: float) -> bool:
        """Whether a value is within the bounds; nan is not."""
        return bool(self.above < value < self.below)

    @property
    def held(self) -> set[int]:
        """Seeds whose value is within the bounds."""
        return {seed for seed, value in self.values.items() if self.within(value)}

    @property
    def verdict(self) -> str:
        """HOLDS in every seed, AVERAGE in the mean, FAILS, or UNKNOWN without values."""
        if not self.values:
            return UNKNOWN
        return HOLDS if len(self.held) == len(self.values) else AVERAGE if self.within(self.mean) else FAILS

    @property
    def errors(self) -> float:
        """Distance of the mean from the nearer bound, in standard errors of the mean [-]; nan for one seed."""
        distance = min(abs(self.mean - self.above), abs(self.mean - self.below))
        return distance * np.sqrt(len(self.values)) / self.spread if self.spread > 0 else np.nan


@dataclass(frozen=True)
class Claim:
    """A claim, which holds where all its parts do; `why` is printed where it fails, `notes` always."""

    key: str
    text: str
    parts: list[Part]
    notes: list[str] = field(default_factory=list)
    why: list[str] = field(default_factory=list)

    @property
    def seeds(self) -> set[int]:
        """Seeds in which all parts were measured."""
        return set.intersection(*(set(part.values) for part in self.parts))

    @property
    def held(self) -> set[int]:
        """Seeds in which all parts hold."""
        return set.intersection(*(part.held for part in self.parts))

    @property
    def verdict(self) -> str:
        """The worst verdict of its parts."""
        found = {part.verdict for part in self.parts}
        return next(v for v in (UNKNOWN, FAILS, AVERAGE, HOLDS) if v in found)


def text_of(values: Iterable[float]) -> str:
    """Mean ± standard deviation of values, as text."""
    part = Part("", dict(enumerate(values)))
    return f"{part.mean:.3g} ± {part.spread:.2g}" if len(part.values) > 1 else f"{part.mean:.3g}"


def table(claims: Sequence[Claim], seeds: int) -> list[str]:
    """Lines of claims and their parts with measured numbers, seeds in which they hold, verdicts; missing seeds."""
    lines = [line("claim", "measured", "holds in", "verdict"), "-" * 134]
    for claim in claims:
        lines.append(line(f"{claim.key}  {claim.text}", "", f"{len(claim.held)} of {len(claim.seeds)}",
                           claim.verdict))
        lines += [line(f"      {part.text}", text_of(part.values.values()) if part.values else "-",
                        f"{len(part.held)} of {len(part.values)}",
                        part.verdict + (" (within the scatter)" if part.errors < 1.0 else "")) for part in claim.parts]
        why = [*_scatter(claim), *claim.why] if claim.verdict != HOLDS else []
        for text in [*claim.notes, *(f"why: {reason}" for reason in why)]:
            lines += textwrap.wrap(text, 134, initial_indent=" " * 6, subsequent_indent=" " * 8)
        if missing := seeds - len(claim.seeds):
            lines.append(f"      missing: {missing} of {seeds} seeds, because runs failed or do not count")
    return lines


def line(claim: str, measured: str, seeds: str, verdict: str) -> str:
    """A line of the table of claims."""
    return f"{claim:<88} {measured:>17}  {seeds:>8}  {verdict}".rstrip()


def _scatter(claim: Claim) -> list[str]:
    """For each part that does not hold in all seeds: its mean, distance to the bound in standard errors, values."""
    remarks = []
    for part in claim.parts:
        if part.values and part.verdict != HOLDS:
            errors = f" by {part.errors:.1f} standard errors" if part.spread > 0 and part.errors < 100 else ""
            how = "misses" if part.verdict == FAILS else "keeps"
            remarks.append(f"{part.what}: mean {part.mean:.3g} {how} its bound{errors}; by seed "
                           f"{', '.join(f'{v:.3g}' for v in part.values.values())}")
    return remarks


def write_claims(path: Path, claims: Sequence[Claim]) -> None:
    """Write claims with the numbers of each seed as CSV."""
    seeds = sorted({seed for claim in claims for part in claim.parts for seed in part.values})
    write_rows(path, [{"claim": claim.key, **_entries(part),
                       **{f"seed{seed}": part.values.get(seed, "") for seed in seeds}, "claim_verdict": claim.verdict}
                      for claim in claims for part in claim.parts])


def _entries(part: Part) -> dict[str, Any]:
    return {"part": part.what, "above": part.above, "below": part.below, "mean": part.mean, "spread": part.spread,
            "standard_errors": part.errors, "seeds": len(part.values), "holds_in": len(part.held),
            "verdict": part.verdict}
