"""A run with fields leaves a file in which ParaView shows them on the substrate."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
from scenes import case

from mpi4py import MPI

from cellmig.output.profile import NAME, write_profile


@pytest.mark.serial
@pytest.mark.parametrize("scene", ["one_cell", "ball"])
def test_fields_stand_on_the_substrate_around_the_cells(scene: str, tmp_path: Path) -> None:
    found = case(scene, 'fields.c.formula="5 + 0.02*x nM"', 'fields.gone.formula="5*t_h nM"',
                 'substrate.stiffness="3000 + 2*abs(x) Pa"')
    write_profile(tmp_path, MPI.COMM_SELF, found)
    mesh = meshio.read(tmp_path / NAME)
    x = mesh.points[:, 0]
    assert sorted(mesh.point_data) == ["c [nM]", "stiffness [Pa]"]
    assert x.min() < -200.0 and x.max() > 200.0 and mesh.points[:, 1 if scene == "one_cell" else 2].max() == 0.0
    np.testing.assert_allclose(mesh.point_data["c [nM]"], np.maximum(5.0 + 0.02 * x, 0.0), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(mesh.point_data["stiffness [Pa]"], 3000.0 + 2.0 * np.abs(x), rtol=1e-12)
    assert mesh.cells_dict["quad"].max() == len(x) - 1


@pytest.mark.serial
def test_a_case_without_fields_leaves_no_such_file(tmp_path: Path) -> None:
    write_profile(tmp_path, MPI.COMM_SELF, case("one_cell"))
    assert not list(tmp_path.iterdir())
