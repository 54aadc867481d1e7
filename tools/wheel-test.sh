#!/bin/sh
# Installs the wheel in .build/wheel for an interpreter and runs the runtime's tests against it, away from the package
# folders, where torch and scipy are absent. A second interpreter of a version that was tested is left out.
set -eu
version=$("$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
wheel=$(ls .build/wheel/*.whl)
here=$(pwd)/.build/wheel-$version
done_mark=$here/tested-$(sha256sum "$wheel" | cut -c1-16)
if [ "${2:-}" = --once ] && [ -f "$done_mark" ]; then
    echo "wheel-test: Python $version was tested with this wheel"
    exit 0
fi
rm -rf "$here"
"$1" -m venv "$here"
python=$here/bin/python
"$python" -m pip --disable-pip-version-check --quiet --retries 10 --timeout 60 install \
    --constraint constraints.txt "$wheel" pytest pytest-xdist hypothesis
"$python" - <<'PY'
import importlib.util
import sys

found = [name for name in ("torch", "scipy") if importlib.util.find_spec(name)]
sys.exit(f"wheel-test: {', '.join(found)} must be absent here" if found else 0)
PY
away=$(mktemp -d)
trap 'rm -rf "$away"' EXIT
mkdir "$away/tests" "$away/firmware_proto"
cp -r tests/runtime tests/proto tests/golden tests/checks tests/conftest.py "$away/tests/"
rm "$away/tests/proto/test_generated.py" # compares files of the repository, not of the wheel
cp firmware_proto/SPEC.md "$away/firmware_proto/"
cp pyproject.toml "$away/"
cd "$away"
"$python" -c 'import sys, eitskin
print("wheel-test: Python", sys.version.split()[0], "eitskin from", eitskin.__file__)'
"$python" -m pytest -q --numprocesses auto --maxprocesses 8 --dist loadfile tests
touch "$done_mark"
