#!/bin/sh
# Install the wheel $1 into an empty environment of every Python 3.11, 3.12 and 3.13 that is here, and use it outside the
# repository: commands, embedded data, type hints, a motion. Downloads packages (some 400 MB a Python).
set -eu
wheel=$(realpath "$1")
here=$(realpath "$(dirname "$0")/..")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
tried=

find_python() { # 3.12 -> a Python of it, or nothing
    for candidate in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$1".*/bin/python; do
        if "$candidate" -c "import sys, venv, ensurepip; sys.exit('%d.%d' % sys.version_info[:2] != '$1')" 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
}

for version in ${PYTHONS:-3.11 3.12 3.13}; do
    python=$(find_python "$version")
    if [ -z "$python" ]; then
        echo "Python $version is not here"
        continue
    fi
    "$python" -m venv "$work/$version"
    (
        cd "$work/$version"
        unset PYTHONPATH
        bin/python -m pip install --quiet --disable-pip-version-check --constraint "$here/constraints.txt" "$wheel"
        bin/fabdesign --version
        bin/fabdesign new basic -o basic.toml
        bin/fabdesign check basic.toml
        bin/fabdesign effects >/dev/null
        bin/fabdesign simulate basic.toml --pressures 300,300,300,300,0,0,0,0 --duration 0.05 --grid 9 -o motion.npz
        bin/python - "$here" <<'PYTHON'
import importlib.metadata
import sys
from pathlib import Path

import fabdesign
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model

package = Path(fabdesign.__file__).parent
assert Path(sys.argv[1]) not in package.parents, package
assert fabdesign.__version__ == importlib.metadata.version("fabdesign")
assert all((package.parent / name / "py.typed").is_file() for name in ("fabdesign", "sim", "corrector", "optimize", "studies"))
assert len(read_set(package / "data" / "demo_set").trials[0].load().frames) > 0
read_model(package / "data" / "demo_model.toml")
templates = ("report/page", "view/page")
missing = [name for name in templates if not (package.parent / "studies" / f"{name}.html.j2").is_file()]
assert not missing, missing
PYTHON
    )
    rm -rf "${work:?}/$version"
    echo "Python $version: sound"
    tried="$tried $version"
done
[ -n "$tried" ] || { echo "wheel_test: no Python 3.11, 3.12 or 3.13 here" >&2; exit 1; }
