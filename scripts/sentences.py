"""Words a sentence on every page of the site, as `make lint` asks: 15 in the mean of a page, 40 in any sentence.

The mean is taken twice, of running text alone and with the items of lists, so that neither hides the other. Code,
tables, headings and equations are left out.

python scripts/sentences.py               # a table, and an error where a page breaks the rule
python scripts/sentences.py PAGE...       # of these pages
"""

import json
import re
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
MEAN, LONGEST = 15.0, 40
OTHERS = "README.md", "CONTRIBUTING.md", "SECURITY.md"
ABBREVIATIONS = re.compile(r"\b(e\.g|i\.e|et al|cf|vs|Fig|Eq|No|approx|St)\.")
FENCE = re.compile(r"^ {0,3}(`{3,}|~{3,})")
# tables, headings, comments, pictures, front matter and equations, which are no sentences
NO_PROSE = re.compile(r"^\s*(\||#|<|!\[|---\s*$|\$\$|:::| {4}\S)")
ITEM = re.compile(r"^\s*([-*+]|\d+\.)\s+")
WORD = re.compile(r"[^\W_](?:[\w.,'/-]*\w)?")


class Count(NamedTuple):
    """The sentences of a page: how many, words in the mean (of running text, and of all), and the longest one."""

    sentences: int
    running: float
    mean: float
    longest: int
    text: str  # of the longest


def site() -> list[Path]:
    """Return the pages in the site's navigation, as the toctrees of docs/index.md name them, and those beside it."""
    docs = ROOT / "docs"
    trees = re.findall(r"```\{toctree\}\n(.*?)```", (docs / "index.md").read_text(encoding="utf-8"), re.DOTALL)
    names = [line.split("<")[-1].rstrip(">").strip() for tree in trees for line in tree.splitlines()]
    pages = [docs / f"{name}{ending}" for name in ["index", *names] for ending in (".md", ".ipynb")]
    return [page for page in [*pages, *(ROOT / name for name in OTHERS)] if page.is_file()]


def text_of(page: Path) -> str:
    """Return a page's Markdown; of a notebook that of its text."""
    text = page.read_text(encoding="utf-8")
    if page.suffix != ".ipynb":
        return text
    return "\n\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown")


def paragraphs(page: str) -> list[tuple[str, bool]]:
    """Return the page's prose, a text for each paragraph or item of a list, and whether it is an item."""
    blocks, fence, items = [""], "", set()
    for line in page.splitlines():
        mark = FENCE.match(line)
        if mark and not fence:
            fence = mark[1]
        elif fence:
            fence = "" if mark and mark[1].startswith(fence) and line.strip() == mark[1] else fence
        elif NO_PROSE.match(line) and not (line.startswith("    ") and blocks[-1]):
            blocks.append("")
        elif ITEM.match(line):
            items.add(len(blocks))
            blocks.append(ITEM.sub("", line))
        elif not line.strip():
            blocks.append("")
        else:
            blocks[-1] = f"{blocks[-1]} {line.strip()}".strip()
    return [(block, k in items) for k, block in enumerate(blocks) if block]


def sentences(page: str) -> list[tuple[str, bool]]:
    """Return the page's sentences, and which are of a list. Code in backticks is one word, a link is its text."""
    ends = re.compile(r"(?<=[.!?])[*_\"')\]]*\s+(?=[\"'*_(`]*[A-Z0-9`\[])")
    split = []
    for block, item in paragraphs(page):
        text = re.sub(r"`[^`]*`", "Code", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", block))
        text = ABBREVIATIONS.sub(r"\1", text)
        split += [(sentence, item) for sentence in ends.split(text) if sentence and WORD.search(sentence)]
    return split


def count(page: str) -> Count:
    """Return what a page's sentences come to."""
    words = [(len(WORD.findall(sentence)), sentence, item) for sentence, item in sentences(page)]
    everywhere = [number for number, *_ in words] or [0]
    running = [number for number, _, item in words if not item] or [0]
    longest, text, _ = max(words, default=(0, "", False))
    return Count(len(words), sum(running) / len(running), sum(everywhere) / len(everywhere), longest, text)


def too_long(name: str, counted: Count) -> list[str]:
    """Return what breaks the rule, a line each."""
    mean = max(counted.running, counted.mean)
    lines = [f"{name}: {mean:.1f} words a sentence, at most {MEAN:g}"] if mean > MEAN else []
    if counted.longest > LONGEST:
        lines.append(f"{name}: a sentence of {counted.longest} words, at most {LONGEST}: {counted.text[:90]}...")
    return lines


def main(names: list[str]) -> int:
    pages = [Path(name).resolve() for name in names] or site()
    counts = {page.relative_to(ROOT).as_posix(): count(text_of(page)) for page in pages}
    wrong = [line for name, counted in counts.items() for line in too_long(name, counted)]
    print("| page | sentences | words a sentence of running text | of all | longest |\n|---|---|---|---|---|")
    for name, counted in counts.items():
        print(f"| {name} | {counted.sentences} | {counted.running:.1f} | {counted.mean:.1f} | {counted.longest} |")
    print("\n".join(wrong), file=sys.stderr)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
