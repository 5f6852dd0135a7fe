"""An effect that fabdesign does not have, from a file or an installed package, in the commands."""

import importlib.metadata
from types import SimpleNamespace

import pytest

from benchmarks.trace import withheld
from fabdesign.effects import BUILT_IN, EFFECTS, Effect, EffectParameter
from fabdesign.effects.acting import acting_pressure
from fabdesign.effects.registry import effect_named, markdown_table, register_file
from fabdesign.errors import InputError
from fabdesign.nouns.forward import Term
from optimize.fit.free_parameters import fit_vector
from tests.command_line import one_line
from tests.conftest import ROOT
from tests.sim_designs import held, laced

FILE = ROOT / "examples" / "pressure_offset.py"
TERM = Term("pressure_offset", {"offset": 20.0}, "rig")
MODEL = (
    'format = "fabdesign.model/1"\n[[effects]]\nname = "pressure_offset"\nscope = "rig"\n'
    '[effects.parameters.offset]\nvalue = 20.0\nunit = "kPa"\n'
)


@pytest.fixture(autouse=True)
def registered():
    """What these tests register is gone after them."""
    known = dict(EFFECTS)
    yield
    EFFECTS.clear()
    EFFECTS.update(known)


def test_a_file_s_effect_in_the_commands(run, folder, hanging):
    (folder / "own.toml").write_text(MODEL)
    given = ("--model", folder / "own.toml", "--effects", FILE)
    out = folder / "motion.npz"
    pressures = ("--pressures", "100,0")
    one_line(
        run("simulate", folder / "cross.toml", *pressures, *given[:2], "-o", out), "unknown effect pressure_offset"
    )
    assert run("simulate", folder / "cross.toml", *pressures, *given, "-o", out)[0] == 0
    assert hanging.asked[0].effects == (TERM,)
    assert run("evaluate", folder / "set", *given, "--all")[0] == 0
    code, text, _ = run("effects", "pressure_offset", "--effects", FILE)
    assert code == 0 and "offset: added; 10 kPa by default, off at 0;" in text
    free = ("--free", "pressure_offset", "--fix", "damping", "--grid", 21, "--effects", FILE)
    code, _, err = run("calibrate", folder / "set", *free, "-o", folder / "m.toml")
    assert code == 0, err
    assert "pressure_offset" in (folder / "m.toml").read_text()


def test_it_acts():
    register_file(FILE)
    case = held(laced("cross", 2), (100, 0))
    acting = acting_pressure(type(case)(case.design, case.program, effects=(TERM,)), 4, 1e-3)
    assert acting.means[-1] == pytest.approx([120e3, 0.0])


def test_an_installed_package_s_effect(monkeypatch):
    share = EffectParameter("1", "of it", 1.0, (0.0, 1.0), 1.0)
    effect = Effect("their_effect", "fabric", "fabric", "what", "signature", "source", {"share": share})

    def points(loaded):
        point = SimpleNamespace(value="their:EFFECT", load=lambda: loaded)
        return lambda group: [point] * (group == "fabdesign.effects")

    monkeypatch.setattr(importlib.metadata, "entry_points", points(effect))
    assert effect_named("their_effect", "model.toml") is effect
    monkeypatch.setattr(importlib.metadata, "entry_points", points(3))
    with pytest.raises(InputError, match=r"entry point their:EFFECT: int; expected a fabdesign.effects.Effect"):
        effect_named("another", "model.toml")


@pytest.mark.parametrize(
    ("text", "problem"),
    [("x = 1", "declares no effect"), ("1 / 0", "ZeroDivisionError"), ("import nowhere_at_all", "nowhere_at_all")],
)
def test_a_bad_file_is_one_line_and_nothing_is_written_beside_it(text, problem, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    (tmp_path / "bad.py").write_text(text)
    with pytest.raises(InputError, match=problem):
        register_file(tmp_path / "bad.py")
    assert [file.name for file in tmp_path.iterdir()] == ["bad.py"]


def test_the_page_s_table_is_the_declarations():
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert markdown_table({name: EFFECTS[name] for name in BUILT_IN}) in page


def test_an_effect_that_is_withheld_is_in_no_fit():
    """It still moves the cloth, as where a trace tilts the frame to see whether a motion is near a bifurcation."""
    with withheld("frame_tilt"):
        assert "frame_tilt" not in fit_vector(["all"]).labels
        assert effect_named("frame_tilt", "here").parameters
    assert "frame_tilt" in fit_vector(["all"]).labels
