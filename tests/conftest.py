"""Shared by all tests: where real photographs may be found, and how many threads work."""

import logging
import os
import signal
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from flows.runners.environment import prepare
from flows.runners.server import LocalServer
from slgaussian.kernels import threads
from tests.browser import Browser, executable

# Several test processes share the cores; threads that spin while they wait would take them away.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# A shell has what it runs in the background ignore Ctrl-C, and so would the programs of the tests.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No test asserts a wall time, and a deadline is one.
hypothesis.settings.register_profile("shared", deadline=None)
hypothesis.settings.load_profile("shared")


def pytest_configure(config: pytest.Config) -> None:
    """Set the address of the one Prefect server of the tests, before any of them imports Prefect.

    Prefect reads it on import; without it, Prefect would start servers of its own.
    """
    folder = tempfile.TemporaryDirectory(prefix="slg-flows-")
    config.add_cleanup(folder.cleanup)
    os.environ["PREFECT_HOME"] = folder.name  # a worker of pytest-xdist has a server of its own
    prepare(Path(folder.name))
    config.slg_server = LocalServer(Path(folder.name))
    os.environ["PREFECT_API_URL"] = config.slg_server.url
    os.environ["SLGAUSSIAN_NO_EVENTS"] = "1"  # as in a run with a server of its own


WHOLE = {"server", "browser", "s3_server"}
"""What tests ask for that run whole commands: a Prefect server, a browser, a server of buckets."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark those as ``whole``, which `pytest` leaves out and `pytest -m whole` runs."""
    for item in items:
        if WHOLE.intersection(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.whole)


@pytest.fixture(autouse=True, scope="session")
def own_copies(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Use a cache folder of the tests, not the user's."""
    os.environ.setdefault("SLGAUSSIAN_CACHE", str(tmp_path_factory.mktemp("copies")))


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with real photographs, from the environment; tests that need it skip without it."""
    root = os.environ.get("SLG_TEST_DATA")
    if not root or not Path(root).is_dir():
        pytest.skip("SLG_TEST_DATA does not point at a folder with real data")
    return Path(root)


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Run small networks on one thread: more gain little, and cost much on a busy machine."""
    threads.limit(threads.cores())
    yield
    threads.limit()


@pytest.fixture(scope="session")
def server(request: pytest.FixtureRequest) -> Iterator[LocalServer]:
    """The address of a running Prefect server."""
    server = request.config.slg_server
    server.start()
    server.wait()
    yield server
    server.stop()


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A Chromium without a window; tests that need one skip where there is none.

    Unless SLG_NEEDS_BROWSER is set to 1, as where one was installed: then they fail.
    """
    if executable() is None:
        why = "no Chromium on this machine; Debian's package is called chromium"
        if os.environ.get("SLG_NEEDS_BROWSER") == "1":
            pytest.fail(f"SLG_NEEDS_BROWSER=1 and {why}")
        pytest.skip(why)
    with Browser() as running:
        yield running


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """The address of a real S3 server, moto's, on this machine."""
    server = pytest.importorskip("moto.server", reason="needs moto and flask: the extra `test`")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    running = server.ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    running.start()
    yield "http://{}:{}".format(*running.get_host_and_port())
    running.stop()


@pytest.fixture
def bucket(s3_server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The URL of an empty bucket, with what a user's environment says of its server."""
    s3fs = pytest.importorskip("s3fs")
    values = {
        "AWS_ENDPOINT_URL": s3_server,
        "AWS_ACCESS_KEY_ID": "AKIAEXAMPLE",
        "AWS_SECRET_ACCESS_KEY": "not/a+secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_CONFIG_FILE": "/nowhere",
        "AWS_SHARED_CREDENTIALS_FILE": "/nowhere",
        "AWS_EC2_METADATA_DISABLED": "true",
        "SLGAUSSIAN_CACHE": str(tmp_path / "copies"),
    }
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("AWS_PROFILE", raising=False)
    name = f"slg-{uuid.uuid4().hex[:12]}"
    s3fs.S3FileSystem(use_listings_cache=False).mkdir(name)
    return f"s3://{name}"
