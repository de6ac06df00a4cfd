#!/usr/bin/env bash
# First light on a GPU: scripts/gpu_check.sh [WHEELS] [--minutes 6] [--device cuda] [--output gpu_check.json]
#
# Needs Python 3.10 or newer with PyTorch 2.4 or newer for CUDA; PYTHON names another one than python3. Packages that
# lack are installed from the folder WHEELS, without a network, else from the package index. To fill the folder, on a
# machine with the same Python:
#   pip download --dest WHEELS plyfile array-api-compat matplotlib scipy tqdm typer plotly kaleido pytest==9.1.1 \
#     pytest-timeout pytest-xdist hypothesis array-api-strict
set -euo pipefail
python=${PYTHON:-python3}
from=()
if [ $# -gt 0 ] && [ "${1#--}" = "$1" ]; then
  from=(--no-index --find-links "$(cd "$1" && pwd)")
  shift
fi
root=$(cd "$(dirname "$0")/.." && pwd)
"$python" -c 'import torch; assert tuple(map(int, torch.__version__.split(".")[:2])) >= (2, 4)' || {
  echo "$python needs PyTorch 2.4 or newer: https://pytorch.org/get-started/locally" >&2
  exit 2
}
lacking() {
  "$python" -c '
import sys
from importlib.util import find_spec
names = dict(pair.split("=", 1) for pair in sys.argv[1:])
print(*(package for module, package in names.items() if find_spec(module) is None))' "$@"
}
needed=$(lacking array_api_compat=array-api-compat matplotlib=matplotlib numpy=numpy PIL=pillow plyfile=plyfile \
  scipy=scipy tqdm=tqdm typer=typer)
# shellcheck disable=SC2086  # names of packages
[ -z "$needed" ] || "$python" -m pip install -q "${from[@]}" $needed
# Without a network the report is as good: pip asks once, and the end of the check names what lacks.
useful=$(lacking "pytest=pytest!=9.2.0" pytest_timeout=pytest-timeout xdist=pytest-xdist hypothesis=hypothesis \
  array_api_strict=array-api-strict plotly=plotly kaleido=kaleido)
for package in $useful; do
  "$python" -m pip install -q --retries 0 --timeout 5 "${from[@]}" "$package" 2>/dev/null || break
done
PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH} exec "$python" "$root/scripts/gpu_check.py" "$@"
