"""Pictures of cells in space: sections, and surfaces drawn by PyVista where it is installed."""

from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from bodies import ball
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.text import Text

from cellmig.case.schema import Plate
from cellmig.case.time_unit import MICROSECOND
from cellmig.model.load_curve import Ramp
from cellmig.plot import rendered
from cellmig.plot.section import Section, _outline, cut
from cellmig.plot.space import Solid, _front, directions
from cellmig.plot.style import STYLE
from cellmig.plot.view import View

pytestmark = pytest.mark.serial


def test_a_section_through_a_ball_has_its_area_and_its_rim_and_linear_fields_are_exact():
    body = ball(1000, 5.0)
    for y in (0.0, 2.0):
        pair, share, triangles = cut(body.X[:, 1] - y, body.tetrahedra)
        x = body.X[pair[:, 0]] + share[:, None] * (body.X[pair[:, 1]] - body.X[pair[:, 0]])
        assert np.abs(x[:, 1] - y).max() < 1e-14  # measured 9e-16
        a, b, c = x[triangles][..., [0, 2]].transpose(1, 0, 2)
        area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
        rim = np.linalg.norm(np.diff(x[_outline(triangles)], axis=1), axis=2).sum()
        radius = np.sqrt(25.0 - y * y)
        assert area == pytest.approx(np.pi * radius**2, rel=0.02)  # measured 0.011 less: flat triangles
        assert rim == pytest.approx(2.0 * np.pi * radius, rel=0.01)  # measured 0.005 less
    assert not len(cut(body.X[:, 1] - 6.0, body.tetrahedra)[2])  # beside it


def test_a_plane_through_particles_cuts_every_tetrahedron_once():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]])
    tetrahedra = np.array([[0, 1, 2, 3], [0, 3, 1, 4]])
    pair, share, triangles = cut(corners[:, 1], tetrahedra)  # the face between both is in the plane
    x = corners[pair[:, 0]] + share[:, None] * (corners[pair[:, 1]] - corners[pair[:, 0]])
    sides = x[triangles][:, 1:] - x[triangles][:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    assert area == pytest.approx(0.5) and np.isfinite(share).all()


def test_directors_are_lines_through_their_particles_as_long_as_they_are_seen():
    x = np.array([[0.0, 0, 0], [2, 0, 0], [0, 0, 2], [0, 5, 0]])
    fields = {"X": x, "u": 0.0 * x + 1.0, "director": np.array([[1.0, 0, 0], [0.6, 0.8, 0], [0, 0, -1], [0, 1, 0]])}
    view, ax = View("J", "", Normalize(), "neither", x[0], x[0], False), Figure().subplots()
    view.lines(ax, fields, np.arange(3), [0, 2])
    (lines,) = ax.collections
    ends = np.array(lines.get_segments())
    assert np.allclose(ends.mean(axis=1), [[1.0, 1.0], [3.0, 1.0], [1.0, 3.0]])
    assert np.allclose(np.diff(ends, axis=1)[:, 0], 0.8 * 2.0 * fields["director"][:3, [0, 2]])


def test_faces_of_plates_are_lines_where_they_are_at_the_time_and_cut_the_section():
    ramp = {"displacement": (0.0, 0.0, -3.0), "load_curve": Ramp(duration=40.0)}
    plates = tuple(Plate(name=name, point=point, normal=normal, **ramp) for name, point, normal in (
        ("top", (0.0, 0.0, 10.0), (0.0, 0.0, -2.0)), ("slope", (1.0, 2.0, 0.0), (1.0, 1.0, 1.0)),
        ("front", (0.0, -5.0, 0.0), (0.0, 1.0, 0.0))))
    low, high = np.array([[-5.0, 0.0], [5.0, 10.0]])
    view = Section("J", "", Normalize(), "neither", low, high, False, np.empty((0, 4), int), plates=plates)
    for time, down in ((0.0, 0.0), (20.0, 1.5), (80.0, 3.0)):
        ax = Figure().subplots()
        view.draw_plates(ax, SimpleNamespace(time=time, unit=MICROSECOND), y=0.5)
        top, slope = (line.get_xydata() for line in ax.lines)
        assert np.allclose(top[:, 1], 10.0 - down) and np.allclose(slope.sum(axis=1), 3.0 - down - 0.5)
        assert np.ptp(top[:, 0]) > 10.0 and np.ptp(slope[:, 0]) > 10.0


@pytest.mark.parametrize(("vtk", "display", "draws"), [
    ("9.4.1", "", True), ("9.1.0", "", False), ("9.1.0", ":0", True)])
def test_an_old_vtk_draws_only_where_there_is_a_display(monkeypatch, vtk, display, draws):
    monkeypatch.setattr(rendered, "version", lambda name: vtk)
    monkeypatch.setattr(rendered, "find_spec", lambda name: object())
    monkeypatch.setenv("DISPLAY", display)
    assert rendered.is_there() is draws


@pytest.mark.parametrize("extent", [(30.0, 10.0, 10.0), (16.0, 16.0, 4.0), (10.9, 2.9, 2.9), (10.0, 10.0, 10.0),
                                    (40.0, 40.0, 10.0), (6.0, 6.0, 24.0), (10.0, 20.0, 10.0)])
@pytest.mark.parametrize("n", [1, 3])
def test_numbers_and_names_of_axes_in_space_do_not_cover_each_other_or_the_colours_of_long_and_flat_scenes(extent, n):
    high = 0.5 * np.array(extent)
    with matplotlib.rc_context(STYLE):
        figure, axes = Solid("J", "J", Normalize(), "neither", -high, high, False).panels(n)
        for ax in axes:
            ax.set_title("t = 0 µs", ha="left")
        FigureCanvasAgg(figure).draw()
    texts = [text for ax in figure.axes for text in ax.findobj(Text) if text.get_text() and text.get_visible()]
    boxes = np.array([text.get_window_extent().extents for text in texts])
    inside = figure.bbox.extents
    assert {"x [µm]", "t = 0 µs"} <= {text.get_text() for text in texts}
    assert (boxes[:, :2] >= inside[:2]).all() and (boxes[:, 2:] <= inside[2:]).all()
    middles = 0.5 * (boxes[:, :2] + boxes[:, 2:])  # boxes of names that are turned are larger than these
    within = ((boxes[:, None, :2] < middles) & (middles < boxes[:, None, 2:])).all(axis=2)
    assert within.sum() == len(texts)  # its own


def test_what_is_drawn_last_of_a_ball_in_space_is_the_half_that_turns_to_the_eye():
    body = ball(1000, 5.0)
    view = Solid("J", "", Normalize(), "neither", np.full(3, -6.0), np.full(3, 6.0), False)
    corners = body.X[body.triangles]
    front = _front(view.panels(1)[1][0], corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = normals @ directions()[2] / np.linalg.norm(normals, axis=1)
    assert 0.4 < front.mean() < 0.5  # a near eye sees less than a half
    assert towards[front].min() > -0.1 and towards[~front].max() < 0.5
