"""docs/rooms.svg: the packages and their rooms, with an arrow for each package of the next row that one imports.

python scripts/rooms_picture.py            # draws it from the imports of today
python scripts/rooms_picture.py --check    # exits with 1 where it is not current
"""

import sys
from collections import Counter, defaultdict
from graphlib import TopologicalSorter
from html import escape
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from house import ROOT, imported_by, trees

PICTURE = ROOT / "docs" / "rooms.svg"
ON_TOP = "fabdesign.cli", "fabdesign.interface"  # rooms of fabdesign that know the other packages
ENTRIES = "fabdesign", "fabdesign.__main__"  # load what lies on top when they are asked for it
WIDTH, GAP, LINE, PAD = 780, 46, 18, 10
LETTER = 6.6  # width of a letter, drawing units


def package_of(module: str) -> str:
    """Return the box that a module is drawn in."""
    return next((room for room in ON_TOP if module.startswith(room)), module.split(".")[0])


def room_of(module: str) -> str:
    """Return the room of a module, "" for files of the package itself."""
    parts = module.split(".")
    return "" if package_of(module) in ON_TOP or len(parts) < 3 else parts[1]


def arrows(users: dict[str, set[str]]) -> dict[str, Counter[str]]:
    """Return of each package how many imports of its modules go to each other package."""
    going: dict[str, Counter[str]] = defaultdict(Counter)
    for module, others in users.items():
        for user in others:
            if user not in ENTRIES and package_of(user) != package_of(module):
                going[package_of(user)][package_of(module)] += 1
    return going


def rows(going: dict[str, Counter[str]], packages: set[str]) -> list[list[str]]:
    """Return the packages in rows: each above all that it imports. Raises CycleError where imports go round."""
    depth: dict[str, int] = {}
    for package in TopologicalSorter({name: set(going[name]) for name in packages}).static_order():
        depth[package] = 1 + max((depth[other] for other in going[package]), default=0)
    levels = sorted(set(depth.values()), reverse=True)
    return [sorted(name for name in packages if depth[name] == level) for level in levels]


def wrapped(words: list[str], width: float) -> list[str]:
    """Return words in lines that fit a width of the drawing."""
    lines = [""]
    for word in words:
        if lines[-1] and (len(lines[-1]) + 2 + len(word)) * LETTER > width:
            lines.append("")
        lines[-1] = f"{lines[-1]}, {word}".removeprefix(", ")
    return lines


def drawn() -> str:
    """Return the picture as SVG."""
    users = imported_by(trees())
    going = arrows(users)
    rooms: dict[str, set[str]] = defaultdict(set)
    for module in users:
        rooms[package_of(module)].add(room_of(module))
    parts, boxes, top = [], {}, float(PAD)
    for row in rows(going, set(rooms)):
        width = (WIDTH - 2 * PAD - (len(row) - 1) * GAP) / len(row)
        texts = {name: wrapped(sorted(filter(None, rooms[name])), width - 2 * PAD) for name in row}
        height = 2 * PAD + LINE * (1 + max(sum(map(bool, lines)) for lines in texts.values()))
        for k, name in enumerate(row):
            left = PAD + k * (width + GAP)
            boxes[name] = (left + width / 2, top, top + height)
            parts.append(f'<rect x="{left:.0f}" y="{top:.0f}" width="{width:.0f}" height="{height:.0f}" rx="6"/>')
            head = f'<tspan class="name">{name.replace(".", "/")}</tspan>'
            for line, text in enumerate([head, *map(escape, texts[name])]):
                parts.append(f'<text x="{left + PAD:.0f}" y="{top + PAD + LINE * (line + 0.75):.0f}">{text}</text>')
        top += height + GAP
    for name, others in sorted(going.items()):
        (x, _, y) = boxes[name]
        for to, start, _ in (boxes[other] for other in sorted(others)):
            if not any(y < box[1] and box[2] < start for box in boxes.values()):  # to the next row alone
                parts.append(f'<line x1="{x:.0f}" y1="{y:.0f}" x2="{to:.0f}" y2="{start - 7:.0f}"/>')
    style = (
        "<style>rect{fill:#f5f6f8;stroke:#9aa5b1}text{font:12px system-ui,sans-serif;fill:#46505d}"
        ".name{font-weight:600;fill:#1c2430}line{stroke:#1f6fb2;stroke-width:1.5;marker-end:url(#a)}</style>"
        '<defs><marker id="a" viewBox="0 0 10 10" refX="3" refY="5" markerWidth="6" markerHeight="6" orient="auto">'
        '<path d="M0 0L10 5L0 10z" fill="#1f6fb2"/></marker></defs>'
    )
    box = f'viewBox="0 0 {WIDTH} {top - GAP + PAD:.0f}"'
    body = "\n".join(parts)
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} width="{WIDTH}">{style}\n{body}\n</svg>\n'


if __name__ == "__main__":
    picture = drawn()
    if "--check" in sys.argv:
        sys.exit(not PICTURE.is_file() or PICTURE.read_text(encoding="utf-8") != picture)
    PICTURE.write_text(picture, encoding="utf-8")
