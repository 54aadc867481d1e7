"""Archives that are whole, cut off, damaged, or that lie about their sizes."""

import io
import zipfile

import numpy as np
import pytest

from eitskin_proto.files.archive import BadArchiveError, members

CONTENT = {"a.txt": b"hello", "folder/b.bin": bytes(range(256)) * 40, "empty": b""}


def archive(method=zipfile.ZIP_STORED, comment=b""):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as file:
        for name, data in CONTENT.items():
            file.writestr(name, data)
        file.comment = comment
    return stream.getvalue()


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
@pytest.mark.parametrize("comment", [b"", b"PK\5\6 is how an end begins"[4:], b"x" * 65535])
def test_what_zipfile_writes_is_read_back(method, comment):
    found = members(archive(method, comment))
    assert {name: member.read(20_000) for name, member in found.items()} == CONTENT


def test_a_member_is_not_read_beyond_its_bound():
    with pytest.raises(BadArchiveError, match="has 10240 bytes by its header, expected at most 10239"):
        members(archive())["folder/b.bin"].read(10_239)


def test_a_deflated_member_that_is_longer_than_it_claims_is_damaged_and_takes_no_memory():
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("bomb", bytes(50_000_000))
    lying = stream.getvalue().replace((50_000_000).to_bytes(4, "little"), (100).to_bytes(4, "little"))
    with pytest.raises(BadArchiveError, match="bomb is damaged"):
        members(lying)["bomb"].read(1000)


def test_every_shortened_and_every_damaged_archive_is_an_error_of_this_kind_or_reads_the_same():
    whole = archive(zipfile.ZIP_DEFLATED)
    rng = np.random.default_rng(0)
    variants = [whole[:length] for length in range(len(whole))]
    for _ in range(2000):
        damaged = bytearray(whole)
        damaged[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        variants.append(bytes(damaged))
    refused = 0
    for data in variants:
        try:
            content = {name: member.read(20_000) for name, member in members(data).items()}
        except BadArchiveError:
            refused += 1
        else:
            assert set(content.values()) <= set(CONTENT.values())  # names and dates have no check in a ZIP file
    assert refused > len(whole)
