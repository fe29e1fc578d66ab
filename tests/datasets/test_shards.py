"""Shards: standard tar files of samples, and keys of samples."""

import io
import tarfile

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.datasets.shards import END_OF_ARCHIVE, make_key, pack, unpack

ENDINGS = st.from_regex(r"[a-z][a-z0-9_]{0,20}(\.[a-z]{3,4})?", fullmatch=True)
MEMBERS = st.dictionaries(ENDINGS, st.binary(max_size=2000), min_size=1, max_size=4)


@settings(max_examples=25)
@given(st.dictionaries(st.text(min_size=1, max_size=90), MEMBERS, min_size=1, max_size=3))
def test_packed_samples_are_read_by_unpack_and_tarfile(samples):
    parts = {name: pack(make_key(name), members) for name, members in samples.items()}
    expected = {}
    for name, members in samples.items():
        assert unpack(parts[name]) == members
        assert len(parts[name]) % tarfile.BLOCKSIZE == 0
        expected |= {f"{make_key(name)}.{ending}": data for ending, data in members.items()}
    with tarfile.open(fileobj=io.BytesIO(b"".join(parts.values()) + END_OF_ARCHIVE)) as archive:
        files = {member.name: archive.extractfile(member).read() for member in archive}
    assert files == expected


@given(st.text(min_size=1), st.text(min_size=1))
def test_keys_are_plain_ascii_and_unique(first, second):
    assert not set("./\\ ") & set(make_key(first)) and make_key(first).isascii()
    assert (make_key(first) == make_key(second)) == (first == second)
    assert make_key("office_walk-2") == "office_walk-2"


def test_unpack_refuses_data_other_than_tar():
    with pytest.raises(ValueError):
        unpack(b"no tar file at all" * 100)
