"""A test that starts a process says so by the marker ``process``; compilers and what asks for libraries do not count.

The marker is what keeps ``make test-quick`` free of processes, so it is checked and not trusted.
"""

import multiprocessing.util
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

NOT_COUNTED: Final = frozenset({"make", "cc", "gcc", "nm", "ld", "ldconfig", "objdump", "lscpu", "fc-list"})
"""The C core is built once and loaded into the test's own process; ctypes looks for libraries with such programs,
numpy.testing before 2.0 asks lscpu for the processor, and the first picture that matplotlib draws for somebody asks
fc-list for the fonts."""

_started: list[str] = []


def _note(program: str) -> None:
    if Path(program).name not in NOT_COUNTED:
        _started.append(program)


def _heard(event: str, arguments: tuple[Any, ...]) -> None:
    if event in ("subprocess.Popen", "os.posix_spawn"):
        _note(str(arguments[0]))
    elif event in ("os.fork", "os.forkpty", "os.system"):
        _note(event)


def _listen() -> None:
    """Hear of every start from now on; Python has no way to stop listening."""
    sys.addaudithook(_heard)
    spawn = multiprocessing.util.spawnv_passfds

    def noted(path: Any, *rest: Any) -> int:
        _note(str(path))
        return spawn(path, *rest)

    multiprocessing.util.spawnv_passfds = noted


class StartedProcesses:
    """Plugin that fails a test which started a process and is not marked so."""

    def __init__(self) -> None:
        _listen()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """Look at the fixtures."""
        yield from _looked_at(item)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Look at the test."""
        yield from _looked_at(item)


def _looked_at(item: pytest.Item) -> Iterator[None]:
    _started.clear()
    yield
    if _started and item.get_closest_marker("process") is None:
        pytest.fail(
            f"started {_started[0]}, which only tests with the marker process may: mark it process, or do without",
            pytrace=False,
        )
