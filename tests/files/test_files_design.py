"""Designs: what is written is what is read, the catalogue, and every kind of bad input."""

import math
from functools import partial
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design, read_part, write_design
from fabdesign.files.law_tables import MembraneCurve
from fabdesign.nouns.catalogue import LAYOUTS, build, standard
from fabdesign.nouns.design import Design, Term
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.muscle import BenchTable, Muscle, MuscleType

floats = partial(st.floats, allow_subnormal=False)  # the simulator's kernels flush those to zero
ROUND_TRIPS = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)

positive = floats(1e-6, 9.9)
names = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=12)


def rising(n: int) -> st.SearchStrategy[tuple[float, ...]]:
    return st.lists(floats(-0.5, 5.0), min_size=n, max_size=n, unique=True).map(lambda x: tuple(sorted(x)))


@st.composite
def curves(draw: st.DrawFn) -> MembraneCurve | None:
    if draw(st.booleans()):
        return None
    lengths = draw(st.tuples(st.sampled_from([0, 2, 5]), st.sampled_from([2, 4])))
    strain, tension = ((draw(rising(lengths[0])), draw(rising(lengths[1]))) for _ in range(2))
    return MembraneCurve(strain, tension)


@st.composite
def benches(draw: st.DrawFn) -> BenchTable:
    pressure = [*draw(st.lists(floats(0, 9e5), min_size=1, max_size=2, unique=True)), 9.5e5]
    contraction = draw(st.lists(floats(-0.1, 0.5), min_size=2, max_size=3, unique=True))
    rows = [(p, c, draw(floats(-10, 100))) for p in pressure for c in contraction]
    return BenchTable(*map(tuple, zip(*rows, strict=True)))


@st.composite
def designs(draw: st.DrawFn) -> Design:
    width, height = draw(positive), draw(positive)
    points = st.tuples(floats(0, width), floats(0, height))
    k1, k2 = draw(floats(1, 1e4)), draw(floats(1, 1e4))
    optional = st.none() | positive
    fabric = Fabric(
        width=width,
        height=height,
        thickness=draw(positive),
        areal_density=draw(positive),
        membrane_stiffness=(k1, k2),
        shear_stiffness=draw(positive),
        poisson=draw(floats(0, 0.99)) * math.sqrt(k1 / k2),
        bending_stiffness=(draw(positive), draw(positive)),
        twist_stiffness=draw(optional),
        viscosity=draw(positive),
        air_damping=draw(positive),
        support=draw(st.sampled_from(["pinned", "clamped"])),
        hung=draw(st.sampled_from(["top", "left", "none"]) | st.lists(points, min_size=1, max_size=3).map(tuple)),
        gravity=draw(st.tuples(*[floats(-20, 20)] * 3)),
        membrane_curve=draw(curves()),
    )
    types = {
        name: MuscleType(
            name=name,
            outer_diameter=draw(positive),
            mass_per_length=draw(positive),
            axis_offset=draw(positive),
            bench=draw(benches()),
            viscosity=draw(positive),
            max_pressure=draw(st.none() | floats(1, 1e6)),
            stock_length=draw(optional),
            min_bend_radius=draw(optional),
            tail_length=draw(optional),
        )
        for name in draw(st.lists(names, max_size=2, unique=True))
    }
    muscles = [
        Muscle(
            type=draw(st.sampled_from(sorted(types))),
            side=draw(st.sampled_from(["front", "back"])),
            channel=draw(st.integers(0, 9)),
            path=tuple(draw(st.lists(points, min_size=2, max_size=4, unique=True))),
            fixed_point_pitch=draw(st.floats(0.001, 10)),
        )
        for _ in range(draw(st.integers(0, 3)) if types else 0)
    ]
    effects = [Term("muscle_creep", {"share": draw(floats(0, 0.8))}, f"muscle_types.{name}") for name in types]
    return Design(draw(names), fabric, types, tuple(muscles), tuple(draw(st.sampled_from([effects, []]))))


