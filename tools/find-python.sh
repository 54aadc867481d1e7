#!/bin/sh
# Prints an interpreter of a version, as 3.12: from the path, or from pyenv's folder. Status 1 if there is none.
set -u
works() { "$1" -c "import ensurepip, sys, venv; sys.exit('%d.%d' % sys.version_info[:2] != '$2')" >/dev/null 2>&1; }
for python in "python$1" "${PYENV_ROOT:-$(pyenv root 2>/dev/null || echo "$HOME/.pyenv")}"/versions/"$1".*/bin/python; do
    if works "$python" "$1"; then
        command -v "$python"
        exit 0
    fi
done
exit 1
