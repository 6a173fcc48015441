"""Fields of KernelData, the structure that Python fills and C works on."""

from __future__ import annotations

from dataclasses import dataclass


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


LAWS = tuple(Field(name, "double *", "(parameters,)", "", f"parameters of the law of {name}")
             for name in ("substrate", "contact", "protrusion", "cortex", "friction", "load_curves"))
