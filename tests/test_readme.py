"""The README's Python example runs as it is printed, its links lead somewhere, and the citation is of this version."""

import re
from pathlib import Path

import pytest

from fabdesign import __version__
from tests.conftest import ROOT


def test_readme_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    example = (ROOT / "README.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    exec(compile(example, "README.md", "exec"), {})
    forward = [float(line.split()[-2]) for line in capsys.readouterr().out.splitlines()]
    # muscles on the front shorten it, so the lower edge comes towards the viewer, the further the higher the pressure
    assert len(forward) == 4
    assert forward[-1] > max(forward[0], 0)
    assert (tmp_path / "design.toml").is_file()


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md")))])
def test_named_files_exist(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    linked = re.findall(r"\]\(([^)#:]+)\)", text)
    here = [f"{(ROOT / page).parent}/{name}" for name in linked + re.findall(r"`((?:results/)?[a-z_]+\.md)`", text)]
    there = [f"{ROOT}/{name}" for name in re.findall(r"`((?:docs|examples|tests|scripts)/[\w/]+\.\w+)`", text)]
    assert [name for name in here + there if not Path(name).exists()] == []


def test_citation_is_of_this_version() -> None:
    lines = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    assert f"version: {__version__}" in lines
