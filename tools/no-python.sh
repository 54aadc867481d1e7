#!/bin/sh
# no-python.sh VERSION WHAT: says that there is no interpreter of a version, as 3.12, and what is left out for it.
# Status 1 where CI is set and apt has one: CI must then install it.
set -u
apt=$(LC_ALL=C apt-cache policy "python$1-venv" 2>/dev/null | sed -n 's/^ *Candidate: *//p')
missing="no Python $1 with venv found on the path or under pyenv"
if [ -z "$apt" ] || [ "$apt" = '(none)' ]; then
    echo "wheel-test: skipped $2: $missing, and apt has none"
    exit 0
fi
exec "$(dirname "$0")/skip.sh" "$2" "$missing; install it with 'apt-get install python$1-venv'"
