"""Plain implementations of the internal force over CSR rows, in numpy and as a loop in C, and the limits of a core.

Both have the laws, neighbours and coefficients of the scene, in the plane and in space, in double precision, without
accounts and surfaces.  Ratios to their times can be compared between machines.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse

from mpi4py import MPI

from cellmig.kernel.codegen import Translator
from cellmig.kernel.source import text_of
from cellmig.kernel.toolchain import loaded
from cellmig.meshfree.scene import Scene
from cellmig.meshfree.stabilisation import BulkDamping, Stabilisation

from .timing import STILL, Timer

_LOOP = """
enum { E = D + 1 }; /* coefficients of a neighbour: those of G and C */

/* F += dt Ḟ, C u likewise; rows of Q: V P(F, Ḟ) and what resists Laplacians. */
void stress(long n, const long *first, const int *column, const double *G, const double *V, const double *weight,
            const double *modulus, const double *bulk, const int *material, const double *const *p, const double *v,
            double dt, double *F_, double *bend, double *Q)
{
    for (long i = 0; i < n; i++, F_ += D * D, bend += D, Q += D * E) {
        double sum[D][E] = {{0}}, F[D][D], R[D][D], P[D][D], W[D][D], B[D][D], rate[D], q[D], unused;
        for (long k = first[i]; k < first[i + 1]; k++)
            for (int c = 0; c < D; c++)
                for (int d = 0; d < E; d++) sum[c][d] += v[D * column[k] + c] * G[E * k + d];
        for (int c = 0; c < D; c++) {
            for (int d = 0; d < D; d++) {
                R[c][d] = sum[c][d];
                F[c][d] = F_[D * c + d] += dt * R[c][d];
            }
            bend[c] += dt * (rate[c] = sum[c][D]);
        }
        EACH_MATERIAL
        stabilisation(0, weight[i], F, R, bend, rate, q, W);
        bulk_damping(0, bulk[i], F, R, B, &unused, &unused);
        for (int c = 0; c < D; c++) {
            for (int d = 0; d < D; d++) Q[E * c + d] = V[i] * (P[c][d] + B[c][d]) + W[c][d];
            Q[E * c + D] = q[c] + modulus[i] * bend[c];
        }
    }
}

/* f = H Q, where H = -(G, C)ᵀ; v += dt f/m, u += dt v. */
void kick(long n, const long *first, const int *column, const double *H, const double *Q, const double *inverse_mass,
          double dt, double *f, double *u, double *v)
{
    for (long i = 0; i < n; i++) {
        double sum[D] = {0};
        for (long k = first[i]; k < first[i + 1]; k++)
            for (int c = 0; c < D; c++)
                for (int d = 0; d < E; d++) sum[c] += Q[E * (D * column[k] + c) + d] * H[E * k + d];
        for (int c = 0; c < D; c++) {
            f[D * i + c] = sum[c];
            v[D * i + c] += dt * inverse_mass[i] * sum[c];
            u[D * i + c] += dt * v[D * i + c];
        }
    }
}
"""

_LIMITS = """
/* a = b + s c with n doubles each: 24 n bytes, 32 n with the cache lines of a that are read before they are written. */
void triad(long n, double *a, const double *b, const double *c)
{
    for (long i = 0; i < n; i++) a[i] = b[i] + 3.0 * c[i];
}

