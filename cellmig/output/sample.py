"""Output quantities: by cell for history.csv, energies for ledger.csv, by particle for frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mpi4py import MPI

from ..case.pointwise import pointwise
from ..kernel.terms import present
from ..meshfree.body import Template
from ..meshfree.boundary import Probes
from ..meshfree.recovery import Recovery
from ..meshfree.simplices import facet_sizes, share_below, volumes_below
from ..model.tensors import determinant
from ..parallel.reduce import exact_sum, exact_sums
from .energies import energies, strain_energy
from .fields import FIELDS
from .tables import ENERGY, HELD, MEASURES, ON_GELS, PROBED, further_columns
from .view import View

STRAIN = 1e-8  # volumetric strain of all cells whose energy is the smallest scale of the energy error
ROUNDED = 1e-6  # smallest scale of the energy error, over the largest energy or work
AT_A_TIME = 1 << 16  # rows whose stress is computed at a time
TOUCHING = 3.0  # surfaces closer than this many equilibrium distances count as in contact


class Sampler:
    """Output quantities of a Mechanics, which is not changed; they are current after `mechanics.rate`.

    start : entries of the first row of the ledger [pN], from which changes are counted;  contacts : at the last row of
    history, of facets near another cell both cells (k, 2) int, and how much of them touches (k,) [µm, in space µm²].
    """

    def __init__(self, mechanics: View, probes: Probes):
        """Store masses, volumes and the particles of mean stresses."""
        m, self.probes = mechanics, probes
        self.mechanics = m
        scene, own = m.scene, m.part.owned
        self.mass, self.V, self.cell, self.material = own.field("mass"), own.field("V"), own.cell, own.material
        self.n_cells = len(scene.kind)
        of_kind = [[math.fsum(values) for values in (t.mass, t.V, t.V * t.elastic_weight)] for t in scene.templates]
        self.cell_mass, self.cell_volume, modulus = np.array(of_kind)[scene.kind].T
        self._negligible = STRAIN**2 * math.fsum(modulus)
        self._watched = np.zeros(m.n_owned)  # weights of particles in the stress at the lower centre of each cell
        self.surface = np.full(m.n_owned, -1, np.int32)
        for kind, on, at in own.by_kind():
            t = scene.templates[kind]
            self._watched[on], self.surface[on] = _below_centre(t)[at], _places(t)[at]
        self._recovered: tuple[Any, Recovery | None] = None, None
        self.start: dict[str, float] | None = None
        self.contacts = np.zeros((0, 2), int), np.zeros(0)

    @property
    def _recovery(self) -> Recovery:
        """The recovery of stress for the present neighbours."""
        m = self.mechanics
        of, found = self._recovered
        if found is None or of is not m.part:
            found = Recovery(m.scene, m.part.row_ids, m.n_owned)
            self._recovered = m.part, found
        return found

    def _sum(self, values: np.ndarray) -> np.ndarray | None:
        """Sums (cells, k) of values (n_owned, k) by cell on rank 0, None on others; collective."""
        found = exact_sums(self.mechanics.comm, values, self.cell)
        return None if found is None else found[1]

    # ------------------------------------------------------------ per particle

    def stresses(self) -> dict[str, np.ndarray]:
        """Stress of the owned particles [Pa], without the numerical damping, and J.

        The Cauchy stress (n, 3, 3) is recovered: linear fits over the neighbours in the same material.  The effective
        stress and the pressure are those of the recovered stress; J is nodal.
        """
        nodal, J = self.nodal_stress()
        stress = self._recovery @ nodal
        del nodal
        mean = np.trace(stress, axis1=1, axis2=2) / 3.0
        square = stress - mean[:, None, None] * np.eye(3)  # of the deviator
        square *= square
        effective = np.sqrt(1.5 * square.sum(axis=(1, 2)))
        return {"stress": stress, "effective_stress": effective, "J": J[: self.mechanics.n_owned], "pressure": -mean}

    def nodal_stress(self) -> tuple[np.ndarray, np.ndarray]:
        """Cauchy stress of all rows (n_rows, 3, 3) [Pa] as the laws have it, not recovered, and J (n_rows,)."""
        F, rate = self.mechanics.state.tensors()
        J = determinant(F)
        everything = {"F": F, "Fdot": rate, **self.mechanics.internal_fields()}
        terms, stress, grades = self.mechanics.terms, np.zeros((len(J), 3, 3)), self.mechanics.grades()
        for law, on in self._some_rows():
            local = {k: v[..., on] for k, v in everything.items()}
            grade = 1.0 if grades is None else grades[on]
            P = grade * np.array(pointwise(law, "stress", local))
            if hasattr(law, "viscous_stress"):
                P = P + np.array(pointwise(law, "viscous_stress", local))
            if terms.director != "none" and hasattr(law, "director_stress"):
                P = P + np.array(pointwise(law, "director_stress", local))
            if terms.active and hasattr(law, "active_stress"):
                P = P + np.array(pointwise(law, "active_stress", local))
            d = len(F)
            stress[on, :d, :d] = np.einsum("ikn,jkn->nij", P, local["F"]) / J[on, None, None]
            if d == 2:
                stress[on, 2, 2] = grade * pointwise(law, "out_of_plane", local)
        return stress, J

    def _some_rows(self) -> Iterator[tuple[Any, np.ndarray]]:
        """Laws and their rows, at most AT_A_TIME at a time, to limit memory."""
        material = self.mechanics.part.rows.material
        for i, law in enumerate(self.mechanics.scene.materials):
            rows = np.flatnonzero(material == i)
            yield from ((law, rows[k : k + AT_A_TIME]) for k in range(0, len(rows), AT_A_TIME))

    def fields(self) -> dict[str, np.ndarray]:
        """Fields of a frame that the scene has, for the owned particles (n_owned, ...), in their units."""
        m, terms = self.mechanics, self.mechanics.terms
        out = {"id": m.ids.astype(np.int64), "cell": self.cell + 1, "material": self.material,
               "surface": self.surface, "X": m.part.owned.X, "u": m.state.u.copy(),
               "v": m.state.v.copy(), **self.stresses()}
        for name, field in FIELDS.items():
            if name.endswith("_force") and present(field.term, terms):
                out[name] = m.surface_force(field.term)[0]
        if "director" in (internal := m.internal_fields()):
            out["director"] = internal["director"].T[: m.n_owned]
        return out

    # ------------------------------------------------------------ per cell

    def history(self) -> list[dict[str, float]]:
        """Rows of history.csv on rank 0, none on others: the aggregate (cell 0), then the cells; collective."""
        m = self.mechanics
        stresses = self.stresses()
        u, X = m.state.u, m.part.owned.X
        mass, watched = self.mass[:, None], self._watched * stresses["stress"][:, 0, 0]
        sums = self._sum(np.column_stack([mass * u, mass * (X + u), self.V * stresses["effective_stress"],
                                          self._surfaces(), watched]))
        d = m.scene.dimension
        heights = self._heights(X + u) if d == 3 else np.zeros(0)
        rows = self._rows(sums, heights) if sums is not None else []
        self._add_strains(rows)
        self._add_probes(rows)
        self._add_reactions(rows)
        return rows

    def _rows(self, sums: np.ndarray, heights: np.ndarray) -> list[dict[str, float]]:
        """Rows of history.csv for the sums of `history` (cells, k) and, in space, heights (cells,) [µm]."""
        d = self.mechanics.scene.dimension
        means, totals = sums[:, : 2 * d] / self.cell_mass[:, None], sums[:, 2 * d + 1 : -1]
        columns = {f"{what}{axis}_um": means[:, d * k + c] for k, what in ((1, ""), (0, "u"))
                   for c, axis in enumerate("xyz"[:d])}
        names = MEASURES[d]
        columns |= dict(zip(names, totals.T, strict=True))
        if d == 3:
            columns |= {"height_um": heights,
                        "sphericity": np.cbrt(np.pi * (6.0 * totals[:, 2]) ** 2) / totals[:, 3]}
        columns |= {"effective_stress_pa": sums[:, 2 * d] / self.cell_volume, "sigma11_lower_centre_pa": sums[:, -1]}
        rows = [{name: float(c[i]) for name, c in columns.items()} for i in range(self.n_cells)]
        whole = {name: float(np.average(c, weights=self.cell_mass)) for name, c in columns.items()}
        for name, share in zip(names, (1.0, 0.5, 1.0, 1.0), strict=True):  # each interface has two sides
            whole[name] = share * float(columns[name].sum())
        if d == 3:
            whole["height_um"] = float(columns["height_um"].max())
        return [whole, *rows]

    @property
    def columns(self) -> tuple[str, ...]:
        """Further columns of history: neighbours, of gels, of probes, then of supports and plates."""
        terms = self.mechanics.terms
        return further_columns(self.probes.names, self.mechanics.loads.boundary.names, self.mechanics.scene.dimension,
                               terms.on_gels, terms.contact is not None)

    def push(self) -> np.ndarray:
        """Push of the protrusion along the substrate on each cell (cells, d - 1) [pN/µm, in space pN]; collective.

        What gels bear of it does not count: it is the opposite of the push on the cells.
        """
        m = self.mechanics
        push = np.zeros((self.n_cells, m.scene.dimension - 1))
        for term in ("protrusion", "push_off"):
            if present(term, m.terms):
                of_term = self._sum(m.surface_force(term)[0][:, :-1])
                push += 0.0 if of_term is None else of_term
        m.comm.Bcast(push)
        return push * m.protruding[:, None]

    def _add_strains(self, rows: list[dict[str, float]]) -> None:
        """Add what bodies do to each other that rub or push off each other, to the rows of all; collective.

        It is the energy of their strain, and the dipole Σ (x - x̄) f of drag and push by others along x [pN, in space
        pN µm].
        """
        m = self.mechanics
        if not m.terms.on_gels:
            return
        f = np.sum([m.surface_force(term)[0][:, 0] for term in ("sliding", "push_off")
                    if present(term, m.terms)], axis=0)
        x = m.part.owned.X[:, 0] + m.state.u[:, 0]
        sums = self._sum(np.column_stack([strain_energy(m), f, x * f, self.mass * x]))
        if sums is None:
            return
        energy, force, moment, place = sums.T
        dipole = moment - place / self.cell_mass * force
        for row, *values in zip(rows, [energy.sum(), *energy], [dipole.sum(), *dipole], strict=True):
            row |= dict(zip(ON_GELS[m.scene.dimension], map(float, values), strict=True))

    def _add_probes(self, rows: list[dict[str, float]]) -> None:
        """Add positions and displacements of probes to the rows of their cells and of the aggregate; collective."""
        m, p = self.mechanics, self.probes
        if not p.names:
            return
        at = m.part.owned_numbers(p.id)
        mine = np.flatnonzero(at >= 0)
        u = m.state.u[at[mine]]
        moved = np.hstack([m.scene.particles(p.id[mine]).X + u, u])
        means = exact_sum(m.comm, p.weight[mine, None] * moved, p.probe[mine], len(p.names))
        for name, cell, mean in zip(p.names, p.cell, means.tolist(), strict=True):
            for row in rows[0:1] + rows[1 + cell : 2 + cell]:
                row |= dict(zip((f"{name}_{what}_um" for what in PROBED[m.scene.dimension]), mean, strict=True))

    def _add_reactions(self, rows: list[dict[str, float]]) -> None:
        """Add forces of supports and plates on each cell and on the aggregate; collective."""
        names = self.mechanics.loads.boundary.names
        for name, by_cell in zip(names, list(self.reactions()) if names else [], strict=True):
            if not rows:
                continue
            for row, force in zip(rows, [by_cell.sum(axis=0), *by_cell], strict=True):
                row |= {f"{name}_force_{c}": float(f) for c, f in zip(HELD[len(force)], force, strict=True)}

    def reactions(self) -> np.ndarray:
        """Forces of supports and plates on the cells (names, cells, d) [pN/µm, in space pN]; collective."""
        force, particle, number = self.mechanics.loads.reactions()
        names, cells = len(self.mechanics.loads.boundary.names), self.n_cells
        found = exact_sums(self.mechanics.comm, force, cells * number + self.cell[particle])
        sums = np.zeros((names * cells, self.mechanics.scene.dimension))
        if found is not None:
            sums[found[0]] = found[1]
        self.mechanics.comm.Bcast(sums)
        return sums.reshape(names, cells, -1)

    def _heights(self, x: np.ndarray) -> np.ndarray:
        """Heights (cells,) [µm] of the tops of the cells, on rank 0, from positions x (n_owned, 3) [µm]; collective."""
        highest = np.full(self.n_cells, -np.inf)
        np.maximum.at(highest, self.cell, x[:, 2])
        self.mechanics.comm.Reduce(MPI.IN_PLACE if self.mechanics.comm.rank == 0 else highest, highest, MPI.MAX)
        return highest

    def _surfaces(self) -> np.ndarray:
        """Contributions (n_owned, 4) of surface particles to the MEASURES, in their order and units."""
        m = self.mechanics
        corners, x = m.segments.owned()
        size, volume = facet_sizes(x), volumes_below(x)
        terms, values = m.terms, np.zeros((m.n_owned, 4))
        columns = {2: volume, 3: size}
        if terms.substrate is not None:
            columns[0] = size * share_below(x[:, :, -1], TOUCHING * terms.substrate.equilibrium_distance)
        if terms.contact is not None:
            corner, other, touching = m.segments.touching(TOUCHING)
            mine = corner < m.n_owned
            np.add.at(values[:, 1], corner[mine], touching[mine])
            self.contacts = np.column_stack([self.cell[corner[mine]], other[mine]]), touching[mine]
        for number, column in columns.items():
            np.add.at(values[:, number], corners[:, 0], column)
        return values

    # ------------------------------------------------------------ in sums

    def ledger(self, acceleration: np.ndarray, half_step: float,
               powers: Mapping[str, np.ndarray] | None = None) -> dict[str, float]:
        """Row of ledger.csv [pN]; collective.

        Velocities of leapfrog and accounts are advanced by `half_step` [µs] to the time of u, with their rates
        `acceleration` (n_owned, 4) [µm/µs, µm/µs²] and `powers` [pN/µs], which are not needed if it is zero.
        """
        m, terms = self.mechanics, self.mechanics.terms
        v = (m.state.v + half_step * acceleration[:, m.scene.dimension :]) * terms.inertia
        parts = energies(m, v)
        for name in ("external_work", "viscous_loss", "friction_loss", "medium_loss", "artificial_dissipation"):
            parts[name] = m.accounts.of_particles[name] + half_step * (powers or {}).get(name, 0.0)
        parts["network_loss"] = m.accounts.of_particles["network_loss"]  # networks are at the time of u
        if terms.acceleration is not None:  # work of the body force, a potential
            parts["external_work"] += self.mass * (m.state.u @ np.array(terms.acceleration))
        parts["artificial_dissipation"] = parts["artificial_dissipation"] + m.stabilisation_energy()
        columns = np.column_stack([np.broadcast_to(c, m.n_owned) for c in parts.values()])
        entries = dict(zip(parts, exact_sum(m.comm, columns).tolist(), strict=True))
        entries["renewal_loss"] = m.renewal_loss
        momentum = self._sum(self.mass[:, None] * v)
        drift = 0.0 if momentum is None else float(0.5 * ((momentum**2).sum(axis=1) / self.cell_mass).sum())
        error = self._energy_error(entries, m.comm.bcast(drift))
        unit = ENERGY[m.scene.dimension]
        return {**{f"{name}_{unit}": value for name, value in entries.items()}, "energy_error": error}

    def _energy_error(self, entries: dict[str, float], drift: float) -> float:
        """Error of the energy balance, over the largest energy [-]; `drift` : that of the cells' mean velocities [pN].

        The energy of a cell's mean velocity and the work for it depend on the frame of reference, and are not in the
        scale of the error.
        """
        self.start = self.start or entries | {"drift": drift}
        change = {name: value - self.start[name] for name, value in entries.items()}
        missing = sum(change.values()) - 2.0 * change["external_work"]
        gained = drift - self.start["drift"]
        everything = [*entries.values(), *change.values()]
        still = [*(entries | {"kinetic": entries["kinetic"] - drift, "external_work": 0.0}).values(),
                 *(change | {"kinetic": change["kinetic"] - gained,
                             "external_work": change["external_work"] - gained}).values()]
        largest = max(self._negligible, ROUNDED * max(abs(e) for e in everything), *[abs(e) for e in still])
        return abs(missing) / largest

    def momentum(self) -> np.ndarray:
        """Total momentum (d,) [pN µs/µm], in space [pN µs]; collective."""
        return exact_sum(self.mechanics.comm, self.mass[:, None] * self.mechanics.state.v)


def _below_centre(t: Template) -> np.ndarray:
    """Weights (n,) [-] of the particles in the mean of those nearest to the lower centre: one, or several at equal
    distances.
    """
    lower = np.append(np.zeros(t.X.shape[1] - 1), 0.75 * t.X[:, -1].min())
    away = np.linalg.norm(t.X - lower, axis=1)
    near = away < away.min() + 1e-6 * t.spacing
    return near / near.sum()


def _places(t: Template) -> np.ndarray:
    """Numbers of particles on the surface (n,) int32, -1 inside; in the plane along loops, one left out between."""
    out = np.full(len(t.X), -1, np.int32)
    out[t.surface] = np.arange(len(t.surface)) + (t.loop if t.X.shape[1] == 2 else 0)
    return out
