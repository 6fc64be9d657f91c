#!/usr/bin/env bash
# Makes .venv with the pinned packages, then gives SAPIEN something to render with. `make` runs it when needed.
# Takes a machine with python3 (3.11 or newer), git and make; with root or sudo it adds what Debian splits off.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}

if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
  echo "Set-up: $("$python" --version) is too old, 3.11 or newer is needed. Name another:  make PYTHON=python3.12 ..." >&2
  exit 1
fi

# Debian and Ubuntu keep ensurepip, without which no venv gets pip, in a package of its own.
if ! "$python" -c 'import ensurepip' 2>/dev/null; then
  package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
  as_root=()
  [ "$(id -u)" = 0 ] || as_root=(sudo -n)
  echo "Set-up: adding $package"
  if ! { "${as_root[@]}" apt-get update -qq &&
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$package" >/dev/null; }; then
    echo "Set-up: $package is missing and needs root once. Run:  sudo apt-get install $package" >&2
    exit 1
  fi
fi

.venv/bin/python -m pip --version >/dev/null 2>&1 || { rm -rf .venv && "$python" -m venv .venv; }
echo "Set-up: installing the packages into .venv (9 GB; minutes, by the network)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt uv

# uv reads none of pip's settings, but a mirror or certificate that a site gave to pip is meant for it as well.
setting() { .venv/bin/python -m pip config get "global.$1" 2>/dev/null || true; }
index=${UV_DEFAULT_INDEX:-${PIP_INDEX_URL:-$(setting index-url)}}
certificates=${SSL_CERT_FILE:-${PIP_CERT:-$(setting cert)}}
[ -n "$certificates" ] || certificates=/etc/ssl/certs/ca-certificates.crt
[ -z "$index" ] || export UV_DEFAULT_INDEX=$index
[ ! -e "$certificates" ] || export SSL_CERT_FILE=$certificates

uv=(.venv/bin/uv pip)
# Compiled once here instead of at the first start, or at every start where Python may write no files.
"${uv[@]}" install --python .venv/bin/python --quiet --compile-bytecode -e '.[dev,hardware]' -c constraints.txt
# Both OpenCV packages own the same files; where pip brought the one with windows, only the other may stay.
if "${uv[@]}" show --python .venv/bin/python --quiet opencv-python 2>/dev/null; then
  "${uv[@]}" uninstall --python .venv/bin/python --quiet opencv-python
  "${uv[@]}" install --python .venv/bin/python --quiet --reinstall-package opencv-python-headless \
    opencv-python-headless -c constraints.txt
fi
.venv/bin/python -c 'import cv2'

# Everything but simulation and pictures works without it, so a refusal here is a remark and not the end.
bash scripts/install_vulkan.sh || echo "Set-up: the simulator will not run until that is done." >&2
touch .venv/.stamp
echo "Set-up: done. See what this machine can do:  .venv/bin/resync-robot doctor"
