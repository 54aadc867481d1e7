"""Memory on large pages holds what it held, and no system is too odd to be asked."""

import ctypes
import mmap
from pathlib import Path

import pytest

from eitskin.diagnostics import large_pages

BYTES = 8 << 20


@pytest.fixture
def memory():
    with mmap.mmap(-1, BYTES, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as found:
        found.write(bytes(range(256)) * (BYTES // 256))
        yield found


def address(memory):
    """Return where memory begins."""
    return ctypes.addressof(ctypes.c_char.from_buffer(memory))


def huge_kB(begin):
    """Return how much lies on large pages in the area of memory that holds an address."""
    held = False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        name, *values = line.split()
        if not name.endswith(":"):
            low, high = (int(at, 16) for at in name.split("-"))
            held = low <= begin < high
        elif held and name == "AnonHugePages:":
            return int(values[0])
    raise AssertionError(f"no area of memory holds {begin:#x}")


def test_memory_in_use_gets_large_pages_and_keeps_what_it_holds(memory, monkeypatch, tmp_path):
    begin = address(memory)
    maps = tmp_path / "maps"
    maps.write_text(f"{begin:x}-{begin + BYTES:x} rw-p 00000000 00:00 0\n")
    monkeypatch.setattr(large_pages, "MAPS", maps)  # other memory may be given back before it is counted
    got = large_pages.use_large_pages()
    assert memory[:] == bytes(range(256)) * (BYTES // 256)
    if not got:
        pytest.skip("this kernel lays nothing on large pages when asked")
    assert got % int(large_pages.SIZE.read_text()) == 0
    assert 1024 * huge_kB(begin) >= got


@pytest.mark.parametrize("content", [None, "", "many\n"])
def test_a_system_without_them_is_left_alone(monkeypatch, tmp_path, content):
    path = tmp_path / "size"
    if content is not None:
        path.write_text(content)
    monkeypatch.setattr(large_pages, "SIZE", path)
    assert large_pages.use_large_pages() == 0
