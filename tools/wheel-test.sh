#!/bin/sh
# Runs the runtime's tests against an installed wheel, away from the package folders, where torch and scipy are absent.
set -eu
python=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
"$python" - <<'PY'
import importlib.util
import sys

found = [name for name in ("torch", "scipy") if importlib.util.find_spec(name)]
sys.exit(f"wheel-test: {', '.join(found)} must be absent here" if found else 0)
PY
away=$(mktemp -d)
trap 'rm -rf "$away"' EXIT
mkdir "$away/tests" "$away/firmware_proto"
cp -r tests/runtime tests/proto tests/golden "$away/tests/"
rm "$away/tests/proto/test_generated.py" # compares files of the repository, not of the wheel
cp firmware_proto/SPEC.md "$away/firmware_proto/"
[ -f tests/conftest.py ] && cp tests/conftest.py "$away/tests/"
cp pyproject.toml "$away/"
cd "$away"
"$python" -c 'import eitskin; print("wheel-test: eitskin from", eitskin.__file__)'
"$python" -m pytest -q tests