/* 12 independent chains of n multiply-adds on vectors of four: 96 n operations. */
double multiply_add(long n, double x)
{
    v4 a[12], s = {0};
    for (int j = 0; j < 12; j++) a[j] = splat(j + x);
    for (long i = 0; i < n; i++)
#pragma GCC unroll 12
        for (int j = 0; j < 12; j++) a[j] = fma4(a[j], splat(0.999), splat(x));
    for (int j = 0; j < 12; j++) s += a[j];
    return s[0] + s[1] + s[2] + s[3];
}
"""


class Baseline:
    """The internal force of a scene over CSR rows of all its particles.

    F : (n, D, D) -- deformation gradients [-].  bend : (n, D) -- Laplacians C u [1/µm].  u, v, force : (n, D) [µm],
    [µm/µs], [pN], in the plane force per thickness [pN/µm].
    """

    def __init__(self, scene: Scene):
        """Prepare both implementations."""
        self.materials, n, self.D = scene.materials, scene.size, scene.dimension
        templates = [scene.templates[k] for k in scene.kind]
        self.G = [sparse.block_diag(parts, "csr") for parts in zip(*([*t.G, t.C] for t in templates), strict=True)]
        self.H = [(-part.T).tocsr() for part in self.G]
        self.V, self.weight, self.modulus, self.bulk, self.mass = (
            scene.field(name) for name in ("V", "bending_weight", "bending_modulus", "damping", "mass"))
        self.material, self._inverse_mass = np.asarray(scene.material, np.int32), 1.0 / self.mass
        self.F = np.zeros((n, self.D, self.D)) + np.eye(self.D)
        self.Q = np.zeros((n, self.D, self.D + 1))
        self.force, self.u, self.v, self.bend = (np.zeros((n, self.D)) for _ in range(4))
        self._prepare_c()

    def _prepare_c(self) -> None:
        parts, chosen, self._vectors = [text_of("simd.h"), f"enum {{ D = {self.D} }};"], [], []
        for law, name, results in ((Stabilisation(), "stabilisation", ("q", "stress")),
                                   (BulkDamping(), "bulk_damping", ("stress", "pressure", "rate"))):
            parts.append(Translator(law, "double", self.D).function("stress", name, results))
        for i, material in enumerate(self.materials):
            t = Translator(material, "double", self.D)
            parts.append(t.function("stress", f"stress_{i}"))
            call = f"stress_{i}(p[{i}], F, P);"
            if hasattr(material, "viscous_stress"):
                parts.append(t.function("viscous_stress", f"viscous_{i}"))
                call += f" viscous_{i}(p[{i}], F, R, W); for (int c = 0; c < D * D; c++) P[c/D][c%D] += W[c/D][c%D];"
            chosen.append(f"if (material[i] == {i}) {{ {call} }}")
            self._vectors.append(np.array(t.vector()))
        each = f"#define EACH_MATERIAL {' else '.join(chosen)}"
        self.library = loaded("\n".join([*parts, each, _LOOP, _LIMITS]))
        self._parameters = np.array([v.ctypes.data for v in self._vectors], np.uint64)
        self._gradient, self._adjoint = _rows(self.G), _rows(self.H)

    def numpy_step(self, dt: float) -> None:
        """A step [µs] in numpy and scipy."""
        *columns, bend_rate = (part @ self.v for part in self.G)
        rate = np.stack(columns, axis=-1)  # [i, component, direction]
        self.F += dt * rate
        self.bend += dt * bend_rate
        F, R, bend, change = (np.moveaxis(a, 0, -1) for a in (self.F, rate, self.bend, bend_rate))
        q, W = map(np.array, Stabilisation().stress(self.weight, F, R, bend, change))
        P = np.array(BulkDamping().stress(self.bulk, F, R)[0])
        for i, material in enumerate(self.materials):
            on = self.material == i
            P[..., on] += material.stress(F[..., on])
            if hasattr(material, "viscous_stress"):
                P[..., on] += material.viscous_stress(F[..., on], R[..., on])
        self.Q[:, :, :-1] = np.moveaxis(self.V * P + W, -1, 0)
        self.Q[:, :, -1] = np.moveaxis(q + self.modulus * bend, -1, 0)
        self.force = sum(part @ self.Q[:, :, k] for k, part in enumerate(self.H))
        self.v += dt * self._inverse_mass[:, None] * self.force
        self.u += dt * self.v

    def loop_step(self, dt: float) -> None:
        """A step [µs] in C."""
        n, step = ctypes.c_long(len(self.V)), ctypes.c_double(dt)
        fixed = self.V, self.weight, self.modulus, self.bulk, self.material, self._parameters
        G, H, fixed, changed, inverse_mass, moved = (tuple(map(_address, arrays)) for arrays in (
            self._gradient, self._adjoint, fixed, (self.F, self.bend, self.Q), (self._inverse_mass,),
            (self.force, self.u, self.v)))
        self.library.stress(n, *G, *fixed, moved[-1], step, *changed)
        self.library.kick(n, *H, changed[-1], *inverse_mass, step, *moved)

    def nanoseconds(self, step: Callable[[float], None], repeats: int) -> list[float]:
        """Wall time of a particle-step [ns], by measurement, in steps too short to change the state."""
        return Timer(MPI.COMM_SELF, len(self.V), repeats)(lambda n: [step(STILL) for _ in range(n)])["wall"]

    def limits(self, repeats: int) -> dict[str, list[float]]:
        """Memory bandwidth [GB/s] and floating-point rate [GFlop/s] of one core, by measurement."""
        size, length, timer = 8_000_000, 1_000_000, Timer(MPI.COMM_SELF, 1, repeats)
        arrays = [np.ones(size) for _ in range(3)]
        self.library.multiply_add.restype = ctypes.c_double
        triad, _ = timer.seconds(lambda n: [self.library.triad(ctypes.c_long(size), *map(_address, arrays))
                                            for _ in range(n)])
        chains, _ = timer.seconds(lambda n: [self.library.multiply_add(ctypes.c_long(length), ctypes.c_double(0.5))
                                             for _ in range(n)])
        return {"bandwidth": [32e-9 * size / t for t in triad], "arithmetic": [96e-9 * length / t for t in chains]}


def _rows(parts: list[Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First entries (n + 1,) int, columns (k,) int, and coefficients (k, parts) [1/µm], [1/µm²] of the rows of matrices
    on the pattern of all.
    """
    pattern = sum(map(abs, parts)).tocsr()
    row, column = pattern.nonzero()
    return (np.searchsorted(row, np.arange(len(pattern.indptr))), column.astype(np.int32),
            np.column_stack([np.asarray(part[row, column]).ravel() for part in parts]))


def _address(a: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(a.ctypes.data)
