"""The examples of README.md and docs/python.md run as printed, links lead somewhere, the citation is of this one."""

import re
from pathlib import Path

import pytest

from fabdesign.version import __version__
from tests.conftest import ROOT


def numbers_of(page: str, word: int, capsys: pytest.CaptureFixture[str]) -> list[float]:
    """Run the page's Python example: of each line that it prints, the number that is the word of this index."""
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(example, page, "exec"), {})
    return [float(line.split()[word]) for line in capsys.readouterr().out.splitlines()]


def test_python_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    forward = numbers_of("docs/python.md", -2, capsys)
    # muscles on the front shorten it, so the lower edge comes towards the viewer, the further the higher the pressure
    assert len(forward) == 4
    assert forward[-1] > max(forward[0], 0)
    assert (tmp_path / "design.toml").is_file()


def test_readme_example(capsys: pytest.CaptureFixture[str]) -> None:
    forward = numbers_of("README.md", 4, capsys)
    assert len(forward) == 2
    assert forward[-1] > forward[0] > 0


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md")))])
def test_named_files_exist(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    here = [f"{(ROOT / page).parent}/{name}" for name in re.findall(r"`([a-z_]+\.md)`", text)]
    there = [f"{ROOT}/{name}" for name in re.findall(r"`((?:docs|examples|tests|scripts)/[\w/]+\.\w+)`", text)]
    assert [name for name in here + there if not Path(name).exists()] == []


def test_every_page_is_on_the_site() -> None:
    """Pages that Sphinx makes itself take the place of those of the same name, without a warning."""
    names = {page.stem for page in (ROOT / "docs").glob("*.md")}
    assert names & {"search", "genindex", "modindex", "py-modindex"} == set()
    listed = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split()
    assert names - {"index"} <= {*listed}


def test_citation_is_of_this_version() -> None:
    lines = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    assert f"version: {__version__}" in lines


def test_the_architecture_names_files_that_are_there() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    tracked = [file.relative_to(ROOT).as_posix() for file in ROOT.rglob("*.*") if ".venv" not in file.parts]
    named = set(re.findall(r"`([\w/]+\.(?:py|toml|j2))", text)) - {
        "design.toml",
        "model.toml",
        "study.toml",
        "set.toml",
    }
    assert [name for name in sorted(named) if not any(f"/{file}".endswith(f"/{name}") for file in tracked)] == []
