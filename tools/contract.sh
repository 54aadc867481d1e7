#!/bin/bash
# Does this checkout still do what an older commit did? Compared side by side, on this machine:
#
#   tools/contract.sh BASE [--slow]
#
# ids and shipped bundles, `evaluate` on both shipped phantom files (1e-6), the `--json` keys that others rely on, and
# recordings that BASE makes and this checkout computes again, bit for bit. --slow adds the figures of `--solver
# verified` and `bench verify`, a quarter of an hour. BASE runs from a worktree below .build with this checkout's
# packages. Prints one line a check; exit status 1 if one failed.
set -u
[ $# -ge 1 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
cd "$(dirname "$0")/.." || exit 1
here=$PWD base=$1 slow=${2:-} failed=0
python=${PYTHON:-$here/.venv/bin/python}
work=$here/.build/contract
old=$work/base
rm -rf "$work"; git worktree prune; mkdir -p "$work"
git worktree add --quiet --detach "$old" "$base" || exit 1
trap 'git worktree remove --force "$old"; kill $(jobs -p) 2>/dev/null' EXIT

run() {  # run TREE ARGUMENTS...: eitskin of that tree
    (start "$@")
}

start() {  # the same in place of this shell, so that a job's number is that of eitskin itself
    tree=$1; shift
    export PYTHONPATH=$tree/firmware_proto:$tree/runtime:$tree/training:$tree/export:$tree/tools
    exec "$python" -m eitskin_tools.entry "$@"
}

check() {  # check NAME COMMAND...
    name=$1; shift
    if said=$("$@" 2>&1); then echo "ok      $name $said"; else echo "FAILED  $name: $said"; failed=1; fi
}

same_text() { [ "$(run "$old" "$@" 2>&1)" = "$(run "$here" "$@" 2>&1)" ] || { run "$here" "$@"; return 1; }; }

evaluates_alike() {  # evaluates_alike PHANTOMS
    for tree in "$old" "$here"; do
        run "$tree" evaluate --phantoms "$1" --solver vd2t --noise N2 --snr-db 50 --json >"$work/$(basename "$tree").json" \
            || return 1
    done
    "$python" - "$work/base.json" "$work/$(basename "$here").json" <<'PY'
import json, sys
old, new = (json.load(open(path)) for path in sys.argv[1:])
assert set(old) <= set(new), f"keys missing: {sorted(set(old) - set(new))}"
rows = [(o, n) for o, n in zip([old["mean"], *old["phantoms"]], [new["mean"], *new["phantoms"]], strict=True)]
worst = max(abs(o[k] - n[k]) for o, n in rows for k in o if isinstance(o[k], float))
assert worst <= 1e-6, f"differ by {worst:.2g}"
print(f"differ by {worst:.1g} at most, cc {new['mean']['cc']:.4f}")
PY
}

record() {  # record NAME "OPTIONS OF virtual-skin" "OPTIONS OF run" [OPTIONS OF subscribe]: with BASE, six seconds
    at=$work/$1; mkdir "$at"
    start "$old" virtual-skin $2 >"$at/port" 2>"$at/skin.log" & skin=$!
    until [ -s "$at/port" ]; do kill -0 $skin || return 1; sleep 0.2; done
    start "$old" run --port "$(grep -o '/[^ ]*' "$at/port" | head -1)" --publish "ipc://$at/frames" \
        --control "ipc://$at/control" $3 >"$at/log" 2>&1 & reading=$!
    until grep -qs ^ready "$at/log"; do kill -0 $reading || { tail -1 "$at/log"; return 1; }; sleep 0.2; done
    listening=; [ -z "${4:-}" ] || { start "$old" subscribe "ipc://$at/frames" $4 >"$at/subscribed" 2>&1 & listening=$!; }
    start "$old" record "ipc://$at/frames" --out "$work/$1.mcap" --maps --frames 1200 >"$at/record.log" 2>&1 & recording=$!
    run "$old" surface sample --predict --out "$at/cloud.npz" --send "ipc://$at/control" >"$at/surface.log" 2>&1
    wait $recording; kept=$?
    kill -TERM $reading $skin $listening 2>/dev/null; wait $reading $skin 2>/dev/null
    return $kept
}

reinfers() {  # reinfers NAME ...: as record; every map that was published comes out again
    record "$@" || { echo "recording failed"; return 1; }
    run "$here" reinfer "$work/$1.mcap" --json >"$work/$1.json" 2>"$work/$1.err" || { cat "$work/$1.err"; return 1; }
    "$python" -c 'import json, sys; r = json.load(open(sys.argv[1])); print(r["equal"], "of", r["published"], "maps equal")
sys.exit(r["equal"] != r["published"] or r["published"] < 300 or not {"frames", "frames_per_s"} <= set(r))' "$work/$1.json"
}

has_keys() {  # has_keys "KEYS" COMMAND...: of the one JSON object that it prints
    keys=$1; shift
    run "$here" "$@" --json 2>"$work/err" >"$work/keys.json" || { cat "$work/err"; return 1; }
    "$python" -c 'import json, sys; r = json.load(open(sys.argv[1])); lost = set(sys.argv[2].split()) - set(r)
sys.exit(f"keys missing: {sorted(lost)}" if lost else 0)' "$work/keys.json" "$keys"
}

at_least() {  # at_least FIGURE KEY COMMAND...: mean of that key
    figure=$1 key=$2; shift 2
    run "$here" "$@" --json 2>"$work/err" >"$work/mean.json" || { cat "$work/err"; return 1; }
    "$python" -c 'import json, sys; found = json.load(open(sys.argv[1]))["mean"][sys.argv[2]]; print(f"{found:.4f}")
sys.exit(found < float(sys.argv[3]))' "$work/mean.json" "$key" "$figure"
}

check "version and ids" same_text --version
check "wire vectors and SPEC" "$python" -m pytest -qq -p no:cacheprovider tests/proto/wire tests/docs/test_spec.py \
    tests/docs/test_spec_defaults.py
check "paper_units by vd2t" evaluates_alike paper_units
check "paper_mm by vd2t" evaluates_alike paper_mm
check "raising touches" reinfers raising "" ""
check "lowering touches, a budget" reinfers lowering "--touches lower" "--touches lower --budget-ms 5"
check "units, verified" reinfers units "" "--bundle units --verify idle"
check "an electrode left out, drift" reinfers lacking "--fault flip/50" "--exclude-electrode 3 --compensate-drift"
check "a region asked for" reinfers region "" "" "--region 20 20 80 70"
check "demo" has_keys "frames rate_hz lost corrupt latency_us stages_us cc_median" demo --seconds 5
check "bench frame" has_keys "frames rate_hz lost corrupt latency_us stages_us inference_us ratios latency_inferred_us line_us" \
    bench frame --frames 600 --rate 200 --calls 20
check "bench footprint" has_keys "rows summary" bench footprint
if [ "$slow" = --slow ]; then
    check "paper_mm verified, cc at least 0.993" at_least 0.993 cc evaluate --phantoms paper_mm --solver verified \
        --noise N2 --shift-px 0.5 --seeds 4
    check "paper_units verified, exact" at_least 1 exact evaluate --phantoms paper_units --solver verified --noise N2
    run "$here" bench verify --deformations 10 --each 4 --sets 0
fi
exit $failed
