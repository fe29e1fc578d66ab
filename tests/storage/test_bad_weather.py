"""A store on S3 behind a proxy that fails requests: retries lose and damage nothing."""

import pyarrow as pa
import pytest
from contents import failures, labels, weights

from benches.common.bad_weather import FAULTS, BadWeather
from slgaussian.errors import InputError
from slgaussian.storage import remote
from slgaussian.storage import store as store_module
from slgaussian.storage.housekeeping import collect
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore, DamagedError

s3fs = pytest.importorskip("s3fs")

KEY = f"masks/v1/{'0' * 64}"


@pytest.fixture
def faulty_store(bucket, s3_server, monkeypatch):
    """Start a faulty proxy before the server of a bucket; return it and a store without copies."""
    proxies = []

    def start(share: float, *faults: str) -> tuple[BadWeather, ArtifactStore]:
        proxies.append(BadWeather(s3_server, share, hang=2.5, faults=faults or FAULTS))
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxies[-1].url)
        s3fs.S3FileSystem.clear_instance_cache()
        return proxies[-1], ArtifactStore(f"{bucket}/slg")

    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")
    monkeypatch.setattr(remote, "READ_TIMEOUT", 1.5)
    # The number of retries stays; botocore waits 0 to 16 s before each.
    monkeypatch.setattr("botocore.retryhandler.delay_exponential", lambda **_: 0.01)
    yield start
    for proxy in proxies:
        proxy.close()
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.mark.parametrize("fault", FAULTS)
def test_store_survives_fault(faulty_store, fault, monkeypatch):
    monkeypatch.setattr(store_module, "UPLOAD_PART_BYTES", 5 * 2**20)  # the least that S3 accepts
    proxy, store = faulty_store(0.1 if fault == "time-out" else 0.33, fault)
    refs = [store.put("labels", labels(value)) for value in range(3)]
    refs.append(store.put("failures", failures("a", "b")))
    store.put("weights", content := weights(11 * 2**20))  # in parts
    for ref in refs:
        Records(store).keep(KEY, ref)
        assert Records(store).find(KEY) == ref
    assert [store.get(ref)["labels"].max() for ref in refs[:3]] == [0, 1, 2]
    assert isinstance(store.get(refs[3]), pa.Table)
    large = store.put("weights", content)
    assert (store.get(large)["safetensors"] == content["safetensors"]).all()
    uris = {file.uri for files in store.walk() for file in files}
    assert uris == {*(ref.uri for ref in refs), large.uri, f"keys/masks/v1/00/{'0' * 64}.json"}
    store.remove([large.uri])
    with pytest.raises(DamagedError, match="found nothing"):
        store.check(large)
    assert proxy.met[fault] >= 3


def test_truncated_answers_do_not_make_housekeeping_delete(faulty_store):
    proxy, store = faulty_store(0.2, "less than said")
    for value in range(12):
        ref = store.put("labels", labels(value))
        Records(store).keep(KEY.replace("0", f"{value:x}"), ref)
    deleted = collect(store, -1e9, {"masks": 1}, delete=True)
    assert (deleted.artifacts, deleted.records, deleted.kept) == (0, 0, 12)
    assert proxy.met["less than said"] >= 5


def test_store_error_explains_full_or_failing_server(faulty_store, monkeypatch):
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "2")
    proxy, store = faulty_store(0.0)
    proxy.full = True
    with pytest.raises(InputError, match=r"cannot write there \(.*no room"):
        store.put("labels", labels())
    proxy.full = False
    ref = store.put("labels", labels())
    proxy.share, proxy.faults = 1.0, ("503 slow down",)
    with pytest.raises(
        InputError, match=r"cannot read there \((Service Unavailable|.*request rate)"
    ):
        store.get(ref)
    assert proxy.met["503 slow down"] == 10  # two attempts of botocore in each of five of s3fs
