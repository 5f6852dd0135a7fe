"""The README's Python example runs as it is printed."""

from pathlib import Path

import pytest

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
