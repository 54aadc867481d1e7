"""Writes a data set: shards by worker processes or a Dask cluster, each file whole or not there, resumable.

``plan.json`` is written first, a file a shard as it comes, ``index.json`` last. A second call with the same plan
keeps the shards that are there and makes the rest; with another plan it refuses. Every file is written beside its
place and renamed.
"""

import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_proto.files.arrays import pack_arrays
from eitskin_proto.files.digest import id_of, sha256_of
from eitskin_proto.files.reading import FileError, read_bytes
from eitskin_proto.files.writing import is_empty, write_bytes
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.toml import to_toml
from eitskin_sim.dataset.cluster import Certificates, Made, shards_on_cluster
from eitskin_sim.dataset.index import FORMAT, HINT, VERSION, VERSION_OF_SOFT
from eitskin_sim.dataset.plan import Plan
from eitskin_sim.dataset.reader import LARGEST_FILE
from eitskin_sim.dataset.shards import make_shard, shard_job, touches_file

Progress = Callable[[int, int], None]
"""Called with samples done and samples in all."""

ONE_THREAD: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that hold BLAS to one thread."""


class DataSetError(SkinError):
    """A folder that cannot take the data set."""


def generate(
    plan: Plan,
    folder: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    certificates: Certificates | None = None,
    progress: Progress = lambda done, total: None,
) -> dict[str, Any]:
    """Write a data set, or resume one, and return its index.

    Args:
        plan: The plan of the data set.
        folder: Where to; made if it is not there.
        workers: Processes on this machine; 0 computes in this one.
        scheduler: Address of a Dask scheduler that makes the shards instead, such as "tls://10.0.0.1:8786".
        certificates: For a scheduler at ``tls://``; None takes those of Dask's own configuration.
        progress: Called after every shard.

    Raises:
        DataSetError: The folder holds another data set.
        SkinError: The scheduler cannot be reached, or its certificates are missing or useless; a worker was ended.
        ValueError: ``workers`` is negative, or the scheduler's address is none.
    """
    if workers < 0:
        raise ValueError(f"workers is {workers}; it must be at least 0")
    out = Path(folder)
    _claim(plan, out)
    names = [f"deformation-{number:04d}.npz" for number in range(len(plan.bends))]
    counts = list(plan.counts)
    missing = {number for number, name in enumerate(names) if not _is_whole(out / name)}
    done = sum(counts) - sum(counts[number] for number in missing)
    progress(done, sum(counts))
    together = [[number for number in shard if number in missing] for shard in plan.shards()]
    jobs = [shard_job(plan, shard) for shard in together if shard]
    for numbers, files in _run(jobs, workers, scheduler, certificates):
        for number, arrays in zip(numbers, files, strict=True):
            write_bytes(out / names[number], pack_arrays(arrays))
            done += counts[number]
        progress(done, sum(counts))
    if not _is_whole(out / "touches.npz"):
        write_bytes(out / "touches.npz", pack_arrays(touches_file(plan)))
    index = _index(plan, out, names, counts)
    write_bytes(out / "index.json", json.dumps(index, indent=1).encode())
    return index


def _claim(plan: Plan, out: Path) -> None:
    path = out / "plan.json"
    content = json.dumps({"digest": plan.digest, **plan.to_json()}).encode()
    if path.exists():
        try:
            same = read_bytes(path, len(content)) == content
        except FileError:
            same = False
        if not same:
            raise DataSetError(
                f"{out} holds another data set, or one of another version: name a new folder with --out, or remove "
                "that one"
            )
        return
    if out.exists() and not is_empty(out):
        raise DataSetError(f"{out} is not empty and is not a data set: name a new folder with --out")
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content)


def _run(
    jobs: list[dict[str, Any]], workers: int, scheduler: str | None, certificates: Certificates | None
) -> Iterator[Made]:
    """Yield shards as they come."""
    if not jobs:
        return
    if scheduler is not None:
        yield from shards_on_cluster(jobs, scheduler, certificates)
    elif workers == 0:
        for job in jobs:
            yield job["deformations"], make_shard(job)
    else:
        yield from _in_processes(jobs, min(workers, len(jobs)))


def _in_processes(jobs: list[dict[str, Any]], workers: int) -> Iterator[Made]:
    with processes(workers) as pool:
        waiting = {pool.submit(make_shard, job): job["deformations"] for job in jobs}
        for future in as_completed(list(waiting)):
            yield waiting.pop(future), future.result()


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Give processes that compute with one thread each, and end with this one.

    Raises:
        SkinError: One was ended from outside.
    """
    context, others = multiprocessing.get_context("spawn"), multiprocessing.active_children()
    with _one_thread(), ProcessPoolExecutor(workers, mp_context=context, initializer=_follow_parent) as pool:
        try:
            yield pool
        except BrokenProcessPool as error:
            raise SkinError(
                "a worker process was killed, usually because memory ran out; the same command resumes, with fewer "
                "--workers it needs less"
            ) from error
        except BaseException:  # their unfinished work is not needed, and may last minutes
            for worker in set(multiprocessing.active_children()).difference(others):
                worker.terminate()
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _follow_parent() -> None:
    """End this worker when its parent process ends, however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches it too, but its parent ends it

    def follow() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that start meanwhile see BLAS held to one thread."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _is_whole(path: Path) -> bool:
    """Return whether a file is there; it was renamed into place, so then it is whole."""
    return path.exists()


def _index(plan: Plan, out: Path, names: list[str], counts: list[int]) -> dict[str, Any]:
    def entry(name: str) -> dict[str, Any]:
        return {"file": name, "sha256": sha256_of(read_bytes(out / name, LARGEST_FILE))}

    touches = entry("touches.npz")
    content = plan.to_json()
    deformations = [
        {**entry(name), "samples": count, "split": split, "bend": bend}
        for name, count, split, bend in zip(names, counts, plan.splits, content["bends"], strict=True)
    ]
    whole = "".join([touches["sha256"], *(d["sha256"] for d in deformations), PROTOCOL_ID, plan.skin.grid_id])
    found: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION if plan.touches == "hard" else VERSION_OF_SOFT,
        "protocol_id": PROTOCOL_ID,
        "grid_id": plan.skin.grid_id,
        "skin_digest": plan.skin.digest,
        "skin": to_toml(plan.skin),
        "set": plan.set_name,
        "labels": "area" if plan.set_name == "free" else "units",
        "seed": plan.seed,
        "plan": plan.digest,
        "samples": sum(counts),
        "touch_sets": plan.touch_sets,
        "made_again_by": HINT,
        "digest": id_of(whole.encode()),
        "touches": touches,
        "deformations": deformations,
    }
    if plan.touches != "hard":
        found["touch_kind"] = plan.touches
    if plan.devices != "ideal":
        found["devices"] = plan.devices
    return found
