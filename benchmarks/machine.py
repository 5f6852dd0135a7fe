"""Where figures come from, commit and processor, and the part of a page that a benchmark writes."""

import platform
import subprocess
from pathlib import Path

from fabdesign.output import write_text

ROOT = Path(__file__).parents[1]


def commit(*pages: Path) -> str:
    """Short hash of the checkout; "with changes" where a tracked file other than `pages`, below ROOT, has some."""
    git = ("git", "-C", str(ROOT))
    others = [f":!{page.relative_to(ROOT)}" for page in pages]
    try:
        head = subprocess.run((*git, "rev-parse", "--short", "HEAD"), capture_output=True, text=True, check=True)
        changed = subprocess.run(
            (*git, "status", "--porcelain", "--untracked-files=no", "--", ".", *others),
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head.stdout.strip() + (" with changes" if changed.stdout.strip() else "")


def processor() -> str:
    """Its name, or the architecture where it has none."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    named = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()


def write_part(page: Path, name: str, text: str) -> None:
    """Write `text` between `<!-- NAME -->` and `<!-- end of NAME -->` of a page: all else there, people write."""
    write_text(page, with_part(page.read_text(encoding="utf-8"), name, text))


def with_part(page: str, name: str, text: str) -> str:
    """A page's text with another part. Ends the program where the page has no such part."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    before, begun, rest = page.partition(begin)
    _, ended, after = rest.partition(end)
    if not begun or not ended:
        raise SystemExit(f"no {begin.strip()} ... {end} in the page")
    return f"{before}{begin}{text.strip()}\n{end}{after}"
