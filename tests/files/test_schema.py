"""Files as dataclasses: a kind of file takes one declaration, and schemas and tables in the docs come from the same."""

import json
import re
import runpy
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import pytest
import tomlkit

from fabdesign import interface
from fabdesign.errors import InputError
from fabdesign.formats.codec import Encoder, decode
from fabdesign.formats.schema import FileUnit, Key, Kilopascal, Millimetre, Within, json_schema
from fabdesign.formats.table import Table, load_toml
from studies.check.design import STUDIES
from studies.check.files import KINDS, schema_of
from tests.command_line import Run, one_line
from tests.conftest import ROOT

jsonschema = pytest.importorskip("jsonschema")


@dataclass(frozen=True)
class Bulb:
    """A part of a lamp."""

    colour: Annotated[Literal["white", "amber"], "of its light"] = "white"
    hours: Annotated[int | None, Within(least=1), "that it lasts; absent: not known"] = None


@dataclass(frozen=True)
class Lamp:
    """A light beside the cloth, the kind of file that CONTRIBUTING.md declares, with more that a key can be."""

    name: Annotated[str, "of its socket"]
    at: Annotated[tuple[float, float, float], FileUnit("m"), "in the world"]
    power: Annotated[float, FileUnit("W"), Within(above=0, most=500), "of the bulb"] = 40.0
    gap: Annotated[Millimetre, Key("shade.gap", also="shade_gap")] = 0.002  # m
    gas: Kilopascal | None = None  # Pa
    glow: Annotated[Kilopascal, Within(above=0)] | Literal["none"] = "none"
    bulbs: tuple[Bulb, ...] = ()
    prices: Annotated[Mapping[str, float], Within(least=0)] = field(default_factory=dict)

    def resolved(self, table: Table) -> "Lamp":
        if len(self.bulbs) > 1 and self.power < 20:
            raise table.bad("power", "20 W or more for two bulbs")
        return self


TEXT = """format = "fabdesign.lamp/1"
name = "left"
at = [0.1, 0.0, 1]
power = 60
gas = 101.3
glow = 2
[shade]
gap = 3
[[bulbs]]
[[bulbs]]
colour = "amber"
hours = 1000
[prices]
shop = 2.5
"""
LAMP = Lamp("left", (0.1, 0.0, 1.0), 60.0, 0.003, 101.3e3, 2e3, (Bulb(), Bulb("amber", 1000)), {"shop": 2.5})


def read(path: Path, text: str) -> Lamp:
    (path / "lamp.toml").write_text(text)
    return decode(Lamp, load_toml(path / "lamp.toml", "fabdesign.lamp/1"))


def test_a_kind_of_file_takes_one_declaration(tmp_path: Path) -> None:
    assert read(tmp_path, TEXT) == LAMP
    written = tomlkit.dumps({"format": "fabdesign.lamp/1"} | Encoder(tmp_path / "l.toml").encode(LAMP))
    assert read(tmp_path, written) == LAMP
    jsonschema.validate(tomllib.loads(written), json_schema("lamp", (Lamp,)))
    assert decode(Lamp, Table({"name": "left", "at": (0.1, 0, 1), "bulbs": [Bulb()]}, "lamp")).bulbs == (Bulb(),)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('name = "left"', "", "lamp.toml: name is missing"),
        ('name = "left"', 'nam = "left"', "lamp.toml: name is missing (is nam meant?)"),
        ("power = 60", "powr = 60", "lamp.toml: unknown key powr (did you mean power?)"),
        ("power = 60", "power = 0", "lamp.toml: power = 0; expected a number above 0 to 500"),
        ("power = 60", "power = nan", "lamp.toml: power = NaN; expected a number above 0 to 500"),
        ("power = 60", "power = true", "lamp.toml: power = true; expected a number above 0 to 500"),
        ("power = 60", "power = 10", "lamp.toml: power = 10; expected 20 W or more for two bulbs"),
        ("[0.1, 0.0, 1]", "[0.1, 0.0]", "lamp.toml: at = [0.1, 0.0]; expected a list of 3 numbers"),
        ("[0.1, 0.0, 1]", '[0.1, 0.0, "1"]', 'lamp.toml: at = [0.1, 0.0, "1"]; expected a list of 3 numbers'),
        ("gap = 3", 'gap = "3"', 'lamp.toml: shade: gap = "3"; expected a number'),
        ("gap = 3", "gab = 3", "lamp.toml: shade: unknown key gab (did you mean gap?)"),
        ("[shade]", "[[shade]]", "lamp.toml: shade = [{gap = 3}]; expected a table"),
        ("hours = 1000", "hours = 0.5", "lamp.toml: bulbs[1]: hours = 0.5; expected a whole number from 1"),
        ('"amber"', '"ambre"', 'bulbs[1]: colour = "ambre"; expected one of white, amber (did you mean amber?)'),
        ("[[bulbs]]\n[[bulbs]]", "[bulbs]", "expected [[bulbs]] tables"),
        ("shop = 2.5", "shop = -1", "lamp.toml: prices: shop = -1; expected a number from 0"),
        ("lamp/1", "lamp/2", 'format is "fabdesign.lamp/2"; this version reads "fabdesign.lamp/1"'),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(old: str, new: str, problem: str, tmp_path: Path) -> None:
    assert old in TEXT
    with pytest.raises(InputError, match=re.escape(problem) + "$") as caught:
        read(tmp_path, TEXT.replace(old, new))
    assert "\n" not in str(caught.value)


