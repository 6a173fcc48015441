"""Fields of KernelData, the structure that Python fills and C works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..meshfree.terms import Terms


@dataclass(frozen=True)
class Field:
    """A number or an array of the kernel.

    name : in C and in Python;  ctype : "double", "long" or a pointer such as "double *";  shape : of the array, such as
    "(n_rows, 2)", "" for a number;  unit : such as "µm";  doc : what it is, and which ranks exchange it.
    """

    name: str
    ctype: str
    shape: str = ""
    unit: str = ""
    doc: str = ""


def step_memory(terms: Terms) -> np.dtype:
    """What a block remembers of a step for the trapezoidal work of the next, and accounts until they are settled.

    viscous, active : V P of each [pN], by entries, the viscous one with that of the stabilisation;  bent : its stress
    conjugate to C v [pN µm];  bulk : pressure of the bulk damping times V [pN];  viscous_loss, artificial_dissipation,
    external_work, network_loss : of each lane [pN].  Single precision is enough where no force is made of them; what a
    scene lacks is empty.
    """
    stabilised, active, D = int(terms.stabilised), int(terms.active), terms.dimension
    return np.dtype([("viscous_loss", "f8", 4), ("artificial_dissipation", "f8", 4), ("viscous", "f4", (D * D, 4)),
                     ("bent", "f4", (D * stabilised, 4)), ("bulk", "f4", (1, 4)),
                     ("external_work", "f8", (4 * active,)), ("network_loss", "f8", (4 * terms.network,)),
                     ("active", "f4", (D * D * active, 4))])
