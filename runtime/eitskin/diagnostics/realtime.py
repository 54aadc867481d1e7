"""Settings of the process that shorten the tail of latencies; each is requested by name and reports its result.

None of them is on by default and none fails silently: a robot's integrator must know whether SCHED_FIFO was granted.
These settings belong to the whole process, so the library never touches them; the ``run`` command does.
"""

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

MCL_CURRENT: Final = 1
MCL_FUTURE: Final = 2

SWITCH_INTERVAL_S: Final = 5e-4
"""How long another Python thread may hold the interpreter while the frame loop waits for it; the default is 5 ms."""


def schedule_fifo(priority: int) -> str:
    """Request SCHED_FIFO and return the result.

    Raises:
        ValueError: The priority is outside the kernel's range.
    """
    low, high = os.sched_get_priority_min(os.SCHED_FIFO), os.sched_get_priority_max(os.SCHED_FIFO)
    if not low <= priority <= high:
        raise ValueError(f"priority {priority} for SCHED_FIFO is outside {low} to {high}")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return (
            f"SCHED_FIFO {priority}: refused; allow it with 'sudo setcap cap_sys_nice+ep' on the interpreter "
            "or rtprio in /etc/security/limits.conf"
        )
    return f"SCHED_FIFO {priority}: on"


def pin(cpus: Sequence[int]) -> str:
    """Restrict the process to some CPUs and return the result.

    Raises:
        ValueError: A CPU does not exist or is not ours.
    """
    available = os.sched_getaffinity(0)
    missing = sorted(set(cpus) - available)
    if missing or not cpus:
        raise ValueError(f"CPU {missing or 'list is empty'}: expected some of {sorted(available)}")
    os.sched_setaffinity(0, cpus)
    return f"affinity: CPU {', '.join(map(str, sorted(os.sched_getaffinity(0))))}"


def lock_memory() -> str:
    """Lock the process's memory against swapping, and return the result."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        return f"mlockall: refused ({reason}); raise memlock in /etc/security/limits.conf"
    return "mlockall: got"


def more_files() -> str:
    """Allow as many open files as the kernel lets us, and return how many.

    libzmq aborts the process when an ipc listener runs out of descriptors, so clients must not be able to use them up.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 65536 if hard == resource.RLIM_INFINITY else min(hard, 65536)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return f"open files: at most {resource.getrlimit(resource.RLIMIT_NOFILE)[0]}"


def settle() -> None:
    """Take what was made so far out of the garbage collector's rounds, shorten the interpreter's turns, free memory.

    Loading took several MB for a moment, which glibc keeps unless it is asked for them. Code that turned the
    collector off while modules and bundle were loaded has it on again: their garbage is not worth the 30 ms of a round.
    """
    gc.freeze()
    gc.enable()
    with suppress(OSError, AttributeError):  # glibc's alone
        ctypes.CDLL(None).malloc_trim(0)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
