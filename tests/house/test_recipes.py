"""Recipes of CONTRIBUTING.md: what is declared there runs as it stands."""

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.muscle_law import law_of
from optimize.search import objective as objective_room
from optimize.search.objective import MEASURES, Objective, Target
from studies.benches.evaluate import errors_of
from studies.benches.muscle import BenchMuscle
from studies.benches.records import LAWS
from studies.benches.tracing import examine
from studies.check.design import STUDIES
from studies.check.files import schema_of
from studies.report.page import html_of
from tests.analytic_cloth import AnalyticCloth
from tests.conftest import ROOT


def declared(heading: str, imports: str = "", names: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The names that the Python of a section declares, where these imports and names are known."""
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = re.split(r"(?m)^## ", page.split(f"\n## {heading}\n")[1])[0]
    module = ModuleType(f"recipe_{heading.replace(' ', '_')}")
    sys.modules[module.__name__] = module  # where dataclasses look for their types
    vars(module).update(names or {})
    exec(f"{imports}\n" + "\n".join(re.findall(r"(?ms)^```python\n(.*?)^```", section)), vars(module))
    return vars(module)


def test_a_muscle_law_is_a_formula_and_its_name() -> None:
    """A braid is found again in a noisy sweep, better than without its formula, and goes to a design as a table."""
    imports = "from dataclasses import replace\nimport numpy as np\nfrom studies.benches.muscle import *"
    law = declared("Add a muscle law", imports)["BraidedMuscle"]
    rng, time = np.random.default_rng(0), np.arange(0, 20, 0.05)
    eps = 0.1 - 0.12 * np.cos(np.pi * time)
    pressure = 50e3 * (np.floor(time / 20 * 18) % 9)

    def braid(p: Any, e: Any) -> Any:
        return p * (2.2e-4 * (1 - e) ** 2 - 1.4e-4) - 30 * e

    force = braid(pressure, eps) - 3 * np.gradient(eps, time) + 0.3 * rng.standard_normal(len(time))
    columns = {"time": time, "pressure": pressure, "contraction": eps, "force": force}
    muscle = law.fit([BenchRecord("sweep", columns, {})])
    p, e = np.meshgrid([0.0, 120e3, 380e3], np.linspace(-0.01, 0.2, 9))
    plain = BenchMuscle.fit([BenchRecord("sweep", columns, {})])
    errors = [np.abs(one.tension(p, e) - braid(p, e)).max() for one in (muscle.law, law_of(muscle.table()), plain.law)]
    assert max(errors[:2]) < 0.1 < 0.2 < errors[2], errors  # N
    assert muscle.viscosity == pytest.approx(3, rel=0.05)


def test_a_specimen_is_a_law_and_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring is fitted, its errors are known, and a trace looks beside its law."""
    imports = "from dataclasses import dataclass\nfrom typing import *\nfrom studies.benches.law import *"
    monkeypatch.setitem(LAWS, "spring", declared("Add a specimen", imports)["SpringLaw"])
    rng, time = np.random.default_rng(0), np.linspace(0, 20, 400)

    def bench(damping: float) -> Bench:
        x = 0.01 * np.sin(time)
        force = 300 * x + damping * 0.01 * np.cos(time)
        columns = [
            {"time": time, "displacement": x, "force": force + 1e-3 * rng.standard_normal(400)} for _ in range(3)
        ]
        records = tuple(BenchRecord(f"r{k}", one, {}) for k, one in enumerate(columns))
        return Bench("made", "spring", ("displacement",), "force", {}, records)

    plain = bench(0.0)
    law = LAWS["spring"].fit(plain.records)
    assert law.stiffness == pytest.approx(300, rel=1e-3)
    assert errors_of(law.written(sized=False), plain, plain.records)[0].after == pytest.approx(1e-3, rel=0.1)
    assert examine(plain, 0.02).verdict == "adequate"
    damped = examine(bench(30.0), 0.02)
    assert damped.verdict == "effect" and [effect.name for effect in damped.effects] == ["muscle_viscosity"]


def test_an_objective_is_one_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mean distance to the cloth: its value where the cloud lies off by as much, and its derivative."""
    monkeypatch.setattr(objective_room, "MEASURES", {**MEASURES})
    declared("Add an objective", names=vars(objective_room))
    shape = AnalyticCloth().equilibria([Case(build("basic"), constant_program([1e5] * 8))])[0][None].astype(float)
    objective = Objective([Target(shape[0, :1681] + [0, 0, 0.002])], measure="mean")  # type: ignore[arg-type]
    assert 1e-3 < objective.value(shape) < 2.001e-3
    _, slope = objective.gradient(shape)
    direction = np.random.default_rng(0).standard_normal(shape.shape)
    ahead, behind = (objective.gradient(shape + h * direction)[0] for h in (1e-8, -1e-8))
    assert np.sum(slope * direction) == pytest.approx((ahead - behind) / 2e-8, rel=1e-3)


STUDY = """
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Unpack
from fabdesign.files.design_file import read_design
from fabdesign.files.pressure_file import constant_program
from fabdesign.formats.schema import ABOVE_0, FROM_0, Key, Kilopascal, Second
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case
from fabdesign.runtime.store import Checkpoint
from fabdesign.study_files.study_file import Name, Outputs, StudyFile
from studies.report import page
from studies.study import Simulated, StudyRun, kept_content, simulator, write_result
"""


def test_a_study_is_its_keys_and_what_runs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A study of two pressures: its schema, its result and page, and that the same study goes on where it stopped."""
    sag = declared("Add a study", STUDY)
    monkeypatch.setitem(STUDIES, "sag", sag["SagStudy"])
    [schema] = [one for one in schema_of("study")["oneOf"] if one["properties"]["kind"] == {"const": "sag"}]
    assert {"pressures", "limits", "outputs"} <= {*schema["properties"]}
    text, cloth = "z of corner (0.2, 0.2)", AnalyticCloth()
    study = sag["SagStudy"].read({"name": "sag", "design": build("cross"), "outputs": [text], "pressures": [0, 100.5]})
    first = sag["run_sag"](study, tmp_path / "out", forward=cloth, seconds=60)
    assert first.rows[0][text] == 0 and first.rows[1][text] > 1  # mm
    assert json.loads((tmp_path / "out/result.json").read_text()) == {"name": "sag", "rows": first.rows}
    assert text in (tmp_path / "out/report.html").read_text(encoding="utf-8")
    calls = cloth.calls
    assert sag["run_sag"](study, tmp_path / "out", forward=cloth) == first and cloth.calls == calls


def test_a_kind_of_file_is_a_dataclass(tmp_path: Path) -> None:
    """A lamp is written and read, and what it may not be is said in a line."""
    imports = (
        "from dataclasses import dataclass\nfrom pathlib import Path\nfrom typing import Annotated\nimport tomlkit\n"
    )
    imports += "from fabdesign.formats.codec import Encoder, decode\nfrom fabdesign.output import write_text\n"
    imports += "from fabdesign.formats.schema import FileUnit, Within\nfrom fabdesign.formats.table import load_toml\n"
    lamp = declared("Add a kind of file", imports)
    one = lamp["Lamp"]("left", (0.1, 0.0, 1.0), 60.0)
    lamp["write_lamp"](one, tmp_path / "lamp.toml")
    assert lamp["read_lamp"](tmp_path / "lamp.toml") == one
    (tmp_path / "lamp.toml").write_text((tmp_path / "lamp.toml").read_text().replace("60", "600"))
    with pytest.raises(InputError, match=r"^[^\n]*power = 600[^\n]*; expected[^\n]*500[^\n]*$"):
        lamp["read_lamp"](tmp_path / "lamp.toml")


def test_a_block_of_a_page_is_a_dataclass_with_its_html() -> None:
    imports = "from dataclasses import dataclass\nfrom studies.report.page import Block"
    quote = declared("Show something new on a page", imports)["Quote"]
    assert "<blockquote>It holds.<br>A &amp; B</blockquote>" in html_of("Page", [quote("It holds.", "A & B")])
