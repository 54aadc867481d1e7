"""The same shards on a Dask cluster: a worker that dies costs its shard once more, and changes nothing.

A job is plain values and its result plain arrays, so workers need this package and no shared disk. Dask's own nanny
holds BLAS to one thread, as :mod:`eitskin_sim.dataset.generate` does for its processes.
"""

from collections.abc import Iterator
from typing import Any, Final

from eitskin_proto.errors import SkinError
from eitskin_sim.dataset.shards import Arrays, make_shard

CONNECT_S: Final = 10.0
"""How long a scheduler may take to answer."""

Made = tuple[list[int], list[Arrays]]
"""Numbers of deformations, and what the file of each holds."""


def shards_on_cluster(jobs: list[dict[str, Any]], scheduler: str) -> Iterator[Made]:
    """Yield every job's shard as the cluster makes it.

    Args:
        jobs: What :func:`eitskin_sim.dataset.shards.shard_job` returns.
        scheduler: The scheduler's address, such as "tcp://10.0.0.1:8786".

    Raises:
        SkinError: Dask is not installed, or no scheduler answers there.
    """
    try:
        from distributed import Client, as_completed  # noqa: PLC0415 - only those who have a cluster need it
    except ModuleNotFoundError as error:
        raise SkinError("--scheduler needs Dask; install it with: pip install 'eitskin[cluster]'") from error
    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise SkinError(f"no Dask scheduler answers at {scheduler}: {error}; start one with: dask scheduler") from error
    with client, client.as_current():
        futures = {client.submit(make_shard, job, pure=False, retries=3): job["deformations"] for job in jobs}
        arriving = as_completed(list(futures), with_results=True)  # type: ignore[no-untyped-call]
        for future, arrays in arriving:
            yield futures[future], arrays
            future.release()