@ROUND_TRIPS
@given(design=designs())
def test_written_design_reads_the_same(design: Design, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("design") / "d.toml"
    write_design(design, path)
    assert read_design(path) == design


def test_what_a_bench_found_comes_with_its_type(tmp_path: Path) -> None:
    write_design(build("cross"), tmp_path / "whole.toml")
    head, rest = (tmp_path / "whole.toml").read_text().split("[muscle_types.", 1)
    kind, muscles = rest.split("[[muscles]]", 1)
    creep = '[[effects]]\nname = "muscle_creep"\n{scope}[effects.parameters.share]\nvalue = 0.2\nunit = "1"\n'
    (tmp_path / "type.toml").write_text(f"[muscle_types.{kind}{creep.format(scope='')}")
    (tmp_path / "d.toml").write_text(f'include = ["type.toml"]\n{head}[[muscles]]{muscles}')
    name = kind.partition("]")[0]
    assert read_design(tmp_path / "d.toml").effects == (Term("muscle_creep", {"share": 0.2}, f"muscle_types.{name}"),)
    assert read_part(tmp_path / "type.toml").types.keys() == {name}
    for text, problem in (
        (
            creep.format(scope='scope = "muscle_types.none"\n'),
            f"scope is muscle_types.none; expected muscle_types.{name}",
        ),
        (creep.format(scope="") * 2, f"muscle_creep of muscle_types.{name} is there already"),
        ('[[effects]]\nname = "filling_lag"', "filling_lag belongs to the rig; expected it in a model"),
    ):
        (tmp_path / "type.toml").write_text(f"[muscle_types.{kind}{text}")
        with pytest.raises(InputError, match=problem):
            read_design(tmp_path / "d.toml")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_catalogue_is_the_measured_layout(layout: str, data: Path) -> None:
    assert build(layout) == read_design(data / "rig_a" / f"{layout}.toml")


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("muscles", [2, 4, 10])
def test_catalogue_fits_any_cloth(layout: str, muscles: int) -> None:
    design = build(layout, width=0.37, height=0.11, muscles=muscles)
    assert [m.channel for m in design.muscles] == list(range(muscles))
    assert all(0 < u < 0.37 and 0 < v < 0.11 for m in design.muscles for u, v in m.path)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"layout": "basik"}, "did you mean basic"),
        ({"layout": "basic", "muscles": 0}, "1 to 256"),
        ({"layout": "cross", "muscles": 3}, "even"),
        ({"layout": "basic", "muscles": 250}, "1.600 mm apart.*2.000 mm"),
        ({"layout": "basic", "width": 200.0}, "10 m"),
        ({"layout": "basic", "width": 0.0}, "10 m"),
    ],
)
def test_catalogue_refuses(arguments: dict, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        build(**arguments)


def test_two_types_of_one_name_keep_their_tables(tmp_path: Path) -> None:
    first = build("cross")
    other = BenchTable((0.0, 1e5), (0.0, 0.1), (1.0, 2.0))
    kind = first.muscle_types["EM20"]
    second = build("basic", muscle_type=MuscleType("EM20", kind.outer_diameter, 0.004, 0.001, other))
    write_design(first, tmp_path / "first.toml")
    write_design(second, tmp_path / "second.toml")
    assert read_design(tmp_path / "first.toml") == first
    assert read_design(tmp_path / "second.toml") == second


def test_included_type_and_fabric(tmp_path: Path) -> None:
    write_design(build("cross"), tmp_path / "whole.toml")
    text = (tmp_path / "whole.toml").read_text()
    head, rest = text.split("[fabric]")
    fabric, rest = rest.split("[muscle_types.EM20]")
    kind, muscles = rest.split("[[muscles]]", 1)
    folder = tmp_path / "parts"
    folder.mkdir()
    (folder / "cloth.toml").write_text("[fabric]" + fabric)
    (folder / "type.toml").write_text("[muscle_types.EM20]" + kind)
    (tmp_path / "em20_bench.csv").rename(folder / "em20_bench.csv")
    parts = head + 'include = ["parts/cloth.toml", "parts/type.toml"]\n[[muscles]]' + muscles
    (tmp_path / "parted.toml").write_text(parts)
    assert read_design(tmp_path / "parted.toml") == build("cross")


def test_scene_may_stand_at_top_level(tmp_path: Path) -> None:
    write_design(standard(), tmp_path / "d.toml")
    text = (tmp_path / "d.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("support", "hung", "gravity"))]
    scene = ['support = "clamped"', "hung = [[0.0, 0.0], [0.2, 0.0]]", "gravity = [0, 0, -9.81]"]
    (tmp_path / "d.toml").write_text("\n".join([*lines[:2], *scene, *lines[2:]]))
    fabric = read_design(tmp_path / "d.toml").fabric
    assert (fabric.support, fabric.hung, fabric.gravity[2]) == ("clamped", ((0, 0), (0.2, 0)), -9.81)


def test_curve_gives_the_stiffness_that_is_missing(tmp_path: Path) -> None:
    write_design(standard(), tmp_path / "d.toml")
    text = (tmp_path / "d.toml").read_text()
    text = text.replace("membrane_stiffness = [520.0, 520.0]", 'membrane_curve = "c.csv"')
    (tmp_path / "d.toml").write_text(text)
    (tmp_path / "c.csv").write_text("strain,tension_n_per_m,direction\n0,0,both\n0.01,3,both\n0.1,90,both\n")
    fabric = read_design(tmp_path / "d.toml").fabric
    assert fabric.membrane_stiffness == pytest.approx((300.0, 300.0))  # 3 N/m at a strain of 0.01
    assert fabric.membrane_curve is not None
    assert fabric.membrane_curve.tension == ((0, 3, 90), (0, 3, 90))


BAD = [
    ('format = "fabdesign.design/1"', 'format = "fabdesign.design/2"', "fabdesign.design/2"),
    ('format = "fabdesign.design/1"', "", "no format line"),
    ("width = 0.2", "width = 200.0", "millimetres"),
    ("width = 0.2", "width = nan", "above 0"),
    ("width = 0.2", "width = '0.2'", "a number above 0"),
    ("width = 0.2", "", "width is missing"),
    ("thickness", "thicknes", "is thicknes meant"),
    ("viscosity = 6.0", "viscosty = 6.0", "did you mean viscosity"),
    ("poisson = 0.25", "poisson = 1.5", "nu_12"),
    ('support = "pinned"', 'support = "glued"', "pinned, clamped"),
    ('hung = "top"', "hung = [[0.0, 0.3]]", "outside the cloth"),
    ('bench = "em20_bench.csv"', 'bench = "none.csv"', "no such file"),
    ("[[0.015, 0.015], [0.185, 0.185]]", "[[0.015, 0.015], [0.185, 0.285]]", r"path\[1\]: v = 0.285 m lies outside"),
    ("[[0.015, 0.015], [0.185, 0.185]]", "[[15.0, 15.0], [185.0, 185.0]]", "millimetres"),
    ("[[0.015, 0.015], [0.185, 0.185]]", "[[0.015, 0.015]]", "at least two"),
    ("[[0.015, 0.015], [0.185, 0.185]]", "[[0.015, 0.015], [0.015, 0.015]]", "repeats"),
    ("[[0.015, 0.015], [0.185, 0.185]]", "[0.015, 0.015]", "points"),
    ('type = "EM20"', 'type = "EM2"', "did you mean EM20"),
    ('side = "front"', 'side = "top"', "front, back"),
    ("channel = 0", "channel = -1", "from 0"),
    ("channel = 0", "channel = true", "whole number"),
    ("fixed_point_pitch = 0.02", "fixed_point_pitch = 0", "from 0.001"),
    ("[fabric]", "[fabric", "sound TOML"),
    ("[fabric]", "include = ['d.toml']\n[fabric]", "comes back"),
    ("[fabric]", "gravity = [0, 0, 0]\n[fabric]", "top level"),
]


@pytest.mark.parametrize(("old", "new", "problem"), BAD, ids=[f"{i}-{row[2]}" for i, row in enumerate(BAD)])
def test_bad_design_is_one_line(old: str, new: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    write_design(build("cross"), path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=problem) as caught:
        read_design(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value) or "none.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "is empty"),
        ("pressure_kpa,contraction,force_n\n", "no rows"),
        ("pressure,contraction,force_n\n0,0,0\n", "expected pressure_kpa"),
        ("pressure_kpa,contraction,force_n\n0,0\n", "line 2: 2 values"),
        ("pressure_kpa,contraction,force_n\n0,0,one\n", "force_n = 'one'"),
        ("pressure_kpa,contraction,force_n\n0,0,nan\n", "finite"),
        ("pressure_kpa,contraction,force_n\n-1,0,0\n", "from 0"),
        ("pressure_kpa,contraction,force_n\n0,12,0\n", "no percentage"),
        ("pressure_kpa,contraction,force_n\n0,0,1\n0,0.1,0\n", "one value only"),
    ],
)
def test_bad_bench_table_is_one_line(text: str, problem: str, tmp_path: Path) -> None:
    write_design(build("cross"), tmp_path / "d.toml")
    (tmp_path / "em20_bench.csv").write_text(text)
    with pytest.raises(InputError, match=problem):
        read_design(tmp_path / "d.toml")
