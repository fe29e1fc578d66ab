"""Shards are tar files that anybody reads, and depend on their content alone."""

import io
import tarfile

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slgaussian.datasets.shards import END_OF_ARCHIVE, key_of, pack, unpack

ENDINGS = st.from_regex(r"[a-z][a-z0-9_]{0,20}(\.[a-z]{3,4})?", fullmatch=True)
MEMBERS = st.dictionaries(ENDINGS, st.binary(max_size=2000), min_size=1, max_size=4)


@settings(max_examples=25)
@given(st.dictionaries(st.text(min_size=1, max_size=90), MEMBERS, min_size=1, max_size=3))
def test_what_is_packed_is_unpacked_and_read_by_tarfile(samples):
    parts = {name: pack(key_of(name), members) for name, members in samples.items()}
    for name, members in samples.items():
        assert unpack(parts[name]) == members
        assert len(parts[name]) % tarfile.BLOCKSIZE == 0
    with tarfile.open(fileobj=io.BytesIO(b"".join(parts.values()) + END_OF_ARCHIVE)) as archive:
        found = {about.name: archive.extractfile(about).read() for about in archive}
    assert found == {f"{key_of(n)}.{e}": d for n, own in samples.items() for e, d in own.items()}


@given(st.text(min_size=1), st.text(min_size=1))
def test_keys_have_no_dots_or_folders_and_differ_as_names_do(one, other):
    assert not set("./\\ ") & set(key_of(one)) and key_of(one).isascii()
    assert (key_of(one) == key_of(other)) == (one == other)
    assert key_of("office_walk-2") == "office_walk-2"


def test_what_is_no_tar_file_is_refused():
    with pytest.raises(ValueError):
        unpack(b"no tar file at all" * 100)
