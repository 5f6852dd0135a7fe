"""docs/opened_in_paraview.png: the last instant of a series that `fabdesign view MOTION -o SERIES.pvd` wrote.
In ParaView's own Python, without a screen:

xvfb-run -a pvpython scripts/paraview_picture.py SERIES.pvd PICTURE.png
"""

import sys

from paraview import simple


def coloured(source, view, association, name, title):
    """Show a source, coloured by one of its arrays over that array's range, with a bar."""
    source.UpdatePipeline(view.ViewTime)
    shown = simple.Show(source, view)
    simple.ColorBy(shown, (association, name))
    data = source.PointData if association == "POINTS" else source.CellData
    colours = simple.GetColorTransferFunction(name)
    colours.RescaleTransferFunction(*data[name].GetRange())
    bar = simple.GetScalarBar(colours, view)
    bar.Title, bar.ComponentTitle = title, ""
    bar.TitleColor = bar.LabelColor = (0.1, 0.1, 0.1)
    bar.ScalarBarLength = 0.3
    bar.WindowLocation = "Any Location"
    bar.Visibility = 1
    return bar


def main(series, picture):
    reader = simple.PVDReader(FileName=series)
    reader.UpdatePipeline()
    view = simple.CreateView("RenderView")
    view.ViewSize = (1000, 760)
    view.UseColorPaletteForBackground = 0
    view.Background = (1, 1, 1)
    view.OrientationAxesLabelColor = (0.1, 0.1, 0.1)
    view.ViewTime = reader.TimestepValues[-1]
    cloth = simple.ExtractBlock(Input=reader, Selectors=["/Root/cloth"])
    muscles = simple.ExtractBlock(Input=reader, Selectors=["/Root/muscles"])
    tubes = simple.Tube(Input=simple.ExtractSurface(Input=muscles), Scalars=["POINTS", "radius"])
    tubes.VaryRadius = "By Absolute Scalar"
    coloured(cloth, view, "POINTS", "strain_down", "strain down the cloth").Position = (0.82, 0.55)
    coloured(tubes, view, "CELLS", "tension_N", "tension, N").Position = (0.82, 0.12)
    simple.ResetCamera(view)
    camera = view.GetActiveCamera()
    camera.Azimuth(-25)
    camera.Elevation(10)
    camera.Dolly(1.1)
    simple.SaveScreenshot(picture, view)


if __name__ == "__main__":
    main(*sys.argv[1:])
