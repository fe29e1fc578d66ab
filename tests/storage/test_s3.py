"""A store on a real S3 server (moto): missing rights, no network, killed writers."""

import errno
import urllib.request
from collections import Counter

import pytest
from contents import labels

from slgaussian.errors import InputError, SpecError
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore

s3fs = pytest.importorskip("s3fs")


@pytest.fixture
def store(bucket):
    return ArtifactStore(f"{bucket}/slg")


@pytest.fixture
def fresh():
    """File systems made in the test know nothing of those made before, nor those after of them."""
    s3fs.S3FileSystem.clear_instance_cache()
    yield
    s3fs.S3FileSystem.clear_instance_cache()


def names(store: ArtifactStore) -> list[str]:
    return [file.uri for files in store.walk() for file in files]


def test_store_sees_files_of_another_process_at_once(store, bucket):
    other = ArtifactStore(f"{bucket}/slg")
    assert names(store) == []
    ref = other.put("labels", labels())
    assert names(store) == [ref.uri]
    store.check(ref)
    other.remove([ref.uri])
    with pytest.raises(SpecError, match="found nothing"):
        store.check(ref)


def test_get_reads_local_copy_unless_it_is_damaged(store):
    ref = store.put("labels", labels())
    copy = store.cache.folder / ref.uri
    store.fs.rm_file(f"{store.path}/{ref.uri}")
    assert store.get(ref)["labels"].max() == 3
    with pytest.raises(SpecError, match="found nothing"):
        store.check(ref)  # another machine would not find it
    store.put("labels", labels())
    copy.write_bytes(b"damaged")
    assert store.get(ref)["labels"].max() == 3
    assert copy.read_bytes() == store.read(ref.uri)
    copy.unlink()
    store.get(ref)
    assert copy.exists()


def test_write_never_creates_a_bucket(bucket):
    with pytest.raises(InputError, match=r"cannot write there \(.*bucket"):
        ArtifactStore("s3://slg-not-there/slg").check_writable()
    assert not s3fs.S3FileSystem(use_listings_cache=False).exists("slg-not-there")


def test_missing_credentials_error_says_where_to_set_them(bucket, fresh, monkeypatch):
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    with pytest.raises(InputError, match=r"the credentials .AWS_ACCESS_KEY_ID and"):
        ArtifactStore(bucket).check_writable()


def test_wrong_credentials_error_does_not_repeat_them(bucket, fresh, s3_server):
    def guard(unchecked: str) -> None:
        place, plain = f"{s3_server}/moto-api/reset-auth", {"Content-Type": "text/plain"}
        queries = urllib.request.Request(place, unchecked.encode(), plain)
        urllib.request.urlopen(queries).close()

    guard("0")
    try:
        with pytest.raises(InputError, match=r"check .*the credentials") as error:
            ArtifactStore(bucket).check_writable()
        assert "AKIAEXAMPLE" not in str(error.value)
        assert "not/a+secret" not in str(error.value)
        with pytest.raises(InputError, match="cannot read there"):
            Records(ArtifactStore(bucket)).find(f"masks/v1/{'0' * 64}")
    finally:
        guard("inf")


def test_find_raises_store_error_if_the_server_does_not_answer(bucket, fresh, monkeypatch):
    """Otherwise results would count as lost and be computed again."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://someone:hidden@127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setattr(s3fs.S3FileSystem, "retries", 1)
    with pytest.raises(InputError, match=r"cannot read there .*AWS_ENDPOINT_URL") as error:
        Records(ArtifactStore(bucket)).find(f"masks/v1/{'0' * 64}")
    assert "hidden" not in str(error.value)


def test_cached_stage_makes_two_requests_and_cold_stage_three(store, monkeypatch):
    counts, call = Counter(), s3fs.S3FileSystem._call_s3

    async def count(self, method, *arguments, **named):
        counts[method] += 1
        return await call(self, method, *arguments, **named)

    monkeypatch.setattr(s3fs.S3FileSystem, "_call_s3", count)
    records, key = Records(store), f"masks/v1/{'0' * 64}"
    assert records.find(key) is None
    ref = store.put("labels", labels())
    records.keep(key, ref)
    assert counts == {"get_object": 1, "put_object": 2}
    counts.clear()
    assert records.find(key) == ref
    assert counts == {"get_object": 1, "head_object": 1}


@pytest.mark.parametrize("refused", [False, True])
def test_put_replaces_damaged_file_with_and_without_conditional_writes(store, monkeypatch, refused):
    upload = s3fs.S3FileSystem._pipe_file

    async def refuse(self, *arguments, mode="overwrite", **named):
        if mode == "create":
            raise OSError(errno.ENOSYS, "A header you provided implies functionality ...")
        return await upload(self, *arguments, **named)

    if refused:
        monkeypatch.setattr(s3fs.S3FileSystem, "_pipe_file", refuse)
    ref = store.put("labels", labels())
    whole = store.read(ref.uri)
    store.write(ref.uri, whole[:50])
    assert store.put("labels", labels()) == ref
    assert store.read(ref.uri) == whole
