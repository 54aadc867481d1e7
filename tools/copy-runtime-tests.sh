#!/bin/sh
# copy-runtime-tests.sh FOLDER: copies the tests that need the wheel alone, away from the package folders.
set -eu
mkdir -p "$1/tests/faults" "$1/firmware_proto"
cp -r tests/runtime tests/proto tests/golden tests/conftest.py tests/second_skin.py "$1/tests/"
cp tests/faults/usb_bus.py tests/faults/usb_skin.py "$1/tests/faults/" # the mocked bus of tests/runtime
rm "$1/tests/proto/test_generated.py" # compares files of the repository, not of the wheel
cp firmware_proto/SPEC.md "$1/firmware_proto/"
cp pyproject.toml "$1/"
