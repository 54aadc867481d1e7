#!/bin/sh
# Installs the Debian packages for the C tests, the emulated board, the mocked USB bus, the look at system calls, the
# certificates and the client in C++, or those that are named: `make slow` names the browser. Only root can; anyone else
# is told what will be skipped. Tests that need a missing tool skip themselves and say which.
set -u
board="gcc libc6-dev make gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm cppcheck"
bus="libusb-1.0-0 umockdev gir1.2-umockdev-1.0 python3-gi"
calls="strace"
certificates="openssl"
client="cmake g++ libzmq3-dev cppzmq-dev"
wanted=${*:-"$board $bus $calls $certificates $client"}
missing=""
for package in $wanted; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q "install ok installed" || missing="$missing $package"
done
[ -z "$missing" ] && exit 0
if [ "$(id -u)" -ne 0 ] || ! command -v apt-get >/dev/null 2>&1; then
    echo "system-packages: not root, or no apt-get: left out$missing; the tests that need them will be skipped" >&2
    exit 0
fi
echo "system-packages: installing$missing" >&2
export DEBIAN_FRONTEND=noninteractive
# shellcheck disable=SC2086  # a list of names
apt-get install -y -qq --no-install-recommends $missing >/dev/null 2>&1 ||
    { apt-get update -qq >/dev/null 2>&1 && apt-get install -y -qq --no-install-recommends $missing >/dev/null; } ||
    echo "system-packages: could not install$missing; the tests that need them will be skipped" >&2
exit 0
