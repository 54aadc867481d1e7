"""Units, rule and recipe as they are shipped: their own grammar, and systemd's and udev's word."""

import re
import shutil
import subprocess
import sys

import pytest
from tests.runtime.made_up_skin import virtual_skin

from eitskin.acquisition.usb_port import PRODUCT_ID, VENDOR_ID
from eitskin_tools import cli
from eitskin_tools.commands.service import FILES, text_of, write

UNITS = ("eitskin.service", "eitskin@.service")


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_starts_a_command_that_is_understood_and_watches_it(name):
    text = text_of(name, "robot", "/opt/eitskin/bin/eitskin")
    assert "{" not in text
    assert re.search(r"^Type=notify$", text, re.MULTILINE)
    watched_s = re.search(r"^WatchdogSec=([\d.]+)$", text, re.MULTILINE)[1]
    assert float(watched_s) > 2 * 2.0, "longer than a frame loop may stand still"
    command = re.search(r"^ExecStart=/opt/eitskin/bin/eitskin (run --config /etc/eitskin/.*)$", text, re.MULTILINE)[1]
    assert cli._parser("run").parse_args(command.replace("%i", "arm").split()).config


def analyse(*words):
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("no systemd-analyze: the Debian package systemd has it")
    return subprocess.run([program, *words], capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture
def written(tmp_path):
    """Return the folder with all files, whose units start a program that exists."""
    words = ["service", "--out", str(tmp_path / "units"), "--user", "root"]
    assert cli.main(words) == 0
    return tmp_path / "units"


@pytest.mark.process
def test_systemd_takes_the_units(written):
    found = analyse("--man=no", "verify", *(str(written / name) for name in UNITS))
    assert (found.returncode, found.stdout + found.stderr) == (0, "")
    unit = written / "eitskin.service"
    unit.write_text(unit.read_text().replace("ProtectClock=", "ProtectClocks="))
    assert "ProtectClocks" in analyse("--man=no", "verify", str(unit)).stderr


def test_the_rule_names_the_ids_that_are_looked_for_and_the_unit_that_is_shipped():
    text = text_of("61-eitskin-start.rules", "robot", "/usr/bin/eitskin").replace("\\\n", " ")
    rules = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    assert len(rules) == 2
    part = re.compile(r'(ACTION|SUBSYSTEM|TAG|ATTRS?\{\w+\}|ENV\{\w+\})(==|!=|\+=)"[\w.-]+"')
    for rule in rules:
        parts = [each.strip() for each in rule.split(",")]
        assert all(part.fullmatch(each) for each in parts), rule
        assert re.search(rf'ATTRS?\{{idVendor\}}=="{VENDOR_ID:04x}"', rule)
        assert re.search(rf'ATTRS?\{{idProduct\}}=="{PRODUCT_ID:04x}"', rule)
        assert 'TAG+="systemd"' in rule
        assert 'ENV{SYSTEMD_WANTS}+="eitskin.service"' in rule
    assert "eitskin.service" in {one.name for one in FILES}


def test_files_are_written_where_the_system_looks(tmp_path):
    write(tmp_path, "robot", "/usr/bin/eitskin", homes=True)
    written = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert written == [
        "etc/systemd/system/eitskin.service", "etc/systemd/system/eitskin@.service",
        "etc/udev/rules.d/61-eitskin-start.rules",
    ]  # fmt: skip
    assert "User=robot" in (tmp_path / written[0]).read_text()


def test_the_recipe_runs_as_nobody_in_particular_and_looks_at_its_health():
    text = text_of("Containerfile", "robot", "/usr/bin/eitskin").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    known = {"FROM", "COPY", "RUN", "ENV", "USER", "WORKDIR", "STOPSIGNAL", "HEALTHCHECK", "ENTRYPOINT", "CMD"}
    assert {line.split()[0] for line in lines} <= known
    last = {line.split()[0]: line for line in lines}
    assert last["USER"].split()[1] not in ("root", "0")
    assert '["eitskin", "status", "--all"]' in last["HEALTHCHECK"]
    assert cli._parser("status").parse_args(["status", "--all"]).all
    assert cli._parser("run").parse_args(["run", "--config", "/etc/eitskin/robot.toml"]).config


MDWE = """
import ctypes, os, sys
assert ctypes.CDLL(None).prctl(65, 1, 0, 0, 0) == 0, "refused"
os.execv(sys.executable, [sys.executable, "-m", "eitskin_tools.cli", *sys.argv[1:]])
"""
"""Runs eitskin under PR_SET_MDWE (Linux 6.3), the kernel's own form of MemoryDenyWriteExecute."""


@pytest.mark.process
def test_the_runtime_needs_no_memory_that_is_written_and_executed(tmp_path):
    with virtual_skin(touches=[[0.3, 300, 0.3]]) as port:
        words = ["run", "--port", port, "--reference-frames", "10", "--force-reference", "--frames", "50"]
        words += ["--publish", f"ipc://{tmp_path}/f", "--control", f"ipc://{tmp_path}/c"]
        found = subprocess.run(
            [sys.executable, "-c", MDWE, *words], capture_output=True, text=True, check=False, timeout=120
        )
    if "refused" in found.stderr:
        pytest.skip("this kernel has no PR_SET_MDWE: Linux 6.3 and later have it")
    assert found.returncode == 0, found.stderr
    assert "50 frames at" in found.stderr
    assert re.search(r"vd2t\S* \d+ us", found.stderr), "a network has run"
