"""A Dask cluster over TLS, a real one with certificates made here: nobody works for or with one it cannot trust."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from eitskin_proto.errors import SkinError
from eitskin_sim.dataset import cluster as cluster_module
from eitskin_sim.dataset.cluster import Certificates
from eitskin_sim.dataset.generate import generate
from eitskin_sim.dataset.plan import make_plan
from eitskin_tools import cli

# Dask warns, and a warning is an error, where a busy disk takes a second for a folder.
pytestmark = pytest.mark.filterwarnings("ignore:Creating scratch directories is taking")

PLAN = make_plan("paper", 0, deformations=1, touch_sets=10, kept=0)
FILES = ("deformation-0000.npz", "index.json", "plan.json", "touches.npz")

Named = Callable[[str], Certificates]


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Named:
    """Make an authority of a name, with a certificate that it signed."""
    if shutil.which("openssl") is None:
        pytest.skip("needs the program openssl, which makes the certificates")

    def make(name: str) -> Certificates:
        folder = tmp_path_factory.mktemp(name)
        new = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
        signs = ("-addext", "basicConstraints=critical,CA:TRUE", "-addext", "keyUsage=critical,keyCertSign")
        files = ("-keyout", "ca.key", "-out", "ca.pem")
        subprocess.run(
            ["openssl", "req", "-x509", *new, "-subj", f"/CN={name}", *signs, *files],
            cwd=folder,
            check=True,
            capture_output=True,
        )
        signed = ("-CA", "ca.pem", "-CAkey", "ca.key", "-addext", "basicConstraints=critical,CA:FALSE")
        files = ("-keyout", "own.key", "-out", "own.pem")
        subprocess.run(
            ["openssl", "req", "-x509", *new, "-subj", "/CN=someone", *signed, *files],
            cwd=folder,
            check=True,
            capture_output=True,
        )
        return Certificates(folder / "ca.pem", folder / "own.pem", folder / "own.key")

    return make


@pytest.fixture(scope="module")
def ours(authority: Named) -> Certificates:
    return authority("ours")


@pytest.fixture(scope="module")
def theirs(authority: Named) -> Certificates:
    return authority("theirs")


@pytest.fixture(scope="module")
def scheduler(ours: Certificates, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a cluster of one worker that shows our authority's certificates, and asks for them."""
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    from dask import config
    from distributed.security import Security

    scratch = tmp_path_factory.mktemp("scratch")
    pairs: dict[str, Any] = {"tls_ca_file": str(ours.ca), "require_encryption": True}
    for role in ("scheduler", "worker", "client"):
        pairs |= {f"tls_{role}_cert": str(ours.cert), f"tls_{role}_key": str(ours.key)}
    with (
        config.set(temporary_directory=str(scratch)),
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, protocol="tls://", security=Security(**pairs),
            dashboard_address=None, local_directory=scratch,
        ) as running,
    ):  # fmt: skip
        assert running.scheduler_address.startswith("tls://")
        yield running.scheduler_address


def words(folder: Path, scheduler: str, found: Certificates) -> list[str]:
    """Return a command line."""
    options = [word for name in found.given for word in (f"--tls-{name}", str(getattr(found, name)))]
    sizes = ["--bends", "1", "--touch-sets", "10", "--kept", "0"]
    return ["dataset", "--set", "paper", *sizes, "--out", str(folder), "--scheduler", scheduler, *options]


@pytest.fixture(scope="module")
def made_here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the same data set, made in this process."""
    folder = tmp_path_factory.mktemp("data") / "here"
    generate(PLAN, folder, workers=0)
    return folder


@pytest.mark.slow
@pytest.mark.process
def test_a_cluster_that_both_sides_vouch_for_makes_the_same_files(
    scheduler: str, ours: Certificates, made_here: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words(tmp_path / "there", scheduler, ours)) == 0
    assert "warning" not in capsys.readouterr().err
    for name in FILES:
        assert (tmp_path / "there" / name).read_bytes() == (made_here / name).read_bytes(), name


@pytest.mark.heavy
@pytest.mark.process
def test_who_shows_another_authoritys_certificate_gets_no_answer(
    scheduler: str, ours: Certificates, theirs: Certificates, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 1.0)
    stranger = Certificates(ours.ca, theirs.cert, theirs.key)  # the scheduler sees that it is not one of its own
    misled = Certificates(theirs.ca, ours.cert, ours.key)  # the user sees that the scheduler is not theirs
    for number, found in enumerate((stranger, misled, theirs)):
        with pytest.raises(SkinError, match=r"^no Dask scheduler answers at tls://.*same authority vouch for both\?$"):
            generate(PLAN, tmp_path / str(number), scheduler=scheduler, certificates=found)
        assert not (tmp_path / str(number) / "index.json").exists()


@pytest.mark.process
def test_certificates_that_are_none_are_named_before_anybody_is_called(
    ours: Certificates, theirs: Certificates, tmp_path: Path
) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    empty = tmp_path / "empty.pem"
    empty.touch()
    for found in (
        Certificates(tmp_path / "nowhere", ours.cert, ours.key),
        Certificates(empty, ours.cert, ours.key),
        Certificates(ours.ca, ours.cert, theirs.key),
        Certificates(ours.ca, ours.key, ours.cert),
    ):
        with pytest.raises(SkinError, match=r"^the certificates [^\n]* cannot be used: [^\n]+$"):
            generate(PLAN, tmp_path / "d", scheduler="tls://127.0.0.1:9", certificates=found)


@pytest.mark.parametrize(
    ("given", "missing"),
    [([], "--tls-ca, --tls-cert, --tls-key"), (["cert", "key"], "--tls-ca"), (["ca"], "--tls-cert")],
)
def test_tls_without_certificates_is_refused_in_one_line(
    given: list[str], missing: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    found = Certificates(**{name: tmp_path / name for name in given})
    assert cli.main(words(tmp_path / "d", "tls://127.0.0.1:9", found)) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"a scheduler at tls:// needs certificates: {missing}" in said
