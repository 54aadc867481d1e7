"""A run's folder: one process at a time writes there, and what the disk does not take is no epoch."""

import json
import resource
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.training.test_train import tiny

from eitskin_proto.errors import SkinError
from eitskin_training import run_files, train

pytestmark = pytest.mark.heavy


def test_a_run_has_its_folder_for_itself(toy_data: Any, tmp_path: Path) -> None:
    data, tried = toy_data("area"), []

    def beside(now: train.Progress) -> None:
        if now.finished and now.epoch == 1:  # from here on its first epoch's weights would take the best ones' place
            with pytest.raises(SkinError, match=r"is in use: another process trains there; wait until it has ended"):
                train.train(data, tiny(epochs=2), tmp_path, resume=True)
            tried.append(now)

    train.train(data, tiny(epochs=2), tmp_path, progress=beside)
    assert len(tried) == 1
    train.train(data, tiny(epochs=2), tmp_path, resume=True)


def test_a_file_that_the_disk_does_not_take_is_an_error_of_the_disk(tmp_path: Path) -> None:
    path, (soft, hard) = tmp_path / "checkpoint.pt", resource.getrlimit(resource.RLIMIT_FSIZE)
    run_files.write_file(path, {"weights": torch.zeros(10)})
    before = path.read_bytes()
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(OSError, match=r"checkpoint\.pt"):
            run_files.write_file(path, {"weights": torch.zeros(10_000)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"checkpoint.pt": before}


def test_where_the_disk_is_full_no_epoch_counts_of_which_a_file_is_missing(toy_data: Any, tmp_path: Path) -> None:
    data = toy_data("area")
    (tmp_path / "history.json").mkdir()  # cannot be replaced
    with pytest.raises(SkinError, match=r"history\.json is a folder"):
        train.train(data, tiny(epochs=1), tmp_path)
    (tmp_path / "history.json").rmdir()
    train.train(data, tiny(epochs=1), tmp_path, resume=True)
    assert [epoch["number"] for epoch in json.loads((tmp_path / "history.json").read_text())] == [1]
