"""The same shards on a Dask cluster: a worker that dies costs its shard once more, and changes nothing.

A job is plain values and its result plain arrays, so workers need this package and no shared disk. Dask's own nanny
holds BLAS to one thread, as :mod:`eitskin_sim.dataset.generate` does for its processes.

Dask sends everything as pickles: a scheduler and its workers run the code that they are sent, and their answers are
unpickled here. ``tcp://`` does not authenticate them. With ``tls://`` both sides show a certificate of the same
authority; names in certificates are not checked, so the authority must be the cluster's own.
"""

import ipaddress
import ssl
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from eitskin_proto.errors import SkinError
from eitskin_sim.dataset.shards import Arrays, make_shard

CONNECT_S: Final = 10.0
"""How long a scheduler may take to answer."""

SCHEMES: Final = ("tcp", "tls")
"""How an address may begin."""

Made = tuple[list[int], list[Arrays]]
"""Numbers of deformations, and what the file of each holds."""


@dataclass(frozen=True, slots=True)
class Certificates:
    """Files by which a cluster and its user know each other; what is None comes from Dask's own configuration."""

    ca: Path | None = None
    """The authority's certificate."""
    cert: Path | None = None
    """The user's certificate, which the authority signed."""
    key: Path | None = None
    """Its private key."""

    @property
    def given(self) -> list[str]:
        """Names of those that are not None."""
        return [field.name for field in fields(self) if getattr(self, field.name) is not None]


def check_address(scheduler: str) -> None:
    """Refuse what is no address of a scheduler.

    Raises:
        ValueError: It does not begin with tcp:// or tls://, or names no host and port.
    """
    try:
        parts = urlsplit(scheduler)
        sound = parts.scheme in SCHEMES and parts.hostname and parts.port
    except ValueError:  # a port that is no number
        sound = False
    if not sound:
        raise ValueError(
            f"--scheduler is {scheduler!r}; expected tls://HOST:PORT or tcp://HOST:PORT, usually with port 8786"
        )


def is_exposed(scheduler: str) -> bool:
    """Return whether others may be there, or on the way: ``tcp://`` to anything but a loopback address."""
    parts = urlsplit(scheduler)
    try:
        return parts.scheme != "tls" and not ipaddress.ip_address(parts.hostname or "").is_loopback
    except ValueError:
        return parts.scheme != "tls"  # a name may point anywhere


def shards_on_cluster(
    jobs: list[dict[str, Any]], scheduler: str, certificates: Certificates | None = None
) -> Iterator[Made]:
    """Yield every job's shard as the cluster makes it.

    Args:
        jobs: What :func:`eitskin_sim.dataset.shards.shard_job` returns.
        scheduler: The scheduler's address, such as "tls://10.0.0.1:8786".
        certificates: For ``tls://``; None takes those of Dask's own configuration.

    Raises:
        SkinError: Dask is not installed, no scheduler answers there, or the certificates are missing or useless.
        ValueError: The address is none.
    """
    check_address(scheduler)
    try:
        from distributed import Client, as_completed  # noqa: PLC0415 - only those who have a cluster need it
    except ModuleNotFoundError as error:
        raise SkinError("--scheduler needs Dask; install it with: pip install 'eitskin[cluster]'") from error
    options = {"security": _security(certificates or Certificates())} if scheduler.startswith("tls://") else {}
    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False, **options)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        hint = "; does the same authority vouch for both?" if options else "; start one with: dask scheduler"
        raise SkinError(f"no Dask scheduler answers at {scheduler}: {_first_line(error)}{hint}") from error
    with client, client.as_current():
        futures = {client.submit(make_shard, job, pure=False, retries=3): job["deformations"] for job in jobs}
        arriving = as_completed(list(futures), with_results=True)  # type: ignore[no-untyped-call]
        for future, arrays in arriving:
            yield futures[future], arrays
            future.release()


def _security(certificates: Certificates) -> Any:
    """Return Dask's settings for ``tls://``, with which a connection can be made.

    Raises:
        SkinError: A file is named neither here nor in Dask's configuration, or cannot be used.
    """
    from distributed.security import Security  # noqa: PLC0415 - as above

    settings = {"ca": "tls_ca_file", "cert": "tls_client_cert", "key": "tls_client_key"}
    given = {settings[name]: str(getattr(certificates, name)) for name in certificates.given}
    security = Security(require_encryption=True, **given)  # type: ignore[no-untyped-call]
    missing = [f"--tls-{name}" for name, setting in settings.items() if getattr(security, setting) is None]
    if missing:
        raise SkinError(
            f"a scheduler at tls:// needs certificates: {', '.join(missing)} missing, here and in Dask's own "
            "configuration (distributed.comm.tls)"
        )
    try:
        security.get_connection_args("client")  # type: ignore[no-untyped-call]
    except (OSError, ssl.SSLError) as error:
        files = ", ".join(str(getattr(security, setting)) for setting in settings.values())
        raise SkinError(f"the certificates {files} cannot be used: {_first_line(error)}") from error
    return security


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0]
