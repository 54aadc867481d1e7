"""Typing mistakes, options that are no numbers, do not go together or would do nothing: one line, of any command."""

import pytest

from eitskin_tools import cli
from eitskin_tools.command_line.parser import did_you_mean

SAID = """
virtual-skin --snr-db nan | --snr-db is nan, expected 0 to 200
virtual-skin --seed -1 | --seed is -1, expected 0 to 1000000000
virtual-skin --scene sample --touches lower | --touches does nothing with --scene
virtual-skin --rate=0 | --rate
virtual-skin --fault=nonsense | nonsense
virtual-skin --seconds=-1 | --seconds
demo --seconds=0 | --seconds
demo --rate=-5 | --rate
demo --noise=N9 | --noise
run --port /dev/null --reference flat.json --force-reference | --force-reference is for capturing a reference
run --port /dev/x --frames 0 | --frames
run --port /dev/x --seconds -1 | --seconds
run --port /dev/x --budget-ms nan | --budget-ms
run --port /dev/x --reference-frames 1 | --reference-frames
run --port /dev/x --affinity one | --affinity
run --port /dev/x --solver magic | --solver
run --port /dev/x --idle-after 0 | --idle-after
reference --port /dev/null | --out
subscribe --frames 0 | --frames
run | expected either --port PORT for one skin, or --config
run --port /dev/x --config r.toml | expected either --port PORT
run --config r.toml --solver vd2t | --solver is for one skin; with --config, write it into r.toml
run --port /dev/x --check | --check needs --config
run --port /dev/x --verify often | --verify is 'often', expected one of off, idle, always
run --port /dev/x --verify always --verify-budget-ms 0 | --verify-budget-ms is 0, expected more than 0 and at
run --port /dev/x --verify-budget-ms 5 | --verify-budget-ms needs --verify idle or --verify always
run --port /dev/x --verify always --verify-nice 20 | --verify-nice is 20, expected 0 to 19
run --port /dev/x --verify always --verify-affinity 4000 | --verify-affinity: CPU [4000]: expected some of
view a.mcap --endpoint ipc:///f | leave --endpoint out
view a.mcap --config robot.toml | leave --config out
view --bundle press | leave it out
view --config robot.toml --endpoint ipc:///f | leave --endpoint out
view --port 99999 | --port is 99999
view --recordings /nowhere | --recordings is /nowhere
status --timeout-s 0 | --timeout-s is 0
subscribe --verified --touches | --verified receives no frames
subscribe --force-table force.csv --touches | --force-table needs --verified
doctor --electrodes | --port PORT or --recorded
doctor --recorded f.npy | --recorded needs --electrodes
doctor --bundle free | --bundle needs --electrodes
status --server-key x | need each other
flash show fast --port x | flash show takes no FILE
flash write fast | flash write needs --port
service --user a_B | --user is 'a_B', expected a name
service --print eitskin | --print is 'eitskin', expected one of eitskin.service
adapt-skin press --skin lab --out o.eitskin --seed 99999999999999 | --seed is 99999999999999, expected 0 to 1000000000
adapt-skin press --skin lab --out o.eitskin --epochs 0 | --epochs is 0, expected at least 1
calibrate r.npz --out s.toml --bends 0 | leave out --bends, or record with --guided
calibrate r.npz --out s.toml --snr-db 3 | --snr-db is 3, expected 10 to 120
calibrate r.npz --out s.toml --guided | --guided needs --port
calibrate r.npz --out s.toml --guided --port /dev/none --stamp x | --stamp is 'x', expected a diameter
calibrate r.npz --out s.toml --guided --port /dev/none --json | --guided prints its instructions on standard output
teach p.npz --out b.eitskin --port /dev/null --presses 5 | --presses is 5, expected at least 6
teach p.npz --out b.eitskin --false-alarms 0 | --false-alarms is 0, expected 0.0001 to 0.5
evaluate --single 10 --solver verified --at-rest -1 | --at-rest is -1, expected at least 0
bench | arguments are required
bench frame --frames 5 | percentiles
bench dataset --bends 0 | --bends must be at least 1
card free --each 0 | --each is 0, expected at least 1
dataset --set paper --out d --workers 0 | --workers is 0, expected at least 1
dataset --set paper --out d --scheduler here | tls://HOST:
dataset --set mm --out d | --set is 'mm', expected one of
bech | eitskin: no command 'bech'; did you mean 'bench'?
sim | eitskin: no command 'sim'; 'eitskin --help' lists them
bench tradeof | eitskin bench: no benchmark 'tradeof'; did you mean 'tradeoff'?
run --port p --slover x | eitskin run: no option '--slover'; did you mean '--solver'?
--versoin | eitskin: no option '--versoin'; did you mean '--version'?
subscribe a b | eitskin subscribe: found 'b', expected nothing more
flash wirte paper | did you mean 'write'?
demo --noise n2 | --noise is 'n2', expected one of N1, N2, N3, none; did you mean 'N2'?
evaluate --random 2-4 --solver tikhonv | did you mean 'tikhonov'?
evaluate --random few | 2-4
evaluate --single 10 --labels units | --labels
evaluate --single 10 --shift-px 3 | --shift-px is 3, expected 0 to 1
evaluate --phantoms paper_mm --seed 5 | --seed does nothing with --phantoms: leave it out; it works with --single
evaluate --untouched --each 4 | --each does nothing with --untouched
evaluate --single 10 --solver sbl --prediction none | --prediction does nothing with --solver sbl
evaluate --phantoms paper_mm --family B | --family does nothing with --phantoms
evaluate --devices lab --seeds 3 | --seeds does nothing with --devices
evaluate --devices lab --trials foo | --trials is 'foo', expected one of mm, units, single, press04, press06
evaluate --devices lab --draws 0 | at least 1
evaluate --measured x.npz --noise N1 | --noise does nothing with --measured
evaluate --tank x.npz --solver vd2t | with --tank, --solver is 'vd2t', expected one of tikhonov, l1, sbl
evaluate --tank x.npz --bundle free | --bundle does nothing with --tank
"""
"""What is typed behind ``eitskin``, and a part of what is said to it."""


@pytest.mark.parametrize("line", SAID.strip().splitlines())
def test_it_is_said_before_anything_is_done(line, capsys):
    words, _, says = line.partition(" | ")
    assert cli.main(words.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1


def test_nothing_is_suggested_where_nothing_is_near():
    assert did_you_mean("reconstruct", ["run", "demo"]) == ""
    assert did_you_mean("file", ["drift", "single"]) == ""
