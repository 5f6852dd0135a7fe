"""Sewing: templates, pages, DXF and cut list are at 1:1, and what is missing is said."""

import csv
import re
import zlib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg

from fabdesign.drawings.pages import (
    NAMES,
    OVERLAP,
    PAPERS,
    blank_figure,
    draw_shapes,
    joints,
    overview_figure,
    page_axes,
    page_figure,
    page_name,
    tiled,
    window,
)
from fabdesign.drawings.sewing import Sewing, export_design, pressures_beside, write_cut_list
from fabdesign.drawings.template import Words, face_drawing, template_sheet, what_it_shows
from fabdesign.errors import InputError, InputNote
from fabdesign.files.pressure_file import constant_program, write_pressures
from fabdesign.formats.csv_table import write_rows
from fabdesign.nouns.catalogue import build, standard
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.pressure import poses_in_words

POINT = 72 / 25.4  # PDF points in a millimetre


def with_type(design: Design, **changes: float) -> Design:
    return replace(design, muscle_types={k: replace(t, **changes) for k, t in design.muscle_types.items()})


def svg_points(element: ET.Element) -> list[list[float]]:
    return [[float(x) for x in point.split(",")] for point in element.attrib["points"].split()]


@pytest.mark.parametrize(("side", "first"), [("front", 250 / 8), ("back", 250 * 7 / 8)])
def test_svg_is_at_one_to_one_and_the_back_is_mirrored(side: str, first: float, tmp_path: Path) -> None:
    design = build("basic", width=0.25)
    export_design(design, tmp_path, Sewing(paper=None, seam_allowance=0.012, tail_length=0.0), stem="d")
    svg = ET.parse(tmp_path / f"d_{side}.svg").getroot()
    page = [float(size) for size in svg.attrib["viewBox"].split()[2:]]
    assert [svg.attrib["width"], svg.attrib["height"]] == [f"{size:g}mm" for size in page]  # 1 unit is 1 mm
    cut, cloth = (svg_points(outline) for outline in svg.findall("{*}polygon"))
    assert cloth == [[0, 0], [250, 0], [250, 200], [0, 200]]
    assert cut == [[-12, -12], [262, -12], [262, 212], [-12, 212]]
    lines = [line for line in svg.findall("{*}polyline") if line.attrib["stroke-width"] == "0.6"]
    assert svg_points(lines[0]) == [[first, 8], [first, 192]]
    mine = [muscle for muscle in design.muscles if muscle.side == side]
    assert len(svg.findall("{*}circle")) == sum(len(muscle.fixed_points()) for muscle in mine)
    assert any(
        ends[0][1] == ends[1][1] and ends[1][0] - ends[0][0] == 100
        for ends in map(svg_points, svg.iter("{http://www.w3.org/2000/svg}polyline"))
    )


def test_without_allowance_the_cloth_is_what_is_cut(tmp_path: Path) -> None:
    export_design(build("side"), tmp_path, Sewing(paper=None, seam_allowance=0.0, tail_length=0.0), stem="d")
    (outline,) = ET.parse(tmp_path / "d_front.svg").getroot().findall("{*}polygon")
    assert svg_points(outline)[2] == [200, 200]
    assert "stroke-dasharray" not in outline.attrib


@given(
    width=st.floats(1, 3000),
    height=st.floats(1, 3000),
    paper=st.sampled_from(sorted(PAPERS)),
)
def test_pages_hold_all_and_share_joint_lines(width: float, height: float, paper: str) -> None:
    tiling = tiled((-10.0, 5.0, width - 10, height + 5), paper)
    boxes = {place: tiling.box_of(*place) for place in tiling.pages()}
    assert sorted(tiling.page) == sorted(PAPERS[paper])
    assert min(box[0] for box in boxes.values()) <= -10 + 1e-9
    assert min(box[1] for box in boxes.values()) <= 5 + 1e-9
    assert max(box[2] for box in boxes.values()) >= width - 10 - 1e-9
    assert max(box[3] for box in boxes.values()) >= height + 5 - 1e-9
    for (row, column), box in boxes.items():
        assert (box[2] - box[0], box[3] - box[1]) == pytest.approx(window(tiling.page))
        if (right := boxes.get((row, column + 1))) is not None:
            assert box[2] - right[0] == pytest.approx(OVERLAP)
        if (below := boxes.get((row + 1, column))) is not None:
            assert box[3] - below[1] == pytest.approx(OVERLAP)
    if tiling.columns > 1:  # not one page more than needed
        assert (tiling.columns - 1) * (window(tiling.page)[0] - OVERLAP) + OVERLAP < width


