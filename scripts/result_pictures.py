"""The three pictures of docs/results.md, from the figures that the notebooks of docs/lab keep.

python scripts/result_pictures.py            # writes docs/results_*.svg
python scripts/result_pictures.py --check    # exits with 1 where one is not of the kept figures
"""

import io
import re
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

DOCS = Path(__file__).resolve().parents[1] / "docs"
FITTED, FLOOR, TARGET = "#2a78b5", "#9a9a9a", "#c0392b"
NUMBER = r"(\d+\.\d+)"


def lab(name: str) -> str:
    """Return a notebook's text without the marks of bold type."""
    return (DOCS / "lab" / f"{name}.md").read_text(encoding="utf-8").replace("**", "")


def unseen_layout() -> Figure:
    """Draw the error on *vertical*, which nothing was fitted to, before and after (docs/lab/corrector.md)."""
    table = lab("corrector").split("## The shipped model")[1].split("\n## ")[0]
    rows = [line.split("|") for line in table.splitlines() if line.startswith("| ")]
    column = {row[1].strip(): row[8].strip() for row in rows if len(row) == 13}
    data_sheet, factors = re.findall(NUMBER, column["data sheet; factors alone"])[:2]
    values = [float(number) for number in (data_sheet, factors, column["every effect"])]
    floor = float(column["noise floor"])
    figure, axes = plt.subplots(figsize=(6.4, 2.6), layout="constrained")
    names = ["data sheet", "seven factors fitted", "factors and effects fitted"]
    bars = axes.barh(names[::-1], values[::-1], color=[FITTED, FLOOR, FLOOR], height=0.6)
    axes.bar_label(bars, fmt="%.2f mm", padding=4)
    axes.axvline(floor, color=TARGET)
    axes.text(floor, 2.42, f" noise floor {floor:.2f} mm", color=TARGET, va="bottom")
    axes.set(xlabel="surface RMS on a layout that was not fitted, mm", xlim=(0, 3.4), ylim=(-0.5, 2.85))
    return figure


def named_effects() -> Figure:
    """Draw how many sets of the virtual rig a trace judged right, by what was missing (docs/lab/trace.md)."""
    begins = {
        "virtual rig, one effect": "one effect of 0.5 mm or more",
        "virtual rig, no effect": "no effect",
        "virtual rig, two to four": "two to four effects, all of them",
        "virtual rig, effect outside": "an effect that is in no list, or withheld",
    }
    rows = [line.split("|") for line in lab("trace").split("## In short")[1].split("\n## ")[0].splitlines()]
    counts = {}  # of the last column, what was reached; of several counts in it the whole one
    for row in (row for row in rows if len(row) == 5):
        for name in (name for begin, name in begins.items() if row[1].strip().startswith(begin)):
            pairs = [(int(right), int(all_of)) for right, all_of in re.findall(r"(\d+) of (\d+)", row[3])]
            counts[name] = max(pairs, key=lambda count: count[1]) if name.startswith("one") else pairs[0]
    assert len(counts) == len(begins)
    figure, axes = plt.subplots(figsize=(6.4, 2.6), layout="constrained")
    for k, (name, (right, all_of)) in enumerate(reversed(counts.items())):
        axes.barh(name, 100, color="#e8e8e8", height=0.6)
        axes.barh(name, 100 * right / all_of, color=FITTED, height=0.6)
        axes.text(101, k, f"{right} of {all_of}", va="center")
    axes.set(xlabel="sets with the right answer, %", xlim=(0, 116))
    return figure


def reached_targets() -> Figure:
    """Draw how near the search came to twelve targets, beside the noise floor (docs/lab/search.md)."""
    rows = re.findall(rf"^\| (\d\d_\d_\w+) \| {NUMBER} \| {NUMBER} \| (\d+) \| (\d+) \|", lab("search"), re.MULTILINE)
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for k, (name, reached, floor, muscles, truth) in enumerate(reversed(rows)):
        axes.plot([float(floor), float(reached)], [k, k], color=FLOOR, linewidth=1)
        axes.plot(float(floor), k, "|", color=TARGET, markersize=11, markeredgewidth=2)
        axes.plot(float(reached), k, "o", color=FITTED)
        axes.text(5.35, k, f"found: {muscles}; target made with: {truth}", va="center")
        axes.text(4.14, k, name[:2], va="center")
    axes.text(5.35, len(rows) - 0.2, "muscles", va="center")
    axes.set(xlabel="Chamfer distance of the result (dot) and its noise floor (line), mm", yticks=[])
    axes.set_xlim(4.1, 6.6)
    axes.set_xticks([4.5, 5.0])
    return figure


PICTURES = {"results_unseen": unseen_layout, "results_trace": named_effects, "results_search": reached_targets}


def drawn(picture: Figure) -> str:
    """Return a figure as SVG, the same text for the same figures."""
    for side in ("top", "right"):
        picture.axes[0].spines[side].set_visible(False)
    text = io.StringIO()
    picture.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(picture)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()) + "\n"


def figures_of(svg: str) -> list[str]:
    """Return the words of a picture, which tell whether it is of the kept figures on any machine."""
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


if __name__ == "__main__":
    plt.rcParams |= {"svg.hashsalt": "fabdesign", "svg.fonttype": "none", "font.size": 10}
    wrong = 0
    for name, picture in PICTURES.items():
        file, new = DOCS / f"{name}.svg", drawn(picture())
        if not file.is_file() or figures_of(file.read_text(encoding="utf-8")) != figures_of(new):
            wrong += 1
            if "--check" not in sys.argv:
                file.write_text(new, encoding="utf-8")
    sys.exit(bool(wrong) and "--check" in sys.argv)
