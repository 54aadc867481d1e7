#!/bin/sh
# arm-test.sh PYTHON: runs what the runtime computes as aarch64, the architecture of a Jetson or a Raspberry Pi, under
# qemu-user, with the wheel of .build/wheel.
#
# A Debian root and wheels of aarch64 lie in .build/arm. Emulation is about 15 times slower than the machine itself, and
# emulated programs cannot start others. So tests of streams, of speeds and of processes are left out.
# onnxruntime from 1.28 on crashes at its import under qemu's CPU; its newest version that does not is taken.
set -eu
onnxruntime=1.27.0
skip() { echo "arm-test: skipped: $1"; exit 0; }
tools/system-packages.sh mmdebstrap qemu-user-static
for tool in mmdebstrap qemu-aarch64-static; do
    command -v $tool >/dev/null || skip "no $tool; install the packages mmdebstrap and qemu-user-static"
done
here=$(pwd)/.build/arm
pip="${1:-python3} -m pip --disable-pip-version-check --quiet --retries 10 --timeout 60"
mkdir -p "$here"
if [ ! -x "$here/root/usr/bin/python3.11" ]; then
    mmdebstrap --quiet --variant=extract --arch=arm64 --include=python3,libstdc++6 bookworm "$here/root" ||
        { rm -rf "$here/root"; skip "no Debian packages of arm64"; }
    rm -rf "$here/root/dev" # plain files there would hide the machine's terminals
fi
rm -rf "$here/site" "$here/cobs" "$here/tests"
grep -v '^onnxruntime==' constraints.txt >"$here/constraints.txt"
platforms=""
for glibc in 2_17 2_27 2_28; do platforms="$platforms --platform manylinux_${glibc}_aarch64"; done
# shellcheck disable=SC2086 # words on purpose
$pip install --target "$here/site" --only-binary=:all: --python-version 3.11 --implementation cp --abi cp311 \
    --platform manylinux2014_aarch64 $platforms --constraint "$here/constraints.txt" \
    numpy "onnxruntime==$onnxruntime" pyserial pyusb msgpack pyzmq google-crc32c pytest hypothesis ||
    skip "no package index answers"
# cobs has no wheel for aarch64; without its extension in C it runs in Python.
$pip download --no-deps --no-build-isolation --no-binary cobs --dest "$here/cobs" "$(grep '^cobs==' constraints.txt)"
tar -xzf "$here"/cobs/*.tar.gz -C "$here/cobs" && cp -r "$here"/cobs/cobs-*/src/cobs "$here/site/"
$pip install --target "$here/site" --no-deps .build/wheel/*.whl
mkdir -p "$here/tests"
tools/copy-runtime-tests.sh "$here/tests"
cat >"$here/python" <<END
#!/bin/sh
export QEMU_LD_PREFIX="$here/root" PYTHONPATH="$here/site:$here/tests" OPENBLAS_NUM_THREADS=1
exec qemu-aarch64-static "$here/root/usr/bin/python3.11" "\$@"
END
chmod +x "$here/python"
cd "$here/tests"
"$here/python" -c 'import platform, numpy, onnxruntime, zmq
print("arm-test:", platform.machine(), *(f"{one.__name__} {one.__version__}" for one in (numpy, onnxruntime, zmq)))'
runtime="model touches reference pipeline test_reconstruct.py test_second_skin.py test_touches.py"
messages="frame frame_message long_messages regions touch_messages"
set -- tests/proto
for part in $runtime; do set -- "$@" "tests/runtime/$part"; done
for part in $messages; do set -- "$@" "tests/runtime/messaging/test_$part.py"; done
echo "arm-test: $*"
# Left out: a ladder of times, and minutes of frames. The profile sets no time for an example.
"$here/python" -m pytest -q -p no:cacheprovider --hypothesis-profile=ci -m "not process and not slow and not heavy" \
    --ignore tests/runtime/pipeline/test_latency_budget.py --ignore tests/runtime/pipeline/test_front_end_watch.py "$@"