def test_neighbours_show_the_same_registration_marks() -> None:
    tiling = tiled((0.0, 0.0, 400.0, 450.0), "a4")

    def circles(row: int, column: int) -> set[tuple[float, float]]:
        inside, _ = joints(tiling, row, column)
        return {(round(s.centre[0], 6), round(s.centre[1], 6)) for s in inside if hasattr(s, "centre")}

    for row, column in tiling.pages():
        if column + 1 < tiling.columns:
            assert len(circles(row, column) & circles(row, column + 1)) == 2
        if row + 1 < tiling.rows:
            assert len(circles(row, column) & circles(row + 1, column)) == 2


def test_names_of_pages() -> None:
    assert [page_name(row, 0) for row in (0, 25, 26)] == ["A1", "Z1", "AA1"]


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_pdf_pages_are_at_one_to_one(paper: str, tmp_path: Path) -> None:
    made = export_design(build("cross"), tmp_path, Sewing(paper=paper, tail_length=0.02), stem="d")
    assert tmp_path / f"d_{paper}.pdf" in made.files
    content = (tmp_path / f"d_{paper}.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", content)
    assert len(boxes) == 3  # an overview, and 220 mm of cloth and seam on two pages
    for box in boxes:
        assert [float(x) / POINT for x in box] == pytest.approx(PAPERS[paper], abs=0.01)
    pages = [
        zlib.decompress(stream).decode("latin-1")
        for stream in re.findall(rb"/Filter /FlateDecode[^>]*>>\s*stream\r?\n(.*?)\r?\nendstream", content, re.DOTALL)
        if b" l\n" in zlib.decompress(stream)
    ]
    drawn = pages[-2:]
    for page in drawn:
        lines = [
            [float(x) / POINT for x in ends]
            for ends in re.findall(r"([-\d.]+) ([-\d.]+) m\n([-\d.]+) ([-\d.]+) l\n", page)
        ]
        assert any(a[1] == b and x - a[0] == pytest.approx(100, abs=1e-3) for *a, x, b in lines)  # the bar
        heights = [float(y) / POINT for y in _cut_line(page)[1::2]]
        assert max(heights) - min(heights) == pytest.approx(220, abs=1e-3)  # of cloth with its seam
    left = min(float(x) / POINT for x in _cut_line(drawn[0])[::2])
    right = max(float(x) / POINT for x in _cut_line(drawn[1])[::2])
    # the right half lies one window less the overlap further on
    assert right + window(PAPERS[paper])[0] - OVERLAP - left == pytest.approx(220, abs=1e-3)


def _cut_line(page: str) -> list[str]:
    """x, y, x, y, ... of the first path that is stroked: the line to cut, as far as the page reaches."""
    path = page[page.index("\nf\n") : page.index("\nS\n")]  # after the paper's white
    return [x for point in re.findall(r"([-\d.]+) ([-\d.]+) [ml]\n", path) for x in point]


def test_pages_are_limited(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"pages of A4 for a cloth of 10 x 10 m; expected at most 200, or --paper none"
    ):
        export_design(build("basic", width=10, height=10), tmp_path / "out", Sewing(tail_length=0.0), stem="d")
    assert not (tmp_path / "out").exists()
    assert set(NAMES) == set(PAPERS)


