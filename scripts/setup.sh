#!/bin/sh
# Make .venv with fabdesign and the extras named in $1 (comma separated), from a bare Python on Debian.
# PYTHON names another one than the first that is here. Missing system libraries are installed by apt where that is
# allowed, and named in one line where it is not.
set -eu
cd "$(dirname "$0")/.."
extras=${1:-}

fail() {
    echo "setup: $1" >&2
    exit 1
}

python=
for candidate in ${PYTHON:-} python3.11 python3.12 python3.13 python3; do
    if "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then
        python=$candidate
        break
    fi
done
[ -n "$python" ] || fail "no Python 3.11, 3.12 or 3.13 here; install the package python3.11"

missing=
need_library() { # file name, Debian package
    "$python" -c "import ctypes; ctypes.CDLL('$1')" 2>/dev/null || missing="$missing $2"
}

if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    missing="$missing $("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"
fi
if [ "$(uname)" = Linux ]; then
    need_library libX11.so.6 libx11-6 # taichi
    case ",$extras," in
    *,clouds,*) # open3d
        need_library libGL.so.1 libgl1
        need_library libEGL.so.1 libegl1
        need_library libusb-1.0.so.0 libusb-1.0-0
        need_library libgomp.so.1 libgomp1
        ;;
    esac
fi

if [ -n "$missing" ]; then
    if ! command -v apt-get >/dev/null; then
        fail "missing system packages (Debian's names):$missing"
    elif [ "$(id -u)" = 0 ]; then
        apt="apt-get -qq"
    elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
        apt="sudo -n apt-get -qq"
    else
        fail "missing system packages; install them with: apt-get install$missing"
    fi
    install="env DEBIAN_FRONTEND=noninteractive $apt install -y --no-install-recommends $missing"
    [ "$(id -u)" = 0 ] || install="$apt install -y --no-install-recommends $missing"
    $install >/dev/null 2>&1 || { $apt update >/dev/null 2>&1 && $install >/dev/null 2>&1; } ||
        fail "apt could not install the missing system packages:$missing"
fi

[ -x .venv/bin/python ] || "$python" -m venv .venv

# A plain index has PyTorch with CUDA, gigabytes of it: nobody gets that unasked. pip's own configuration names the index.
case ",$extras," in
*,corrector,*)
    if [ -z "${FABDESIGN_CUDA:-}" ] && [ "$(uname)" = Linux ]; then
        cuda=$(.venv/bin/python -m pip install --quiet --disable-pip-version-check --dry-run --report - \
            --constraint constraints.txt "$(sed -n 's/^corrector = \["\(torch[^"]*\)"\].*/\1/p' pyproject.toml)" |
            grep -c '"name": "\(nvidia\|cuda\)') || true
        [ "$cuda" = 0 ] || fail "pip would download PyTorch with CUDA, gigabytes; give pip an index of CPU builds \
(PIP_INDEX_URL), or set FABDESIGN_CUDA=1 to have CUDA, or leave PyTorch out: make test EXTRAS=clouds,dev,dxf,studio"
    fi
    ;;
esac

.venv/bin/python -m pip install --quiet --disable-pip-version-check \
    --constraint constraints.txt --editable ".${extras:+[$extras]}"
