"""Puts memory in use on large pages, where the kernel does that on request (Linux 6.1).

A frame reads a few hundred kB in a hundred places: weights, code objects, arrays. Between two frames other programs
use the processor and replace its cached page table entries. With pages of 4 kB each place then costs a walk of the page
tables; with pages of 2 MB a few walks serve all. A large page is requested only where most of it is in use already: the
stack of a thread uses a few kB of many, and would become resident as a whole.
"""

import ctypes
import mmap
from pathlib import Path
from typing import Final

MADV_COLLAPSE: Final = 25

MAPS: Final = Path("/proc/self/maps")
IN_USE: Final = 0.75
"""Share of a large page that is resident already, at least."""

SIZE: Final = Path("/sys/kernel/mm/transparent_hugepage/hpage_pmd_size")


def use_large_pages() -> int:
    """Ask for large pages under this process's own memory, and return how many bytes have them.

    Later memory has small pages. Returns 0 if the kernel cannot, refuses, or is another one.
    """
    try:
        size, lines = int(SIZE.read_text()), MAPS.read_text().splitlines()
        libc = ctypes.CDLL(None)
        advise, resident = libc.madvise, libc.mincore
    except (OSError, ValueError, AttributeError):
        return 0
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    resident.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_char_p)
    pages = ctypes.create_string_buffer(size // mmap.PAGESIZE)
    got = 0
    for line in lines:
        span, access, _, _, inode, *name = line.split(maxsplit=5)
        if access != "rw-p" or inode != "0" or (name and name[0] != "[heap]"):
            continue
        begin, end = (int(at, 16) for at in span.split("-"))
        for at in range(-(-begin // size) * size, end - size + 1, size):
            used = resident(at, size, pages) == 0 and sum(byte & 1 for byte in pages.raw) >= IN_USE * len(pages)
            got += size * (used and advise(at, size, MADV_COLLAPSE) == 0)
    return got