def test_an_older_name_of_a_key_is_read(tmp_path: Path) -> None:
    text = TEXT.replace("[shade]\ngap = 3\n", "[shade]\nshade_gap = 3\n")
    assert read(tmp_path, text) == LAMP


FILES = sorted(file for room in ("fabdesign/data", "examples") for file in (ROOT / room).rglob("*.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.relative_to(ROOT).as_posix())
def test_shipped_files_fit_their_schema(file: Path) -> None:
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    form = content.get("format", "fabdesign.study/1" if "kind" in content else "fabdesign.design/1")
    kind = re.fullmatch(r"fabdesign\.(.+)/1", form)
    assert kind is not None
    schema = schema_of(kind[1])
    jsonschema.Draft7Validator.check_schema(schema)
    jsonschema.validate(content, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**content, "no such key": [None]}, schema)


@pytest.mark.parametrize("kind", KINDS)
def test_the_command_prints_the_schema(kind: str, run: Run) -> None:
    code, out, err = run("schema", kind)
    assert (code, err) == (0, "")
    assert json.loads(out) == json.loads(json.dumps(schema_of(kind)))


def test_defaults_are_in_the_unit_of_the_file(run: Run) -> None:
    limits = json.loads(run("schema", "measurement-set")[1])["properties"]["rig_limits"]["properties"]
    assert "kPa" in limits["pressure"]["description"]
    assert (limits["pressure"]["default"], limits["resolution"]["default"]) == (300.0, 0.1)


def test_help_lists_the_kinds() -> None:
    assert {*KINDS} - {*re.findall(r"[a-z-]+", str(interface.schema.__doc__))} == set()
    assert {*STUDIES} - {*re.findall(r"[a-z]+", str(interface.study.__doc__))} == set()


def test_an_unknown_kind_is_refused_in_a_line(run: Run) -> None:
    one_line(
        run("schema", "studie"),
        "expected one of design, model, study",
    )


def test_examples_in_the_docs_fit_their_schema() -> None:
    page = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    contents = [tomllib.loads(text) for text in re.findall(r"(?m)^```toml\n(.*?)^```", page, re.DOTALL)]
    studies = [content for content in contents if "kind" in content]
    assert {study["kind"] for study in studies} == {*STUDIES}
    for study in studies:
        required = {"design": "d.toml", "target": {"file": "t.ply"}} if study["kind"] in ("layouts", "loop") else {}
        jsonschema.validate(required | study, schema_of("study"))


def test_tables_in_the_docs_are_current() -> None:
    tables = runpy.run_path(str(ROOT / "scripts" / "reference.py"))
    pages = [page.read_text(encoding="utf-8") for page in tables["PAGES"]]
    assert [tables["with_tables"](page) for page in pages] == pages, "run scripts/reference.py"
    listed = set(re.findall("<!-- keys: ([a-z -]+) -->", "".join(pages)))
    assert listed == ({*KINDS} - {"study"}) | {f"study {kind}" for kind in STUDIES}
