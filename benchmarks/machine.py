"""What a page of results says of where its figures come from: commit, processor."""

import platform
import subprocess
from pathlib import Path

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
