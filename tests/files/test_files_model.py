"""Model files: what is written is what is read, and bad input."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabdesign.effects import EFFECTS
from fabdesign.errors import InputError
from fabdesign.files.model_file import read_model, write_model
from fabdesign.nouns.forward import PARAMETERS
from fabdesign.nouns.model import Covariance, EffectTerm, Model, Parameter, Provenance, Quantity
from fabdesign.nouns.pressure import LearnedRange
from tests.conftest import ROOT

floats = partial(st.floats, allow_subnormal=False)  # the simulator's kernels flush those to zero
words = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=10)
numbers = floats(-1e6, 1e6)
intervals = st.tuples(numbers, numbers).map(lambda pair: (min(pair), max(pair)))
texts = st.dictionaries(words, words, max_size=3)
lists = st.lists(words, max_size=3).map(tuple)

scopes = st.none() | st.sampled_from(["fabric", "rig", "sensors", "muscle_types.em20"])
parameters = st.dictionaries(
    st.sampled_from([*PARAMETERS, "muscle_types.em20.muscle_gain"]),
    st.builds(Parameter, floats(1e-3, 1e3), st.none() | intervals, st.booleans(), scopes),
    max_size=7,
)


@st.composite
def terms(draw: st.DrawFn) -> EffectTerm:
    effect = EFFECTS[draw(st.sampled_from([*EFFECTS]))]
    chosen = draw(st.sets(st.sampled_from([*effect.parameters])))
    quantities = {}
    for name in chosen:
        parameter = effect.parameters[name]
        value = float(int(parameter.typical)) if parameter.integer else draw(floats(*parameter.bounds))
        quantities[name] = Quantity(value, parameter.unit, draw(st.none() | intervals))
    return EffectTerm(effect.name, quantities, draw(scopes))


def _what_acts(each: EffectTerm) -> tuple[object, ...]:
    """An effect in one channel or at one place: a model has it once."""
    chosen = [key for key in EFFECTS[each.name].chosen if key in each.parameters]
    return each.name, each.scope, *(each.parameters[key].value for key in chosen)


models = st.builds(
    Model,
    parameters=parameters,
    effects=st.lists(terms(), max_size=2, unique_by=_what_acts).map(tuple),
    without_effects=st.none() | parameters,
    covariance=st.none() | st.just(Covariance(("bending", "filling_lag.fill"), np.array([[0.1, 0.2], [0.2, 3]]))),
    corrector=st.none(),
    points_per_side=st.integers(9, 161),
    learned_range=st.none() | st.builds(LearnedRange, floats(0, 1e6), floats(0, 1e9), st.integers(0, 99)),
    provenance=st.builds(Provenance, lists, lists, lists, texts, texts, st.none() | st.integers(0, 2**31)),
)


@settings(deadline=None)
@given(model=models)
def test_written_model_reads_the_same(model: Model, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("model") / "model.toml"
    write_model(model, path)
    assert read_model(path) == model


def test_documented_example_is_sound(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    (tmp_path / "model.toml").write_text(page.split("```toml\n")[1].split("```")[0])
    model = read_model(tmp_path)
    assert model.parameters == {"bending": Parameter(1.08, (1.02, 1.13))}


def test_weights_move_with_the_model(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    folder.mkdir()
    (folder / "w.safetensors").write_bytes(b"weights")
    write_model(Model(corrector=folder / "w.safetensors"), folder / "model.toml")
    folder.rename(tmp_path / "moved")
    assert read_model(tmp_path / "moved").corrector == tmp_path / "moved" / "w.safetensors"


def test_intervals_of_95_percent_are_still_read(tmp_path: Path) -> None:
    text = f'{LAG}[effects.parameters.fill]\nvalue = 0.1\nunit = "s"\ninterval95 = [0.08, 0.14]'
    (tmp_path / "model.toml").write_text(text)
    low, high = read_model(tmp_path).effects[0].parameters["fill"].interval90 or (0, 0)
    assert (low, high) == pytest.approx((0.1 - 0.0168, 0.1 + 0.0336), abs=1e-4)


LAG = 'format = "fabdesign.model/1"\n[[effects]]\nname = "filling_lag"\n'


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('format = "fabdesign.model/2"', "fabdesign.model/2"),
        ('format = "fabdesign.model/1"\n[parameters.bendin]\nfactor = 1', "did you mean bending"),
        ('format = "fabdesign.model/1"\n[parameters.bending]\nfactor = 0.0', "from 0.001 to 1000"),
        ('format = "fabdesign.model/1"\n[parameters.bending]\nfactor = 1.0\nbelievable = 3', "true or false"),
        ('format = "fabdesign.model/1"\n[parameters.bending]\nfactor = 1.0\ninterval90 = [2, 1]', "low, high"),
        ('format = "fabdesign.model/1"\n[corrector]\nweights = "none"', "is not there"),
        ('format = "fabdesign.model/1"\n[[effects]]\nname = 3', "a text"),
        ('format = "fabdesign.model/1"\n[[effects]]\nname = "filing_lag"', "did you mean filling_lag"),
        ('format = "fabdesign.model/1"\n[[effects]]\nname = "filling_lag"\nscope = "rigg"', "did you mean rig"),
        (f'{LAG}[effects.parameters.fil]\nvalue = 0.1\nunit = "s"', "did you mean fill"),
        (f'{LAG}[effects.parameters.fill]\nvalue = 0.1\nunit = "ms"', 'expected "s"'),
        (f'{LAG}[effects.parameters.fill]\nvalue = 9.0\nunit = "s"', "expected 0 to 3 s"),
        ('format = "fabdesign.model/1"\n[covariance]\nnames = ["bending"]\nmatrix = [[1, 2]]', "1 rows of 1 finite"),
        ('format = "fabdesign.model/1"\n[covariance]\nnames = ["bending"]\nmatrix = [[-1]]', "no negative eigenvalue"),
        ('format = "fabdesign.model/1"\n[simulator]\npoints_per_side = 6.5', "whole number"),
        ('format = "fabdesign.model/1"\neffects = 3', r"\[\[effects\]\] tables"),
    ],
)
def test_bad_model_is_one_line(text: str, problem: str, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(text)
    with pytest.raises(InputError, match=problem):
        read_model(tmp_path / "model.toml")
