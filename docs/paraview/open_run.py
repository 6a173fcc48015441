"""Open a run in ParaView with sensible colours: cells as discs of the size of a particle, filled with a field.

In ParaView: Tools > Python Shell > Run Script, which asks for the directory of the run; or from a shell

    CELLMIG_RUN=output/all_protrude paraview --script=docs/paraview/open_run.py
    pvpython docs/paraview/open_run.py output/all_protrude --field pressure --picture last.png

The colours are those of the whole run, not of one time, and the colour bar tells the unit.
"""

import argparse
import math
import os
import re

import numpy as np
from paraview import servermanager, simple
from vtkmodules.util.numpy_support import vtk_to_numpy

BOTH_SIGNS = {"pressure"}
DARK = [0.1, 0.1, 0.1]
SHARE, LOOKS = 99.0, 15  # % of the values that the colours span; at this many times


def asked():
    """The run, the field and the picture, from the command line, the environment, or a dialogue."""
    words = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    words.add_argument("run", nargs="?", default=os.environ.get("CELLMIG_RUN"), help="directory of a run")
    words.add_argument("--field", default=os.environ.get("CELLMIG_FIELD", "effective_stress"))
    words.add_argument("--picture", help="write the last frame to this PNG file")
    found, _ = words.parse_known_args()
    if not found.run:
        try:
            from PyQt5.QtWidgets import QFileDialog

            found.run = QFileDialog.getExistingDirectory(None, "Directory of a run (with cells.xdmf)")
        except ImportError:
            words.error("which run?  Give its directory, or set CELLMIG_RUN")
    return found


def opened(directory):
    """The frames of a run as one source."""
    path = os.path.join(directory, "cells.xdmf")
    if not os.path.exists(path):
        raise SystemExit(f"'{directory}' is not the directory of a run: it has no cells.xdmf")
    source = simple.Xdmf3ReaderS(registrationName=os.path.basename(os.path.abspath(directory)), FileName=[path])
    source.UpdatePipeline()
    return simple.MergeBlocks(Input=source)  # one piece for each rank that wrote


def units(directory):
    """Units of the fields of a run, which ParaView does not read; that of time is in the one of the velocity."""
    with open(os.path.join(directory, "cells.xdmf"), encoding="utf-8") as file:
        first = "".join(file.readline() for _ in range(99))
    found = re.findall(r'<Attribute Name="(\w+)"[^>]* Unit="([^"]*)"', first)
    return {name: unit.replace("um", "µm").replace("us", "µs") for name, unit in found}


def spacing(points):
    """Mean distance of particles in the first frame [µm], from their number and the area of their outline."""
    points.UpdatePipeline(0.0)
    low_x, high_x, low_y, high_y, _, _ = points.GetDataInformation().GetBounds()
    count = max(1, points.GetDataInformation().GetNumberOfPoints())
    cells = max(1.0, points.PointData["cell"].GetRange()[1])
    return math.sqrt((high_x - low_x) / cells * (high_y - low_y) * math.pi / 4.0 * cells / count)


def colour_range(points, field):
    """Limits of a field over the run that a few wild particles do not move."""
    seen, times = [], list(simple.GetAnimationScene().TimeKeeper.TimestepValues) or [0.0]
    for time in times[:: max(1, len(times) // LOOKS)]:
        points.UpdatePipeline(time)
        data = servermanager.Fetch(points)  # has to outlive the array, which looks into it
        values = vtk_to_numpy(data.GetPointData().GetArray(field)).copy()
        seen.append(np.linalg.norm(values, axis=1) if values.ndim > 1 else values)
    seen = np.concatenate(seen)
    low, high = np.percentile(seen[np.isfinite(seen)], [100.0 - SHARE, SHARE])
    if field in BOTH_SIGNS:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    return low, high if high > low else low + 1.0


def show(points, field, unit, view):
    """Discs coloured by a field, in one scale for all times."""
    if points.PointData.GetArray(field) is None:
        raise SystemExit(f"the run has no field '{field}'; it has {', '.join(sorted(points.PointData.keys()))}")
    display = simple.Show(points, view, "GeometryRepresentation")
    display.SetRepresentationType("Point Gaussian")
    display.GaussianRadius = 0.7 * spacing(points)
    display.ShaderPreset = "Plain circle"
    vector = points.PointData[field].GetNumberOfComponents() > 1
    simple.ColorBy(display, ("POINTS", field, "Magnitude") if vector else ("POINTS", field))
    colours = simple.GetColorTransferFunction(field)
    colours.ApplyPreset("Cool to Warm" if field in BOTH_SIGNS else "Viridis (matplotlib)", True)
    colours.RescaleTransferFunction(*colour_range(points, field))
    colours.AutomaticRescaleRangeMode = "Never"
    bar = simple.GetScalarBar(colours, view)
    bar.Title, bar.ComponentTitle = f"{field.replace('_', ' ')} / {unit}", ""
    bar.TitleColor = bar.LabelColor = DARK
    bar.TitleFontSize = bar.LabelFontSize = 10
    bar.AutomaticLabelFormat, bar.LabelFormat, bar.RangeLabelFormat = 0, "%.3g", "%.3g"
    bar.Orientation, bar.WindowLocation, bar.ScalarBarLength = "Horizontal", "Lower Center", 0.4
    display.SetScalarBarVisibility(view, True)


def look(view, points):
    """From the front, all of the run in sight; returns where the substrate begins and ends."""
    bounds = []
    for time in (0.0, simple.GetAnimationScene().EndTime):
        points.UpdatePipeline(time)
        bounds.append(points.GetDataInformation().GetBounds())
    low, high = np.min(bounds, axis=0)[[0, 2]], np.max(bounds, axis=0)[[1, 3]]
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    aim = centre[0], centre[1] - 0.35 * half[1]  # the colours lie below
    view.CameraParallelProjection = 1
    view.CameraFocalPoint, view.CameraPosition = [*aim, 0.0], [*aim, 100.0]
    view.CameraViewUp = [0.0, 1.0, 0.0]
    view.CameraParallelScale = 1.5 * max(half[1], half[0] * 0.36)
    return centre[0] - 1.2 * half[0], centre[0] + 1.2 * half[0]


def main():
    """Open, colour, look from the front, and write a picture if one is asked for."""
    wanted = asked()
    view = simple.GetActiveViewOrCreate("RenderView")
    view.UseColorPaletteForBackground, view.Background = 0, [1.0, 1.0, 1.0]
    view.OrientationAxesVisibility, view.InteractionMode = 0, "2D"
    points = opened(wanted.run)
    scene = simple.GetAnimationScene()
    scene.UpdateAnimationUsingDataTimeSteps()
    unit = units(wanted.run)
    show(points, wanted.field, unit.get(wanted.field, "1"), view)
    left, right = look(view, points)
    line = simple.Show(simple.Line(registrationName="substrate", Point1=[left, 0, 0], Point2=[right, 0, 0]), view)
    line.AmbientColor = line.DiffuseColor = [0.4, 0.4, 0.4]
    clock = simple.AnnotateTimeFilter(registrationName="time", Input=points,
                                      Format="t = {time:g} " + unit["v"].rpartition("/")[2])
    clock = simple.Show(clock, view)
    clock.Color, clock.FontSize = DARK, 10
    simple.SetActiveSource(points)
    scene.GoToLast()
    if wanted.picture:
        simple.SaveScreenshot(wanted.picture, view, ImageResolution=[1600, 700])
    else:
        simple.Render(view)


main()
