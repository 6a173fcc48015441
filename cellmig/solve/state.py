"""Displacements and velocities of a rank's particles with ghosts, and the kernel's arrays by row."""

from __future__ import annotations

import numpy as np

from petsc4py import PETSc

from ..kernel.fields import Field, step_memory
from ..kernel.kernel import Kernel, aligned_zeros
from ..kernel.layout import Numbering, stencil_arrays
from ..model.tensors import determinant
from ..parallel.ghosts import GhostedField
from .subdomain import Subdomain


class State(GhostedField):
    """(u, v) [µm, µm/µs] of owned particles and ghosts, in d = 2 or 3 dimensions; F and internal forces of the rows.

    Attributes
    ----------
    dimension : int -- d.
    memory : (capacity, 2 d) float -- the state, with room for further ghosts [µm, µm/µs].
    X : (capacity, d) float -- reference positions [µm].
    numbering : Numbering -- of the present ghosts, those of contacts among them.
    solution : Vec -- the owned part, for PETSc's TS.
    """

    FIELDS = (
        Field("n_owned", "long", doc="owned particles, which come first"),
        Field("n_rows", "long", doc="particles whose stress is computed: owned, and first neighbours of these"),
        Field("n_local", "long", doc="particles with ghosts"),
        Field("n_shared_blocks", "long", doc="blocks with particles that other ranks have ghosts of; they come first"),
        Field("n_owned_blocks", "long", doc="blocks of owned particles"),
        Field("n_blocks", "long", doc="blocks of all rows"),
        Field("block", "int32_t *", "(n_blocks, 6)", "",
              "first row, number of rows, stencil, shift, material, whether more than stresses may act"),
        Field("state", "double *", "(n_local, 2 d)", "µm, µm/µs", "u, then v; ghosts are exchanged in each step"),
        Field("state_vec", "void *", doc="what exchanges it: a Vec of PETSc or a `SharedCopies`"),
        Field("X", "double *", "(n_local, d)", "µm", "reference positions"),
        Field("acceleration", "double *", "(d,)", "µm/µs²", "of the body force"),
        Field("inverse_mass", "double *", "(n_rows,)", "µm/fg", "1/m"),
        Field("F", "double *", "(n_blocks, d², 4)", "-", "deformation gradients: entries by columns, by lanes"),
        Field("bend", "double *", "(n_blocks, d, 4)", "1/µm", "Laplacians C u: components by lanes"),
        Field("base", "double *", "(n_blocks, d² + d, 4)", "-, 1/µm",
              "F and C x at u = 0, where neighbours are found anew"),
        Field("Q", "double *", "(n_rows, 4) or (n_rows, 3, 4)", "pN, pN µm",
              "V P, from the first pass to the second; in three dimensions (V P, bent) of each component"),
        Field("bent", "double *", "(n_rows, 2)", "pN µm", "of stabilisation, from the first pass to the second"),
        Field("force", "double *", "(n_local, d)", "pN/µm", "of surfaces and loads, in a step"),
        Field("step_memory", "StepMemory *", "(n_blocks,)", "", "what the accounts of the next step need of this one"),
        # coefficients by stencil, which blocks with identical patterns share
        Field("volume", "double *", "(stencils, 4)", "µm²", "V"),
        Field("grade", "double *", "(stencils, 4)", "", "elastic moduli over those of the laws, if any differ"),
        Field("per_mass", "double *", "(stencils, 4)", "µm/fg", "1/m"),
        Field("bulk_damping", "double *", "(stencils, 4)", "Pa µs", "bulk viscosity of the numerical damping"),
        Field("first", "long *", "(stencils + 1,)", "", "groups of neighbours of each stencil"),
        Field("column", "uint32_t *", "(groups, 4)", "", "2 d times the neighbours' local numbers"),
        Field("gradient", "coefficient *", "(groups, 8) or (groups, 4, 4)", "1/µm", "G; in space (G, C) by lanes"),
        Field("adjoint", "coefficient *", "(groups, 8) or (groups, 4, 4)", "1/µm", "-Gᵀ; in space (-Gᵀ, -Cᵀ) by lanes"),
        Field("first_laplacian", "long *", "(stencils + 1,)", "", "those of the next two, the first of each stencil"),
        Field("laplacian", "coefficient *", "(groups, 4)", "1/µm²", "C"),
        Field("bending", "coefficient *", "(groups, 4)", "1/µm²", "-Cᵀ"),
        Field("bending_weight", "double *", "(stencils, 4)", "pN µs µm²", "of the viscous stabilisation"),
        Field("bending_modulus", "double *", "(stencils, 4)", "pN µm²", "of the elastic stabilisation"),
        # step control
        Field("least_gap", "double *", "(1,)", "µm", "least gap to the substrate"),
        Field("J_range", "double *", "(2, 4)", "-", "least and largest J, by lanes"),
        Field("bound", "double *", "(n_owned, d (d + 1)/2)", "1/(µm fg)", "local bound of the stiffness: Σ_J G⊗G/m_J"),
        Field("viscous_weight", "double *", "(n_owned,)", "Pa µs", "modulus of that bound, viscous"),
        Field("elastic_weight", "double *", "(n_owned,)", "Pa", "modulus of that bound, elastic"),
    )

    def __init__(self, part: Subdomain, kernel: Kernel):
        """Begin at rest in the reference configuration; collective."""
        self._part, self._kernel = part, kernel
        self.dimension = d = part.scene.dimension
        self.memory, self.X = aligned_zeros((part.capacity, 2 * d)), aligned_zeros((part.capacity, d))
        super().__init__(part.comm, self.memory, part.n_owned, part.numbering.shared.sum())
        self.solution = PETSc.Vec().createWithArray(self.owned.ravel(), size=(2 * d * part.n_owned, None),
                                                    bsize=2 * d, comm=part.comm)
        self.X[: len(part.numbering.ids)] = part.scene.particles(part.numbering.ids).X
        kernel["X"], kernel["state"] = self.X, self.memory
        self.renumber(part.numbering)
        self._set_rows()
        if part.comm.size > 1:
            kernel["ghost_begin"], kernel["ghost_end"] = self.exchange_functions

    def renumber(self, numbering: Numbering) -> None:
        """Change the ghosts; collective."""
        self.numbering = numbering
        fixed = len(self._part.numbering.ids)  # further ghosts are of contacts
        self.X[fixed : len(numbering.ids)] = self._part.scene.particles(numbering.ids[fixed:]).X
        self.in_petsc = self._part.in_petsc(numbering)
        self.set_ghosts(self.in_petsc[self._part.n_owned :])
        self.exchange()
        self._kernel["n_local"], self._kernel["state_vec"] = len(numbering.ids), self.handle

    def _set_rows(self) -> None:
        """Set the coefficients of the rows, and allocate the arrays of results."""
        part, k, blocks, scene = self._part, self._kernel, self._part.blocks, self._part.scene
        n_blocks, d = len(blocks.table), self.dimension
        k["n_owned"], k["n_rows"] = part.n_owned, part.numbering.n_rows
        k["n_shared_blocks"], k["n_owned_blocks"], k["n_blocks"] = blocks.n_shared, blocks.n_owned, n_blocks
        for name, values in stencil_arrays(scene, part.numbering, blocks, part.terms).items():
            k[name] = values
        k["inverse_mass"] = 1.0 / part.rows.field("mass")
        k["step_memory"] = np.zeros(n_blocks, step_memory(part.terms))
        k["F"], k["bend"] = np.zeros((n_blocks, d * d, 4)), np.zeros((n_blocks, d, 4))
        if part.terms.renewal is not None:
            self._set_base()
        k["Q"], k["bent"] = np.zeros((part.capacity, 4 if d == 2 else 12)), np.zeros((part.capacity, 2))
        k["force"] = np.zeros((part.capacity, d))
        k["least_gap"], k["stiffest_contact"], k["J_range"] = np.full(1, np.inf), np.zeros(1), NO_J.copy()
        k["deepest_contact"] = np.zeros(1)
        for name in ("bound", "viscous_weight", "elastic_weight"):
            k[name] = part.owned.field(name)
        k["acceleration"] = part.terms.acceleration or (0.0,) * d

    def _set_base(self) -> None:
        """Set what F and C u are where u = 0, and the inverse of F when the neighbours were found."""
        part, d = self._part, self.dimension
        block, lane = part.blocks.lanes_of
        base = part.rows.field("base")
        entries = np.concatenate([base[:, :d].transpose(0, 2, 1).reshape(len(base), -1), base[:, d]], axis=1)
        self._kernel["base"] = np.zeros((len(part.blocks.table), d * d + d, 4))
        self._kernel["base"][:, : d * d : d + 1] = 1.0  # where a block lacks lanes
        self._kernel["base"][block, :, lane] = entries
        F0 = np.broadcast_to(np.eye(d), (part.n_owned, d, d)).copy()
        for kind, on, at in part.owned.by_kind():
            if (found := part.scene.templates[kind].F0) is not None:
                F0[on] = found[at]
        self._inverse = np.linalg.inv(F0)

    def since_renewal(self) -> np.ndarray:
        """Deformation gradients (d, d, n_owned) [-] since the neighbours were found; as current as F."""
        F = self.F_of_rows[: self._part.n_owned].reshape(-1, self.dimension, self.dimension).transpose(0, 2, 1)
        if self._part.terms.renewal is not None:
            F = F @ self._inverse
        return F.transpose(1, 2, 0)

    def set_blocks(self, loaded: np.ndarray) -> None:
        """Set the kernel's blocks; `loaded` (k,) int : local numbers of particles with forces besides stresses."""
        table, n_rows = self._part.blocks.table, self._part.numbering.n_rows
        on = np.zeros(n_rows, bool)
        on[loaded[(loaded >= 0) & (loaded < n_rows)]] = True
        block, _ = self._part.blocks.lanes_of
        self._kernel["block"] = np.column_stack([table, np.bincount(block, on, len(table)) > 0])

    def stiffen(self, modulus: np.ndarray, on: np.ndarray | slice = slice(None)) -> None:
        """Add a `modulus` (k,) [Pa] to those that limit the step, `on` (k,) int owned particles or all."""
        self._kernel["elastic_weight"][on] += modulus

    @property
    def mass(self) -> np.ndarray:
        """Masses of the owned particles (n_owned,) [fg/µm]."""
        return 1.0 / self._kernel["inverse_mass"][: self._part.n_owned]

    @property
    def u(self) -> np.ndarray:
        """Displacements of the owned particles (n_owned, d) [µm], writable."""
        return self.owned[:, : self.dimension]

    @property
    def v(self) -> np.ndarray:
        """Velocities of the owned particles (n_owned, d) [µm/µs], writable."""
        return self.owned[:, self.dimension :]

    @property
    def changing(self) -> dict[str, np.ndarray]:
        """Arrays that steps change: state (n_local, 2 d) [µm, µm/µs], F (n_blocks, d², 4) [-], step memory,
        Laplacians (n_blocks, d, 4) [1/µm], and the range of J (2, 4) [-].
        """
        return {"state": self.array, **{name: self._kernel[name] for name in ("F", "bend", "step_memory", "J_range")}}

    @property
    def F_of_rows(self) -> np.ndarray:
        """F (n_rows, d²) [-], row by row, entries by columns; current after `Mechanics.rate`."""
        return self.by_row(self._kernel["F"])

    @property
    def J_of_rows(self) -> np.ndarray:
        """J (n_rows,) [-]; current after `Mechanics.rate`."""
        return determinant(self.F_of_rows.reshape(-1, self.dimension, self.dimension).T)

    def extremes(self) -> np.ndarray:
        """Extremes of this rank (4,): minus the least gap [µm] and the largest stiffness of contacts [1/µs²] since they
        were forgotten, minus smallest J, largest J [-] since the last call.
        """
        k = self._kernel
        J = k["J_range"].reshape(2, 4)
        found = np.array([-k["least_gap"][0], k["stiffest_contact"][0], -J[0].min(), J[1].max()])
        self.forget_contacts()
        k["J_range"][:] = NO_J
        return found

    def forget_contacts(self) -> None:
        """Begin the extremes of gaps and contacts again."""
        self._kernel["least_gap"][:] = np.inf
        self._kernel["stiffest_contact"][:] = self._kernel["deepest_contact"][:] = 0.0

    def x(self, numbers: np.ndarray) -> np.ndarray:
        """Current positions (..., d) [µm] of the particles with local `numbers` (...) int."""
        return self.X[numbers] + self.memory[numbers, : self.dimension]

    def by_row(self, blocks: np.ndarray) -> np.ndarray:
        """Values by row (n_rows, k) of an array by `blocks` (n_blocks, k, 4), in its unit."""
        block, lane = self._part.blocks.lanes_of
        return blocks[block, :, lane]

    def set_by_row(self, blocks: np.ndarray, values: np.ndarray) -> None:
        """Set an array by `blocks` (n_blocks, k, 4) to values by row (n_rows, k), in its unit."""
        block, lane = self._part.blocks.lanes_of
        blocks[block, :, lane] = values

    def tensors(self) -> tuple[np.ndarray, np.ndarray]:
        """F and Ḟ of the rows, owned first, (d, d, n_rows) each [-], [1/µs]; current after `Mechanics.rate`."""
        rates, d = np.zeros_like(self._kernel["F"]), self.dimension
        self._kernel("velocity_gradient", rates)
        F, Fdot = (self.by_row(a).reshape(-1, d, d).transpose(2, 1, 0) for a in (self._kernel["F"], rates))
        return F, Fdot

    def destroy(self) -> None:
        """Free the objects of PETSc and MPI; collective."""
        super().destroy()
        self.solution.destroy()


NO_J = np.repeat([np.inf, -np.inf], 4)