def test_dxf_layers(tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    export_design(build("cross"), tmp_path, Sewing(paper=None, tail_length=0.0), stem="d")
    space = ezdxf.readfile(tmp_path / "d.dxf").modelspace()
    outlines = {
        line.dxf.layer: [p[:2] for p in line.get_points()] for line in space.query("LWPOLYLINE[layer!='FRONT']")
    }
    assert outlines["CLOTH"] == [(0, 0), (200, 0), (200, -200), (0, -200)]
    assert outlines["CUT"] == [(-10, 10), (210, 10), (210, -210), (-10, -210)]


def test_a_missing_dxf_extra_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fabdesign.drawings.sewing.find_spec", lambda name: None)
    with pytest.warns(InputNote, match="no DXF"):
        made = export_design(build("cross"), tmp_path, Sewing(paper=None, tail_length=0.0), stem="d")
    assert made.left_out == ("no DXF: pip install 'fabdesign[dxf]'",)
    assert not (tmp_path / "d.dxf").exists()


def test_cut_list_has_tails(tmp_path: Path) -> None:
    design = with_type(build("cross"), tail_length=0.05, stock_length=0.4)
    export_design(design, tmp_path, Sewing(paper=None), stem="d")
    rows = (tmp_path / "d_cut_list.csv").read_text().splitlines()
    assert rows[1] == "0,EM20,front,0,240.4,50.0,340.4,13"  # 170 mm sqrt(2), and a tail at each end
    export_design(design, tmp_path / "asked", Sewing(paper=None, tail_length=0.03), stem="d")
    assert "240.4,30.0,300.4" in (tmp_path / "asked" / "d_cut_list.csv").read_text()


def test_a_name_is_no_formula_in_a_cut_list(tmp_path: Path) -> None:
    for k, name in enumerate(('=HYPERLINK("x")', "+1+1", "-2-3", "@SUM(A1)", " =1+1")):
        kind = replace(build("cross").muscle_types["EM20"], name=name, tail_length=0.05)
        muscles = tuple(replace(muscle, type=name) for muscle in build("cross").muscles)
        design = replace(build("cross"), muscle_types={name: kind}, muscles=muscles)
        write_cut_list(design, tmp_path / f"{k}.csv")
        rows = [*csv.reader((tmp_path / f"{k}.csv").open())]
        assert {row[1] for row in rows[1:]} == {f"'{name}"}
    write_rows(tmp_path / "n.csv", ["a"], [["-1.5"], ["+2e3"], [-3.0], ["-inf"]])
    assert (tmp_path / "n.csv").read_text().split() == ["a", "-1.5", "+2e3", "-3.0", "-inf"]


def test_no_cut_list_without_tails(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"EM20 has no tail_length.*expected --tail-length, in m"):
        export_design(build("cross"), tmp_path / "out", stem="d")
    assert not (tmp_path / "out").exists()
    export_design(standard(), tmp_path, Sewing(paper=None), stem="d")  # no muscles, no tails


def test_muscle_longer_than_its_stock(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"muscle 0 needs 340.4 mm; expected at most its stock, 300 mm of EM20"):
        export_design(with_type(build("cross"), stock_length=0.3), tmp_path / "out", Sewing(tail_length=0.05), stem="d")
    assert not (tmp_path / "out").exists()


def test_a_side_without_muscles_is_not_written(tmp_path: Path) -> None:
    made = export_design(build("vertical"), tmp_path, Sewing(paper=None, tail_length=0.0), stem="d")
    assert not (tmp_path / "d_back.svg").exists() and tmp_path / "d_front.svg" in made.files


def test_a_small_wide_cloth_fits_one_page_on_its_side() -> None:
    face = face_drawing(build("cross", width=0.24, height=0.15), "front", seam_allowance=0.01)
    tiling = tiled(face.box, "a4")
    assert (tiling.rows, tiling.columns, tiling.page) == (1, 1, PAPERS["a4"][::-1])


@pytest.mark.parametrize(("width", "height"), [(0.15, 0.25), (0.25, 0.15)])
def test_a_cloth_that_fits_the_paper_with_its_seam_is_one_page(width: float, height: float) -> None:
    face = face_drawing(build("cross", width=width, height=height), "front", seam_allowance=0.01)
    tiling = tiled(face.box, "a4")
    assert (tiling.rows, tiling.columns) == (1, 1)


@pytest.mark.parametrize("size", [(0.15, 0.25), (0.24, 0.15), (0.3, 0.3), (0.05, 0.2)])
def test_no_words_of_a_page_or_a_template_come_near_its_edge(size: tuple[float, float]) -> None:
    """All words of pages stand 4 mm inside the paper, those of a template on one sheet 10 mm inside the sheet."""
    design = build("cross", width=size[0], height=size[1], name="a layout with a name as long as people give them")
    face = face_drawing(design, "front", seam_allowance=0.01)
    tiling, words = tiled(face.box, "a4"), (f"{design.name}, front face: page A2", what_it_shows(design, "back", 0.01))
    sheet = template_sheet(design, "back", seam_allowance=0.01)
    left, top, right, bottom = sheet.box
    paper = right - left, bottom - top
    one = blank_figure(paper)
    draw_shapes(page_axes(one, paper, (0, 0, *paper), sheet.box), sheet.shapes)
    pages = [
        # but for the window onto the drawing, whose words a page may cut
        (page_figure(face, tiling, *place, (*words, "print at 100 % on A4; sheet 12 of 13")).axes[1:], tiling.page, 3.9)
        for place in tiling.pages()
    ]
    pages.append((overview_figure(design, [("front", face, tiling)], "a4", 3).axes, PAPERS["a4"], 3.9))
    for windows, page, room in [*pages, (one.axes, paper, 10.0)]:
        figure = windows[0].figure
        figure.set_dpi(100)
        for text in (text for axes in windows for text in axes.texts):
            box = text.get_window_extent(FigureCanvasAgg(figure).get_renderer())
            low, high = np.array(box.get_points()) * 25.4 / 100
            assert (low >= room - 0.5).all() and (high <= np.array(page) - room + 0.5).all(), text.get_text()


@pytest.mark.parametrize("side", ["front", "back"])
def test_a_template_names_the_coordinates_of_ends_and_corners(side: str) -> None:
    path = ((0.02, 0.01), (0.02, 0.1), (0.0305, 0.15))
    design = replace(build("vertical"), muscles=(Muscle("EM20", side, 0, path, 0.02),))
    words = [s.text for s in face_drawing(design, side, seam_allowance=0.01).shapes if isinstance(s, Words)]
    assert [*words[-3:]] == ["0 (channel 0): (20, 10)", "0 (channel 0): (30.5, 150)", "(20, 100)"]


def test_a_results_pressures_are_exported_with_it(tmp_path: Path) -> None:
    design, folder = build("vertical", muscles=2), tmp_path / "result"
    folder.mkdir()
    (folder / "design.toml").touch()
    for name in ("pressures.csv", "pressures_2.csv"):
        write_pressures(constant_program([3e5, 1e5]), folder / name)
    assert pressures_beside(folder / "design.toml") == []  # of another program, until a search wrote a result
    (folder / "result.json").touch()
    files = pressures_beside(folder / "design.toml")
    assert [file.name for file in files] == ["pressures.csv", "pressures_2.csv"]
    made = export_design(design, tmp_path / "out", Sewing(paper=None, tail_length=0.0), stem="d", pressures=files)
    assert (tmp_path / "out" / "d_pressures_2.csv").read_text() == files[1].read_text()
    assert poses_in_words(made.pressures)[1] == "pressures of pose 2: channel 0: 300 kPa, channel 1: 100 kPa"
    with pytest.raises(InputError, match="expected 3 channels"):
        export_design(build("vertical"), tmp_path / "other", Sewing(tail_length=0.0), stem="d", pressures=files)
    assert not (tmp_path / "other").exists()
