"""The checks that hold for every test, tried on small runs of pytest that break them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from .cpu_limit import BESIDE, LIMIT_S, NOMINAL_S, slowness
from .leftovers import Leftovers

CONFTEST = """
import sys
sys.path.insert(0, {checks!r})
import cpu_limit
from cpu_limit import CpuLimit
from started_processes import StartedProcesses

def pytest_configure(config):
    cpu_limit.slowness = lambda: 1.0  # here the limit is what it says: what the tests burn is CPU time to the digit
    for marker in ("slow", "process"):
        config.addinivalue_line("markers", marker)
    config.pluginmanager.register(CpuLimit(0.1))
    config.pluginmanager.register(StartedProcesses())
"""

TESTS = """
import os, subprocess, sys, time
import pytest

LONG_S = 2 * 0.1

def busy():
    end = time.process_time() + LONG_S
    while time.process_time() < end:
        pass

def test_that_computes():
    busy()

@pytest.mark.slow
def test_that_may_compute():
    busy()

def test_that_waits():
    time.sleep(0.5)

CHILD = [sys.executable, "-c", "pass"]

@pytest.mark.process
@pytest.mark.parametrize("seconds", [0.0, LONG_S], ids=["short", "long"])
def test_of_a_child(seconds):
    code = f"import time\\nwhile time.process_time() < {seconds}: pass"
    subprocess.run([sys.executable, "-I", "-S", "-c", code], check=True)

def test_that_starts_a_child():
    subprocess.run(CHILD, check=True)

left = []

@pytest.mark.process
def test_that_waits_for_no_child():
    code = f"import time\\nwhile time.process_time() < {LONG_S}: pass\\nprint()"
    left.append(subprocess.Popen([sys.executable, "-I", "-S", "-c", code], stdout=subprocess.PIPE))
    left[0].stdout.read()

def test_that_waits_for_anothers():
    left[0].wait()

@pytest.fixture
def child():
    if os.fork() == 0:
        os._exit(0)
    os.wait()

def test_whose_fixture_forks(child):
    pass

def test_that_asks_a_compiler():
    subprocess.run(["make", "--version"], capture_output=True, check=False)
"""


@pytest.mark.process
def test_what_computes_for_long_or_starts_processes_without_saying_so_fails(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST.format(checks=str(Path(__file__).parent)))
    (tmp_path / "test_them.py").write_text(TESTS)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-rA", "-p", "no:cacheprovider", f"--rootdir={tmp_path}",
         f"--basetemp={tmp_path / 'base'}", str(tmp_path)],
        capture_output=True, text=True, check=False, timeout=600,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
    )  # fmt: skip
    lines = {line.split("::")[-1].split(" - ")[0]: line.split()[0] for line in done.stdout.splitlines() if "::" in line}
    assert lines == {
        "test_that_computes": "FAILED",
        "test_that_may_compute": "PASSED",
        "test_that_waits": "PASSED",
        "test_of_a_child[short]": "PASSED",
        "test_of_a_child[long]": "FAILED",
        "test_that_starts_a_child": "FAILED",
        "test_that_waits_for_no_child": "PASSED",
        "test_that_waits_for_anothers": "PASSED",
        "test_whose_fixture_forks": "ERROR",
        "test_that_asks_a_compiler": "PASSED",
    }, done.stdout
    assert "s of CPU time, expected at most " in done.stdout
    assert "mark it process, or do without" in done.stdout


def test_a_slow_machine_gets_more_seconds_and_a_fast_one_no_fewer(monkeypatch: pytest.MonkeyPatch) -> None:
    for taken_s, factor in ((0.5 * NOMINAL_S, 1.0), (NOMINAL_S, 1.0), (4.0 * NOMINAL_S, 4.0)):
        monkeypatch.setattr(sys.modules[slowness.__module__], "_known_work_s", lambda taken_s=taken_s: taken_s)
        for others, more in ((0.0, 1.0), (100.0, BESIDE)):
            monkeypatch.setattr(os, "getloadavg", lambda others=others: (others * (os.cpu_count() or 1), 0.0, 0.0))
            assert slowness() == pytest.approx(factor * more)
    assert LIMIT_S == 3.0


def test_what_is_left_is_named_with_the_test_after_which_it_was_first_seen(tmp_path: Path) -> None:
    leftovers = Leftovers(tmp_path)
    (tmp_path / "kept").mkdir()
    leftovers.look("first")
    (tmp_path / "gone").mkdir()
    leftovers.look("second")
    (tmp_path / "gone").rmdir()
    (tmp_path / ".ses").write_text("not ours")
    leftovers.look("third")
    assert leftovers.left() == ["kept, first seen after first"]
