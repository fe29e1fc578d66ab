"""A store on S3 with failing requests: nothing is lost."""

import pyarrow as pa
import pytest
from contents import failures, labels, weights

from benches.common.bad_weather import FAULTS, BadWeather
from slgaussian.errors import InputError
from slgaussian.storage import remote
from slgaussian.storage import store as storing
from slgaussian.storage.housekeeping import collect
from slgaussian.storage.records import Records
from slgaussian.storage.store import ArtifactStore, DamagedError

s3fs = pytest.importorskip("s3fs")

KEY = f"masks/v1/{'0' * 64}"


@pytest.fixture
def weather(bucket, s3_server, monkeypatch):
    """Return a function that starts a faulty proxy before a bucket, and a store without copies."""
    proxies = []

    def begin(share: float, *faults: str, **more) -> tuple[BadWeather, ArtifactStore]:
        proxy = BadWeather(s3_server, share, hang=3.0, faults=faults or FAULTS, **more)
        proxies.append(proxy)
        monkeypatch.setenv("AWS_ENDPOINT_URL", proxy.url)
        s3fs.S3FileSystem.clear_instance_cache()
        return proxy, ArtifactStore(f"{bucket}/slg")

    monkeypatch.setenv("SLGAUSSIAN_CACHE_SIZE", "0")
    monkeypatch.setattr(remote, "READ_TIMEOUT", 2)
    yield begin
    for proxy in proxies:
        proxy.close()
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_passes(weather, fault, monkeypatch):
    monkeypatch.setattr(storing, "UPLOAD_PART_BYTES", 5 * 2**20)  # the least that S3 takes
    proxy, store = weather(0.1 if fault == "time-out" else 0.33, fault)
    refs = [store.put("labels", labels(value)) for value in range(3)]
    refs.append(store.put("failures", failures("a", "b")))
    store.put("weights", content := weights(11 * 2**20))  # in parts
    for ref in refs:
        Records(store).keep(KEY, ref)
        assert Records(store).find(KEY) == ref
    assert [store.get(ref)["labels"].max() for ref in refs[:3]] == [0, 1, 2]
    assert isinstance(store.get(refs[3]), pa.Table)
    big = store.put("weights", content)
    assert (store.get(big)["safetensors"] == content["safetensors"]).all()
    uris = {file.uri for files in store.walk() for file in files}
    assert uris == {*(ref.uri for ref in refs), big.uri, f"keys/masks/v1/00/{'0' * 64}.json"}
    store.remove([big.uri])
    with pytest.raises(DamagedError, match="found nothing"):
        store.check(big)
    assert proxy.met[fault] >= 3


def test_upkeep_takes_nothing_for_garbage_that_was_cut_on_the_way(weather):
    proxy, store = weather(0.2, "less than said")
    for value in range(12):
        ref = store.put("labels", labels(value))
        Records(store).keep(KEY.replace("0", f"{value:x}"), ref)
    swept = collect(store, -1e9, {"masks": 1}, delete=True)
    assert (swept.artifacts, swept.records, swept.kept) == (0, 0, 12)
    assert proxy.met["less than said"] >= 5


def test_a_server_without_room_and_one_that_always_fails_are_one_sentence(weather, monkeypatch):
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "2")
    proxy, store = weather(0.0)
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
    assert proxy.met["503 slow down"] == 2
