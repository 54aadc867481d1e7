#!/bin/sh
# wheel-test.sh PYTHON [--once] [--lowest | --newest | --short]
#
# Installs the wheel in .build/wheel for an interpreter and runs the runtime's tests against it, away from the package
# folders, where torch and scipy are absent. Its dependencies are those that constraints.txt pins, the lowest that
# pyproject.toml allows, or the newest there are; pytest and hypothesis are the pinned ones in any case.
# --short, and with other versions than the pinned ones: whole streams alone start processes. What an interpreter or a
# dependency may break shows within one.
# --once: leave out what was tested with this wheel already. Without an index the lowest and the newest are left out,
# which is a failure where CI is set.
set -eu
interpreter=$1
shift
versions=pinned once= short=
for option; do
    case $option in
        --once) once=yes ;;
        --lowest | --newest) versions=${option#--} short=yes ;;
        --short) short=yes ;;
        *) echo "wheel-test: $option: expected --once, --short, --lowest or --newest" >&2; exit 2 ;;
    esac
done
version=$("$interpreter" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
wheel=$(ls .build/wheel/*.whl)
here=$(pwd)/.build/wheel-$version-$versions
done_mark=$here/tested-$(cat "$wheel" constraints*.txt | sha256sum | cut -c1-16)
if [ -n "$once" ] && [ -f "$done_mark" ]; then
    echo "wheel-test: Python $version with $versions dependencies was tested with this wheel"
    exit 0
fi
rm -rf "$here"
"$interpreter" -m venv "$here"
python=$here/bin/python
pip="$python -m pip --disable-pip-version-check --quiet"
tools=$(grep -E '^(pytest|pytest-xdist|hypothesis)==' constraints.txt)
case $versions in
    pinned) set -- --constraint constraints.txt ;;
    lowest) set -- --constraint constraints-lowest.txt ;;
    newest) set -- --upgrade --upgrade-strategy eager ;;
esac
# A folder of wheels, or no network, offers one version of a package or none; an index offers all that were released.
if [ "$versions" != pinned ] && ! $pip --retries 1 --timeout 20 download --no-deps --dest "$here" numpy==0 2>&1 |
    grep -q 'from versions: .*,'; then
    "$(dirname "$0")/skip.sh" "the $versions dependencies under Python $version" "no package index answers" || exit 1
    exit 0
fi
# shellcheck disable=SC2086 # words on purpose
$pip --retries 10 --timeout 60 install "$@" "$wheel" $tools
"$python" - <<'PY'
import importlib.util
import sys

found = [name for name in ("torch", "scipy") if importlib.util.find_spec(name)]
sys.exit(f"wheel-test: {', '.join(found)} must be absent here" if found else 0)
PY
away=$(mktemp -d)
trap 'rm -rf "$away"' EXIT
tools/copy-runtime-tests.sh "$away"
cd "$away"
"$python" -c 'import importlib.metadata as found, sys, eitskin
names = ("numpy", "onnxruntime", "pyserial", "pyusb", "msgpack", "pyzmq", "cobs", "google-crc32c")
print("wheel-test: Python", sys.version.split()[0], "eitskin from", eitskin.__file__)
print("wheel-test:", *(f"{name} {found.version(name)}" for name in names))'
"$here/bin/eitskin" --version
try() { "$python" -m pytest -q --numprocesses auto --maxprocesses 8 --dist loadfile "$@"; }
if [ "$short" ]; then
    try -m "not process and not slow" tests
    try -m "not slow" tests/runtime/test_stream.py
else
    try -m "not slow" tests
fi
touch "$done_mark"
