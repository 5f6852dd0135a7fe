"""The pages: links lead somewhere, sentences are short, and what is made from the code is current."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT

FRONT = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), *(ROOT / name for name in FRONT)])
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def script(name: str) -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "scripts" / f"{name}.py"))


def without_code(text: str) -> str:
    return re.sub(r"`[^`\n]*`", "code", re.sub(r"(?ms)^```.*?^```", "", text))


def anchors(text: str) -> set[str]:
    """The anchors of a page's headings, as the site and the forge make them."""
    headings = re.findall(r"(?m)^#+ (.+)$", re.sub(r"(?ms)^```.*?^```", "", text))
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", name).replace(" ", "-") for name in plain}


def test_anchors_are_those_of_headings() -> None:
    assert anchors("# One `two`, three\n```sh\n# no heading\n```\n## A [link](x.md)\n") == {"one-two-three", "a-link"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_to_pages_and_headings(page: Path) -> None:
    wrong = []
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(page.read_text(encoding="utf-8"))):
        name, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        file = (page.parent / name).resolve() if name else page
        heading = file.is_file() and (
            file.suffix != ".md" or anchor in {"", *anchors(file.read_text(encoding="utf-8"))}
        )
        if not (file.is_dir() or heading):
            wrong.append(target)
    assert wrong == []


def test_every_page_is_in_the_navigation() -> None:
    listed = {
        page.relative_to(ROOT / "docs").as_posix() for page in script("sentences")["site"]() if "docs" in page.parts
    }
    assert listed == {
        page.relative_to(ROOT / "docs").as_posix() for page in [*(ROOT / "docs").glob("*.md"), *NOTEBOOKS]
    }


def test_sentences_are_counted() -> None:
    """Code, tables and headings are no sentences; code in a line is a word; items of lists count apart."""
    count = script("sentences")["count"]
    page = "# A heading\n\nOne two `a b c` four. Five [six seven](x.md), e.g. eight!\n\n| a | b |\n\n- nine ten\n\n"
    page += "```sh\nx y\n```\n"
    assert count(page)[:4] == (3, 4.5, 11 / 3, 5)
    assert count(page).longest == 5 and "Five" in count(page).text


@pytest.mark.parametrize("page", script("sentences")["site"](), ids=lambda page: page.name)
def test_sentences_are_short(page: Path) -> None:
    sentences = script("sentences")
    assert sentences["too_long"](page.name, sentences["count"](sentences["text_of"](page))) == []


@pytest.mark.parametrize("name", ["reference", "result_pictures", "rooms_picture"])
def test_what_is_made_from_the_code_is_current(name: str) -> None:
    ran = subprocess.run([sys.executable, f"scripts/{name}.py", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert ran.returncode == 0, f"run scripts/{name}.py\n{ran.stderr}"


def test_a_threshold_that_changes_is_seen() -> None:
    """A value in a page that is not the code's is replaced by it."""
    with_tables = script("reference")["with_tables"]
    page = (ROOT / "docs" / "trace.md").read_text(encoding="utf-8")
    assert "| 95 % |" in page
    assert with_tables(page.replace("| 95 % |", "| 90 % |")) == page


SEARCHED_PAGES = "own_muscle_and_cloth", "recordings", "cluster", "effects"


@pytest.mark.parametrize(
    ("asked", "page"), zip(("own muscle type", "camera", "cluster", "effect"), SEARCHED_PAGES, strict=True)
)
def test_the_page_that_is_asked_for_has_the_words_in_its_title(asked: str, page: str) -> None:
    """The search puts a page first that has all words in its title (docs/search.js), most of all at its beginning."""
    titles = {
        file.stem: file.read_text(encoding="utf-8").split("\n")[0].lower() for file in (ROOT / "docs").glob("*.md")
    }
    having = [name for name, title in titles.items() if all(word in title for word in asked.split())]
    assert page in having
    assert len(having) == 1 or titles[page].startswith(f"# {asked}")


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_notebooks_run_and_show_what_is_kept(file: Path) -> None:
    """Each cell runs; it shows the same kinds of output as are kept, of the same words but for numbers."""
    if file.stem == "sweep_and_plot":
        pytest.importorskip("pandas")
    kept = json.loads(file.read_text(encoding="utf-8"))
    ran = script("notebooks")["run"](json.loads(file.read_text(encoding="utf-8")))
    for old, new in zip(kept["cells"], ran["cells"], strict=True):
        assert _words(old) == _words(new)


def _words(cell: dict[str, Any]) -> list[tuple[str, ...]]:
    """The kinds of a cell's outputs, and the words at the beginning of each."""
    shown = []
    for output in cell.get("outputs", []):
        data = output.get("data", {"text/plain": output.get("text", [])})
        text = "".join(data.get("text/plain", []))
        shown.append((*sorted(data), *re.findall(r"[A-Za-z_]{3,}", text)[:8]))
    return shown
