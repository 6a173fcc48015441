"""Plain implementations of the internal force over CSR rows, in numpy and as a loop in C, and the limits of a core.

Both have the laws, neighbours and coefficients of the scene, in double precision, without accounts, bulk damping and
surfaces.  Ratios to their times can be compared between machines.
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

from .timing import STILL, Timer

_LOOP = """
/* F += dt Ḟ, Q = V P(F, Ḟ), f = -S v. */
void stress(long n, const long *first, const int *column, const double *G, const long *first_s,
            const int *column_s, const double *S, const double *V, const int *material, const double *const *p,
            const double *v, double dt, double *F, double *Q, double *f)
{
    for (long i = 0; i < n; i++) {
        double R[2][2] = {{0}}, s[2] = {0};
        for (long k = first[i]; k < first[i + 1]; k++) {
            const double *w = v + 2 * column[k];
            for (int c = 0; c < 2; c++) {
                R[c][0] += w[c] * G[2 * k];
                R[c][1] += w[c] * G[2 * k + 1];
            }
        }
        for (long k = first_s[i]; k < first_s[i + 1]; k++)
            for (int c = 0; c < 2; c++) s[c] += S[k] * v[2 * column_s[k] + c];
        const double (*F_)[2] = (const double (*)[2])(F + 4 * i), (*R_)[2] = (const double (*)[2])R;
        double P[2][2], W[2][2];
        for (int c = 0; c < 4; c++) F[4 * i + c] += dt * R[c / 2][c % 2];
        EACH_MATERIAL
        for (int c = 0; c < 4; c++) Q[4 * i + c] = V[i] * P[c / 2][c % 2];
        f[2 * i] = -s[0];
        f[2 * i + 1] = -s[1];
    }
}

/* f += H Q with H = -Gᵀ on the same pattern; v += dt f/m, u += dt v. */
void kick(long n, const long *first, const int *column, const double *H, const double *Q, const double *inverse_mass,
          double dt, double *f, double *u, double *v)
{
    for (long i = 0; i < n; i++) {
        double a = f[2 * i], b = f[2 * i + 1];
        for (long k = first[i]; k < first[i + 1]; k++) {
            const double *q = Q + 4 * column[k];
            a += q[0] * H[2 * k] + q[1] * H[2 * k + 1];
            b += q[2] * H[2 * k] + q[3] * H[2 * k + 1];
        }
        f[2 * i] = a;
        f[2 * i + 1] = b;
        v[2 * i] += dt * inverse_mass[i] * a;
        v[2 * i + 1] += dt * inverse_mass[i] * b;
        u[2 * i] += dt * v[2 * i];
        u[2 * i + 1] += dt * v[2 * i + 1];
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
    """The internal force of a scene over CSR rows of all its particles."""

    def __init__(self, scene: Scene):
        """Prepare both implementations."""
        self.materials, self.size = scene.materials, scene.size
        templates = [scene.templates[k] for k in scene.kind]
        self.G = [sparse.block_diag([t.G[k] for t in templates], "csr") for k in range(2)]
        self.H = [(-part.T).tocsr() for part in self.G]
        for part in [*self.G, *self.H]:
            part.sort_indices()
        self.S = sparse.block_diag([t.S for t in templates], "csr")
        self.V, self.mass = scene.field("V"), scene.field("mass")
        self.material = np.asarray(scene.material, np.int32)
        self.F = np.zeros((scene.size, 2, 2)) + np.eye(2)
        self.Q = np.zeros((scene.size, 2, 2))
        self.force, self.u, self.v = (np.zeros((scene.size, 2)) for _ in range(3))
        self._prepare_c(self.G[0])

    def _prepare_c(self, G: Any) -> None:
        parts, chosen, self._vectors = [text_of("simd.h")], [], []
        for i, material in enumerate(self.materials):
            t = Translator(material, "double")
            parts.append(t.function("stress", f"stress_{i}"))
            call = f"stress_{i}(p[{i}], F_, P);"
            if hasattr(material, "viscous_stress"):
                parts.append(t.function("viscous_stress", f"viscous_{i}"))
                call += f" viscous_{i}(p[{i}], F_, R_, W); for (int c = 0; c < 4; c++) P[c/2][c%2] += W[c/2][c%2];"
            chosen.append(f"if (material[i] == {i}) {{ {call} }}")
            self._vectors.append(np.array(t.vector()))
        each = f"#define EACH_MATERIAL {' else '.join(chosen)}"
        self.library = loaded("\n".join([*parts, each, _LOOP, _LIMITS]))
        self._parameters = np.array([v.ctypes.data for v in self._vectors], np.uint64)
        self._first, self._column = G.indptr.astype(np.int64), G.indices.astype(np.int32)
        self._G = np.column_stack([part.data for part in self.G]).ravel()
        self._H = np.column_stack([part.data for part in self.H]).ravel()
        self._stabilisation = self.S.indptr.astype(np.int64), self.S.indices.astype(np.int32), self.S.data
        self._inverse_mass = 1.0 / self.mass

    def numpy_step(self, dt: float) -> None:
        """A step [µs] in numpy and scipy."""
        Gx, Gy = self.G
        rate = np.stack([Gx @ self.v, Gy @ self.v], axis=-1)  # [i, component, direction]
        self.F += dt * rate
        for i, material in enumerate(self.materials):
            on = self.material == i
            F, R = (np.moveaxis(a[on], 0, -1) for a in (self.F, rate))
            P = np.array(material.stress(F))
            if hasattr(material, "viscous_stress"):
                P = P + np.array(material.viscous_stress(F, R))
            self.Q[on] = np.moveaxis(self.V[on] * P, -1, 0)
        self.force = self.H[0] @ self.Q[:, :, 0] + self.H[1] @ self.Q[:, :, 1] - self.S @ self.v
        self.v += dt * self._inverse_mass[:, None] * self.force
        self.u += dt * self.v

    def loop_step(self, dt: float) -> None:
        """A step [µs] in C."""
        p, n, step = _address, ctypes.c_long(self.size), ctypes.c_double(dt)
        self.library.stress(n, p(self._first), p(self._column), p(self._G), *map(p, self._stabilisation),
                            p(self.V), p(self.material), p(self._parameters), p(self.v), step, p(self.F), p(self.Q),
                            p(self.force))
        self.library.kick(n, p(self._first), p(self._column), p(self._H), p(self.Q), p(self._inverse_mass), step,
                          p(self.force), p(self.u), p(self.v))

    def nanoseconds(self, step: Callable[[float], None], repeats: int) -> list[float]:
        """Wall time of a particle-step [ns], by measurement, in steps too short to change the state."""
        return Timer(MPI.COMM_SELF, self.size, repeats)(lambda n: [step(STILL) for _ in range(n)])["wall"]

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


def _address(a: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(a.ctypes.data)
